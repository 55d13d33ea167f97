"""Two senders of one message: neither is used, whatever their counters, phase, values or clocks.

And one sender alone, however late, lost, repeated or restarted, is not taken for two.
"""

from functools import cache

import numpy as np
import pytest

from gateway.core.codes import Reason
from gateway.core.supervision import Supervision
from tests.sender import FD_FILE, MS, Sender, codec_for
from tests.simrun import by_tick
from tests.stations import Inbox, is_fresh

TICK = 10 * MS
OFFSETS = {"classic": range(16), "fd": (*range(5), 16, 127, 128, 129, *range(252, 256))}
"""How far the other's counter is ahead: all of 4 bits, the corners of 8."""
PHASES = [k / 20 for k in range(20)]
"""Of the period; 0: both at once."""
ONSET, END, AFTER = 10, 50, 100
"""Ticks: the other speaks from, until; and the guard time."""
FOUND = 2
"""Ticks within which it has to be found; 200 ms are allowed."""


CODECS = {"classic": codec_for((1,)), "fd": codec_for((1,), FD_FILE)}
NAMES = {"classic": "PhaseCurrents", "fd": "Samples"}


@cache
def sent(kind, counter, value):
    """A frame with this counter and values of its own, stamp 0."""
    sender = Sender(CODECS[kind], f"Drive1_{NAMES[kind]}")
    sender.counter = counter
    if kind == "classic":
        return sender.frame(0, Ia=value, Ib=-value, Ic=0.0)
    signals = {f"{name}_{k}": value for name in ("Ia", "Ib", "Ualpha", "Ubeta") for k in range(8)}
    return sender.frame(0, SampleIndex=8 * counter, Udc=500.0, **signals)


class Line:
    """One message as two may send it, and the channel of an inbox that receives it."""

    def __init__(self, kind):
        codec = CODECS[kind]
        self.kind, self.turn = kind, 256 if kind == "fd" else 16
        self.period_ns = codec.by_name[f"Drive1_{NAMES[kind]}"].cycle_ns
        self.box = Inbox(codec, (1,), TICK, Supervision((1,), 300 * MS))
        self.channel = self.box.drives[0].channels[NAMES[kind]]

    def sent(self, first_ns, last_ns, value, counter=0, step_ns=0):
        """Frames of one sender, a period or `step_ns` apart; value: by counter, what it sends."""
        times = range(first_ns, last_ns, step_ns or self.period_ns)
        counters = [(counter + k) % self.turn for k in range(len(times))]
        return [
            sent(self.kind, k, value(k))._replace(t_ns=t)
            for k, t in zip(counters, times, strict=True)
        ]

    def both(self, ahead, phase_ns, value, step_ns=0):
        """Frames in order; the other's counter is `ahead`, and its values are `value`."""
        genuine = self.sent(MS, (END + AFTER + 20) * TICK, lambda _: 1.0)
        first, last = ONSET * TICK + MS + phase_ns, END * TICK + MS + phase_ns
        counter = ahead + ONSET * TICK // self.period_ns
        others = self.sent(first, last, lambda _: value, counter, step_ns)
        return sorted([*genuine, *others], key=lambda frame: frame.t_ns)

    def reasons(self, frames):
        """Why the message is not used, tick by tick."""
        out = []
        for now, part in by_tick(frames, range(TICK, frames[-1].t_ns + 1, TICK)):
            self.box.take(part, now)
            out.append(Reason(self.box.receiver.channels["reason"][self.channel.row]))
        return out


def assert_guarded(reasons, what):
    """Sequence from `FOUND` ticks after the onset until a second after the end, then used again."""
    assert set(reasons[3:ONSET]) == {Reason.NONE}
    found = reasons[ONSET + FOUND : END + AFTER - 1]
    assert set(found) == {Reason.SEQUENCE}, f"{what}: used in tick {found.index(Reason.NONE)}"
    assert set(reasons[END + AFTER + 3 :]) == {Reason.NONE}, what


@pytest.mark.parametrize("kind", ["classic", "fd"])
@pytest.mark.parametrize("value", [1.0, 2.0], ids=["equal values", "other values"])
@pytest.mark.parametrize("phase", [
    pytest.param(phase, marks=[pytest.mark.thorough] * (k % 2)) for k, phase in enumerate(PHASES)
])  # fmt: skip
def test_two_senders_are_never_used_whatever_their_counters_and_phase(kind, value, phase):
    for ahead in OFFSETS[kind]:
        line = Line(kind)
        frames = line.both(ahead, round(phase * line.period_ns), value)
        assert_guarded(line.reasons(frames), f"{ahead} ahead")


