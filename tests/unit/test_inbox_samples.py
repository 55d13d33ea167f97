"""Samples of an inbox: gaps, blocks, starts anew."""

import numpy as np
import pytest

from gateway.core.channel import Channel
from gateway.core.inbox import MAX_GAP_NS
from gateway.core.supervision import Supervision
from tests.sender import FD_FILE, MS, Sender, SteadyDrive, codec_for
from tests.stations import Inbox

CODEC = codec_for()


def test_a_gap_is_told_by_the_counter_and_not_by_jittering_stamps():
    motor = SteadyDrive(CODEC, 1, 100.0, 20.0)
    box = Inbox(CODEC, (1, 2, 3), 10 * MS, Supervision((1, 2, 3), 300 * MS))
    rng = np.random.default_rng(4)
    sent = [motor.frames(k) for k in range(40)]
    frames = [f for k in range(40) if k not in (10, 11, 20) for f in sent[k]]
    late = [f._replace(t_ns=f.t_ns + int(rng.integers(2 * MS))) for f in frames]
    gaps = []
    for tick in range(1, 12):
        now = tick * 10 * MS
        box.take([f for f in late if now - 10 * MS < f.t_ns <= now], now)
        gaps += box.samples.gap.tolist()
    assert sorted(gaps)[-2:] == [16, 32]
    assert len(gaps) == 37


def test_fd_frames_become_eight_samples_each():
    codec = codec_for((1, 2), FD_FILE)
    sender = Sender(codec, "Drive1_Samples")
    box = Inbox(codec, (1, 2), 10 * MS, Supervision((1, 2), 300 * MS))
    values = {"Udc": 500.0}
    for k in range(8):
        values |= {f"Ia_{k}": k, f"Ib_{k}": -k, f"Ualpha_{k}": 2.0 * k, f"Ubeta_{k}": 0.25}
    for n in (0, 1, 3):
        frame = sender.frame((n + 1) * MS, SampleIndex=8 * n, **values)
        box.take([frame], (n + 1) * MS)
        assert box.samples.drive.tolist() == [0] * 8
        assert box.samples.y[:, 0].tolist() == list(range(8))
        assert box.samples.y[:, 1] == pytest.approx([-k / 3**0.5 for k in range(8)])
        assert box.samples.u[:, 0].tolist() == [2.0 * k for k in range(8)]
        assert box.samples.gap.tolist() == [8 if n == 3 else 0] + [0] * 7


def test_hole_longer_than_the_limit_starts_anew():
    motor = SteadyDrive(CODEC, 1, 100.0, 20.0)
    box = Inbox(CODEC, (1,), 10 * MS, Supervision((1,), 300 * MS))
    box.take(motor.frames(0), 2 * MS)
    assert box.receiver.drives["restart"].tolist() == [1]
    box.take(motor.frames(1), 4 * MS)
    assert not box.receiver.drives["restart"].any()
    assert isinstance(box.drives[0].channels["PhaseCurrents"], Channel)
    far = 1 + MAX_GAP_NS // (2 * MS) + 5
    box.take(motor.frames(far), (far + 1) * 2 * MS)
    assert box.receiver.drives["restart"].tolist() == [1]
