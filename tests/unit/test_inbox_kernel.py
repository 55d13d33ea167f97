"""The compiled row loop equals itself uncompiled, on good and on damaged streams."""

import numpy as np
import pytest

from gateway import _kernels, pairing
from gateway import inbox as inbox_module
from gateway._kernels import take_block
from gateway.channel import Channel
from gateway.inbox import MAX_GAP_NS, Inbox
from gateway.supervision import Supervision
from tests.sender import FD_FILE, MS, Sender, SteadyDrive, codec_for

CODEC = codec_for()


HELPERS = (
    "_verdict", "_gap", "route", "note_foul", "_is_latest", "_admit", "_unbelieved", "keep",
    "_note", "settle", "take_rows",
)  # fmt: skip


def plain(*arguments):
    """`take_block` with its helpers uncompiled too (checksum and decoding have tests of theirs)."""
    keep = {name: getattr(_kernels, name) for name in HELPERS}
    for name, compiled in keep.items():
        setattr(_kernels, name, compiled.py_func)
    try:
        return take_block.py_func(*arguments)
    finally:
        for name, compiled in keep.items():
            setattr(_kernels, name, compiled)


def stream(seed, damage):
    rng = np.random.default_rng(seed)
    motors = [SteadyDrive(CODEC, n, 80.0 * n, 15.0, theta=n) for n in (1, 2, 3)]
    frames = [f for k in range(60) for motor in motors for f in motor.frames(k)]
    out = []
    for f in frames:
        roll = rng.random()
        if roll < damage:
            continue
        if roll < 2 * damage:
            f = f._replace(t_ns=f.t_ns + int(rng.integers(40 * MS)))  # noqa: PLW2901
        elif roll < 2.5 * damage:
            f = f._replace(data=bytes([f.data[0] ^ 1]) + f.data[1:])  # noqa: PLW2901
        elif roll < 2.7 * damage:
            f = f._replace(data=f.data[1:])  # noqa: PLW2901
        elif roll < 2.9 * damage:
            f = f._replace(flags=int(rng.integers(64)), can_id=int(rng.integers(0x800)))  # noqa: PLW2901
        out.append(f)
    return out


def feed(frames, kernel, monkeypatch):
    monkeypatch.setattr(inbox_module, "take_block", kernel)
    box = Inbox(CODEC, (1, 2, 3), 10 * MS, Supervision((1, 2, 3), 300 * MS))
    seen = []
    for tick in range(1, 18):
        now = tick * 10 * MS
        batch = [f for f in frames if now - 10 * MS < f.t_ns <= now]
        box.take(batch, now)
        seen.append([column.copy() for column in box.samples])
        seen.append([np.array([c.state, c.good_ns, c.seen_valid]) for c in box.channels])
        seen.append([column[: box.motions].copy() for column in box.readings])
        seen.append([column.copy() for column in box.slow])
    return seen, dict(box.counts)


@pytest.mark.parametrize("damage", [0.0, 0.05, 0.15])
def test_compiled_equals_uncompiled(damage, monkeypatch):
    frames = stream(3, damage)
    fast, counts = feed(frames, take_block, monkeypatch)
    slow, same = feed(frames, plain, monkeypatch)
    assert counts == same
    assert sum(len(tick[0]) for tick in fast[::4]) > (60 if damage < 0.1 else 0)
    assert damage == 0.0 or {"error", "wrong_length", "lost"} <= counts.keys()
    for a, b in zip(fast, slow, strict=True):
        for x, y in zip(a, b, strict=True):
            np.testing.assert_array_equal(x, y)


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
    assert box.restart == {0}
    box.take(motor.frames(1), 4 * MS)
    assert box.restart == set()
    assert isinstance(box.drives[0].channels["PhaseCurrents"], Channel)
    far = 1 + MAX_GAP_NS // (2 * MS) + 5
    box.take(motor.frames(far), (far + 1) * 2 * MS)
    assert box.restart == {0}


def test_wiring_has_room_for_every_kind():
    assert pairing._MOST_COLUMNS >= 33