@pytest.mark.parametrize("phase_us", [50, 150, 250, 350, 450, 1550, 1950])
@pytest.mark.parametrize("ahead", range(16))
def test_a_second_sender_is_found_within_six_of_its_frames(ahead, phase_us):
    """Frame by frame."""
    line = Line("classic")
    frames = line.both(ahead, phase_us * 1000, 2.0)
    heard = used = 0
    for frame in frames[: ONSET * 5 + 40]:
        line.box.take([frame], frame.t_ns)
        heard += frame.t_ns % line.period_ns != MS % line.period_ns
        if is_fresh(line.box, line.channel.row, frame.t_ns):
            used = heard
    assert heard > 10
    assert used < 6


@pytest.mark.parametrize("kind", ["classic", "fd"])
@pytest.mark.parametrize("share", [-0.013, -0.0101, 0.0011, 0.0101, 0.017])
@pytest.mark.parametrize("equal", [True, False])
def test_two_clocks_that_drift_through_each_other_are_never_used(kind, share, equal):
    """The other's clock is fast or slow by this share, so phases and counters pass."""
    for ahead in (0, 1, 2, 3, 8, 13, 14, 15):
        line = Line(kind)
        step_ns = round(line.period_ns * (1 + share))
        frames = line.both(ahead, line.period_ns // 3, 1.0 if equal else 2.0, step_ns)
        assert_guarded(line.reasons(frames), f"{ahead} ahead")


@pytest.mark.parametrize("lost", [0.05, 0.2])
def test_two_senders_of_whom_frames_are_lost_are_never_used(lost):
    rng = np.random.default_rng(5)
    for ahead in range(16):
        line = Line("classic")
        frames = line.both(ahead, round(rng.uniform(0, line.period_ns)), 2.0)
        kept = [f for f in frames if f.t_ns < ONSET * TICK or rng.random() > lost]
        reasons = line.reasons(kept)
        assert Reason.NONE not in reasons[ONSET + 5 : END + AFTER - 5], ahead


@pytest.mark.parametrize("kind", ["classic", "fd"])
@pytest.mark.parametrize(
    ("jitter", "lost", "twice"),
    [(0.9, 0.0, 0.0), (0.9, 0.05, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, 0.05), (0.5, 0.05, 0.03)],
)
def test_one_sender_late_lost_or_repeated_is_not_two(kind, jitter, lost, twice):
    """30 seconds. jitter: of the period; lost, twice: share of the frames. Copies are equal."""
    line = Line(kind)
    rng = np.random.default_rng(7)
    frames = []
    for frame in line.sent(MS, 30_000 * MS, float):
        if rng.random() < lost:
            continue
        at = frame.t_ns + round(rng.uniform(0, jitter) * line.period_ns)
        frames.append(frame._replace(t_ns=at))
        if rng.random() < twice:
            frames.append(frame._replace(t_ns=at + 100_000))
    frames.sort(key=lambda frame: frame.t_ns)
    guard = line.box.receiver.channels["guard"]
    for reason in line.reasons(frames)[5:]:
        assert guard["rejected_until_ns"].max() < 0
        assert lost > 0.1 or reason is Reason.NONE


def test_a_sender_that_restarts_is_not_two():
    line = Line("classic")
    frames = []
    for at in range(0, 20_000 * MS, 800 * MS):
        end = at + (800 if at % (1600 * MS) else 760) * MS
        frames += line.sent(at + MS, end, lambda _: 1.0, counter=at // MS % 11)
    used = [reason is Reason.NONE for reason in line.reasons(frames)[5:]]
    assert sum(used) > 0.9 * len(used)


def test_long_losses_that_end_at_the_same_counter_are_not_two_senders():
    line = Line("classic")
    frames = line.sent(MS, 20_000 * MS, float)
    kept = [f for k, f in enumerate(frames) if k % 100 < 70 or k % 100 >= 85]
    reasons = line.reasons(kept)
    assert line.box.receiver.channels["guard"]["rejected_until_ns"].max() < 0
    assert reasons.count(Reason.NONE) > 0.6 * len(reasons)
