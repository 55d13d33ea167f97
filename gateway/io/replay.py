"""Replay: the same core on a recorded log, as fast as the machine goes.

The log's time stamps are the only clock. There is no bus object in this module: a replay
cannot transmit.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterable
from itertools import chain
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from dbc.arrays import Array
from dbc.frame import Frame, Nanos
from dbc.frames import EMPTY, Block, block_of, join
from gateway.core.gateway import Gateway
from gateway.io.log_file import NO_FRAME, BadLogError
from gateway.io.logtime import HOLE_NS, LogTime, Steady, shifted

MOST_TICKS = 4096
"""Most ticks that are requested from the core in one call."""
Sink = Callable[[Nanos, list[Frame], Gateway], None]
"""Called for every tick with now, the frames sent, and the gateway, whose view is built on request.

`now` never goes back; the frames sent carry the log's own time, as they do for `Briefly.write`.
"""
Make = Callable[[Nanos], Gateway]


class Samples(Protocol):
    """A consumer that samples the ticks now and then."""

    @property
    def next_ns(self) -> Nanos:
        """Time of the next sample: a run of ticks ends with the first tick at or after it."""

    def took(self, now: Nanos, gateway: Gateway, peak: Array) -> None:
        """Take one tick or many, of which the last was at `now`.

        Only in the last tick can a drive's flag have changed. peak (N,): largest loss probability
        of each drive in any of the ticks; NaN: there was none.
        """


class Briefly(NamedTuple):
    """Callbacks in place of a `Sink`, for callers that need no view of ticks without a change.

    write: takes the frames sent, of one tick or of many; changed: takes the gateway, after a tick
    in which a drive's flag changed; samples: consumer of some of the other ticks as well; read:
    takes the frames received, with their time as the ticks count it.
    """

    write: Callable[[Block], None]
    changed: Callable[[Gateway], None]
    samples: Samples | None = None
    read: Callable[[Block], None] | None = None


class Replayed(NamedTuple):
    """What a replay did. last_ns: the last frame, in the time of the ticks; clock: the log's."""

    first_ns: Nanos
    last_ns: Nanos
    frames: int
    ticks: int
    channel: str
    gateway: Gateway
    clock: LogTime

    @property
    def dropped(self) -> int:
        """Frames that were left out because their time was wrong."""
        return self.gateway.inbox.counts["time_back"]


