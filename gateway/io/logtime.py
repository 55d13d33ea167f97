"""The time of a log: a wrong stamp, or a step of the clock, costs no more than the frames with it.

A frame that continues from the last one counts at once. A frame whose stamp is far from the last
one waits until `AGREEING` frames in a row continue from it: then the log's clock was set, and all
of them count. Otherwise the frames that waited are left out. Internally, time only goes forward: a
clock that was set back becomes a hole of more than `HOLE_NS`, so that no flag stays good across it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.frame import MS, SECOND, Nanos
from dbc.frames import EMPTY, Block, join

HOLE_NS: Final[Nanos] = 10 * SECOND
"""A longer hole is skipped, up to the next frame, once no flag is good."""
NEAR_NS: Final[Nanos] = 100 * MS
"""A stamp at most this far from the last one belongs to the same clock setting."""
AGREEING: Final = 5
"""Frames in a row that establish a new time."""
APART_NS: Final[Nanos] = 10 * SECOND
"""Longest time between two frames that agree on a time before the last one that counted."""
LATEST_NS: Final[Nanos] = 1 << 62
"""Later stamps are left out: sums with the remaining ones fit in 64 bits."""
SORTED_OUT: Final = 256
"""Frames that are checked one by one before the rest of a block is again checked as a whole."""
KEPT: Final = 100
"""Steps back that are recorded."""


class Steady(NamedTuple):
    """Frames whose time does not go back.

    dropped: for every frame left out, the number of the block's frames before it; near: none was
    left out, and each is at most `NEAR_NS` after the one before it.
    """

    block: Block
    dropped: NDArray[np.int64]
    near: bool = False


class Back(NamedTuple):
    """The log's clock was set back: stamps of the last frame before and of the first after it."""

    before_ns: Nanos
    after_ns: Nanos


class LogTime:
    """The stamps of one log, made to go forward only, however the log is cut into blocks."""

    def __init__(self, first_ns: Nanos, period_ns: Nanos, *, disorder: bool = False) -> None:
        """first_ns: stamp of the first frame; period_ns: stamps are shifted by multiples of it.

        disorder: frames that go back by no more than `NEAR_NS` count as well, with their own stamp.
        """
        self._disorder = disorder
        self.frames = 0
        """Frames read so far."""
        self.steps = 0
        """Number of times that the clock was set back."""
        self.backs: list[Back] = []
        """The first `KEPT` of these steps."""
        self.period_ns = period_ns
        self._latest_ns = first_ns
        self._shift_ns: Nanos = 0
        self._waiting = EMPTY
        self._ahead: deque[tuple[Nanos, Nanos]] = deque()
        self._current_shift_ns: Nanos = 0

    @property
    def last_ns(self) -> Nanos:
        """Time of the last frame that counts, as in the blocks of `steady`."""
        return self._latest_ns + self._shift_ns

    def shift_ns(self, now: Nanos) -> Nanos:
        """Time in the blocks of `steady` minus the log's own. `now` must not go back."""
        while self._ahead and self._ahead[0][0] <= now:
            self._current_shift_ns = self._ahead.popleft()[1]
        return self._current_shift_ns

    def steady(self, blocks: Iterable[Block]) -> Iterator[Steady]:
        """All frames that count, block by block."""
        for block in blocks:
            self.frames += block.size
            done = 0
            while done < block.size:
                near = 0 if self._waiting.size else self._near(block.t_ns[done:])
                end = done + (near or min(SORTED_OUT, block.size - done))
                part = block.part(done, end)
                yield self._go_on(part) if near else self._sorted_out(join(self._waiting, part))
                done = end
        if self._waiting.size:
            yield self._end()

    def _near(self, t_ns: NDArray[np.int64]) -> int:
        """Number of leading stamps that continue from the last one and from one another."""
        if not 0 <= t_ns.item(0) - self._latest_ns <= NEAR_NS:
            return 0
        # As an unsigned number, a step back has the highest bit set, and so is far.
        far = (t_ns[1:] - t_ns[:-1]).view(np.uint64) > NEAR_NS
        near = 1 + int(far.argmax()) if far.any() else t_ns.size
        return int(np.searchsorted(t_ns[:near], LATEST_NS - self._shift_ns, "right"))

    def _go_on(self, block: Block) -> Steady:
        self._latest_ns = block.t_ns.item(-1)
        return Steady(shifted(block, self._shift_ns), np.zeros(0, dtype=np.int64), near=True)

    def _sorted_out(self, block: Block) -> Steady:
        """Decide frame by frame. The last frames wait if they cannot be decided yet."""
        stamps = block.t_ns.tolist()
        count = len(stamps)
        kept = np.zeros(count, dtype=np.bool_)
        shift = np.full(count, self._shift_ns, dtype=np.int64)
        waiting = 0  # frames just before k
        for k, t_ns in enumerate(stamps):
            latest = self._latest_ns
            if -NEAR_NS <= t_ns - latest <= NEAR_NS:
                waiting = 0
                if t_ns <= LATEST_NS - self._shift_ns and (t_ns >= latest or self._disorder):
                    kept[k] = True
                    self._latest_ns = max(t_ns, latest)
                continue
            follows = waiting > 0 and _agree(stamps[k - 1], t_ns, latest)
            waiting = waiting + 1 if follows else 1
            first = k - waiting + 1
            if waiting < AGREEING:
                continue
            waiting = 0
            if self._set(stamps[first], t_ns):
                kept[first : k + 1] = True
                shift[first:] = self._shift_ns
        self._waiting = block.part(count - waiting, count) if waiting else EMPTY
        good = kept[: count - waiting]
        dropped = np.cumsum(good)[~good].astype(np.int64)
        moved = block._replace(t_ns=block.t_ns + shift).part(0, count - waiting)
        return Steady(moved.pick(good), dropped)

    def _set(self, first_ns: Nanos, t_ns: Nanos) -> bool:
        """Follow a clock that was set and shows `t_ns` now; False if that is past `LATEST_NS`."""
        shift = self._shift_ns
        if first_ns < self._latest_ns:
            span = self._latest_ns - first_ns + HOLE_NS
            shift += (span // self.period_ns + 1) * self.period_ns
        if t_ns > LATEST_NS - shift:
            return False
        if shift != self._shift_ns:
            self.steps += 1
            if len(self.backs) < KEPT:
                self.backs.append(Back(self._latest_ns, first_ns))
            self._ahead.append((first_ns + shift, shift))
        self._latest_ns, self._shift_ns = t_ns, shift
        return True

    def _end(self) -> Steady:
        """Decide the frames that still wait: those ahead count, as no later frame disagrees."""
        block, self._waiting = self._waiting, EMPTY
        t_ns = block.t_ns.item(-1)
        if block.t_ns.item(0) < self._latest_ns or not self._set(block.t_ns.item(0), t_ns):
            return Steady(EMPTY, np.zeros(block.size, dtype=np.int64))
        return Steady(shifted(block, self._shift_ns), np.zeros(0, dtype=np.int64))


def _agree(before_ns: Nanos, t_ns: Nanos, latest_ns: Nanos) -> bool:
    """Whether a frame continues from the one before it, which waits."""
    if before_ns > latest_ns:  # ahead: a log may have few frames, so any later stamp agrees
        return t_ns >= before_ns
    return 0 <= t_ns - before_ns <= APART_NS and t_ns < latest_ns


def shifted(block: Block, shift_ns: Nanos) -> Block:
    """Return the block with `shift_ns` added to its stamps."""
    return block._replace(t_ns=block.t_ns + shift_ns) if shift_ns else block