class _Ticks:
    """The ticks of a replay, one at a time; the next one is at `now`."""

    def __init__(self, gateway: Gateway, clock: LogTime, now: Nanos, sink: Sink) -> None:
        self.now = now
        self.count = 0
        self.gateway = gateway
        self.clock = clock
        self.period_ns = clock.period_ns
        self._sink = sink

    def run(self, held: Block, new: Steady) -> Block:
        """Run the ticks that end within `held` and `new`; return the frames of the tick after them.

        The rest of that tick is in the next block. If there is none, `step` takes what is returned.
        """
        return self._each(join(held, new.block), new.dropped + held.size)

    def step(self, frames: Block) -> None:
        """Run one tick and pass on what it sends."""
        out = self.gateway.step(frames, self.now)
        shift = self.clock.shift_ns(self.now)
        if shift:
            out = [frame._replace(t_ns=frame.t_ns - shift) for frame in out]
        self._sink(self.now, out, self.gateway)
        self.now += self.period_ns
        self.count += 1

    def _each(self, block: Block, dropped: NDArray[np.int64]) -> Block:
        """`run`, tick by tick. dropped: as in `Steady`, of this block."""
        done, stamps = 0, block.t_ns.tolist()
        while (end := bisect_right(stamps, self.now, done)) < block.size:
            if len(dropped):
                before = int(np.searchsorted(dropped, end, "right"))
                self.gateway.leave_out(before)
                dropped = dropped[before:]
            self._step_to(stamps[end], block.part(done, end), stamps[end - 1])
            done = end
        self.gateway.leave_out(len(dropped))
        return block.part(done, block.size)

    def _step_to(self, following: Nanos, frames: Block, last: Nanos) -> None:
        """Run the tick of `frames`, and those without frames before the one that takes `following`.

        following: the next stamp; last: that of the last frame. In a hole between them, ticks are
        skipped once no flag is good.
        """
        hole = following - last > HOLE_NS
        while following > self.now:
            self.step(frames)
            frames = EMPTY
            if hole and following > self.now and not self.gateway.says_good:
                self.now += -((self.now - following) // self.period_ns) * self.period_ns


class _BriefTicks(_Ticks):
    """The ticks of a replay, many in one call of the core where the log's time runs evenly."""

    def __init__(self, gateway: Gateway, clock: LogTime, now: Nanos, briefly: Briefly) -> None:
        super().__init__(gateway, clock, now, self._pass_on_one)
        self._to = briefly

    def run(self, held: Block, new: Steady) -> Block:
        if self._to.read is not None:
            self._to.read(new.block)
        dropped = new.dropped + held.size
        block = join(held, new.block)
        if new.near or not (len(dropped) or (np.diff(block.t_ns) > HOLE_NS).any()):
            block = block.part(self._many(block), block.size)
        return self._each(block, dropped)

    def _many(self, block: Block) -> int:
        """Run all ticks that end within the block; return its first frame that is in none."""
        done, last, samples = 0, block.t_ns.item(-1), self._to.samples
        while self.now < last:
            count = min(-((self.now - last) // self.period_ns), MOST_TICKS)
            if samples is not None:
                count = min(count, 1 + max(0, -((self.now - samples.next_ns) // self.period_ns)))
            nows = self.now + self.period_ns * np.arange(count)
            ends = np.searchsorted(block.t_ns[done:], nows, "right")
            stepped, out = self.gateway.run(block.part(done, block.size), ends, self.now)
            now = self.now + (stepped - 1) * self.period_ns
            shift = self.clock.shift_ns(now)
            self._pass_on((shifted(frames, -shift) for frames in out), now, self.gateway.peak)
            self.now = now + self.period_ns
            self.count += stepped
            done += ends.item(stepped - 1)
        return done

    def _pass_on_one(self, now: Nanos, out: list[Frame], gateway: Gateway) -> None:
        self._pass_on([block_of(out)], now, gateway.status.drives["loss_probability"])

    def _pass_on(self, out: Iterable[Block], now: Nanos, peak: Array) -> None:
        """Call the consumers after the tick at `now`, the last of those that sent `out`."""
        for frames in out:
            self._to.write(frames)
        if self.gateway.changed:
            self._to.changed(self.gateway)
        if self._to.samples is not None:
            self._to.samples.took(now, self.gateway, peak)


def replay(blocks: Iterable[Block], make: Make, period_ns: Nanos, sink: Sink | Briefly) -> Replayed:
    """Run the core over a log. Ticks are t_first + k * period; tick k takes frames with t <= t_k.

    A gateway that `make` has resumed from a start record goes on with its own next tick.

    Frames whose time is wrong are dropped and counted, see `LogTime`. The last tick is the first at
    or after the last frame. A `Briefly` gets many ticks at a time, which is much faster. Raises
    BadLogError for a log without frames, or for one that begins before the start record.
    """
    stream = iter(blocks)
    block = next(stream, EMPTY)
    if not block.size:
        raise BadLogError(NO_FRAME)
    first = block.frame(0)
    gateway = make(first.t_ns)
    if gateway.begun and first.t_ns < gateway.now_ns:
        raise BadLogError(
            f"the log begins at {first.t_ns / 1e9:.3f} s, before the start record's "
            f"{gateway.now_ns / 1e9:.3f} s: they do not belong together"
        )
    now = gateway.now_ns + period_ns if gateway.begun else first.t_ns
    clock = LogTime(first.t_ns, period_ns)
    ticks = (
        _BriefTicks(gateway, clock, now, sink)
        if isinstance(sink, Briefly)
        else _Ticks(gateway, clock, now, sink)
    )
    held = EMPTY
    for new in clock.steady(chain([block], stream)):
        held = ticks.run(held, new)
    ticks.step(held)
    return Replayed(
        first.t_ns, clock.last_ns, clock.frames, ticks.count, first.channel, gateway, clock
    )  # fmt: skip
