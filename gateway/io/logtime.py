"""The time of a log: one wrong stamp, or a clock that was set, costs no more than its own frames.

A frame that goes on from the last one counts at once. One whose stamp is far from there waits until
`AGREEING` frames in a row go on from it: then the log's clock was set, and all of them count. If
they do not, those that waited are left out. Inside, time only goes forward: a clock that was set
back is a hole of more than `HOLE_NS`, so that no flag says good across it.
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
"""A longer hole is skipped to the next frame once no flag says good."""
NEAR_NS: Final[Nanos] = 100 * MS
"""A stamp so far from the last one, or less, is of the same clock."""
AGREEING: Final = 5
"""Frames in a row that make a new time."""
APART_NS: Final[Nanos] = 10 * SECOND
"""Most between two frames that agree on a time that lies back."""
LATEST_NS: Final[Nanos] = 1 << 62
"""Stamps behind it are left out: what is reckoned with them still has 64 bits."""
SORTED_OUT: Final = 256
"""Frames that are looked at one by one before it is seen whether the others go on."""
KEPT: Final = 100
"""Steps back of which is told."""


class Steady(NamedTuple):
    """Frames whose time does not go back.

    dropped: of every one that was left out, how many of the block's stand before it; near: none was
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
    """The stamps of one log, in one direction. The same for the same log, however it is cut."""

    def __init__(self, first_ns: Nanos, period_ns: Nanos, *, disorder: bool = False) -> None:
        """first_ns: stamp of the first frame; period_ns: steps back are whole numbers of it.

        disorder: frames that go back by no more than `NEAR_NS` count as well, as they are.
        """
        self._disorder = disorder
        self.frames = 0
        """Read so far."""
        self.steps = 0
        """Times that the clock was set back."""
        self.backs: list[Back] = []
        """The first `KEPT` of these."""
        self._period_ns = period_ns
        self._latest_ns = first_ns
        self._shift_ns: Nanos = 0
        self._waiting = EMPTY
        self._ahead: deque[tuple[Nanos, Nanos]] = deque()
        self._current_shift_ns: Nanos = 0

    @property
    def last_ns(self) -> Nanos:
        """Of the last frame that counts, as blocks have it."""
        return self._latest_ns + self._shift_ns

    def shift_ns(self, now: Nanos) -> Nanos:
        """What a time as blocks have it is more than the log's own. `now` must not go back."""
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
        """How many of these stamps go on from the last one and from one another."""
        if not 0 <= t_ns.item(0) - self._latest_ns <= NEAR_NS:
            return 0
        # A step back has the highest bit.
        far = (t_ns[1:] - t_ns[:-1]).view(np.uint64) > NEAR_NS
        near = 1 + int(far.argmax()) if far.any() else t_ns.size
        return int(np.searchsorted(t_ns[:near], LATEST_NS - self._shift_ns, "right"))

    def _go_on(self, block: Block) -> Steady:
        self._latest_ns = block.t_ns.item(-1)
        return Steady(_shifted(block, self._shift_ns), np.zeros(0, dtype=np.int64), near=True)

    def _sorted_out(self, block: Block) -> Steady:
        """Frame by frame. The last ones wait where they are not decided upon."""
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
        """The clock was set, and shows `t_ns` now; False where there is no room for that."""
        shift = self._shift_ns
        if first_ns < self._latest_ns:
            span = self._latest_ns - first_ns + HOLE_NS
            shift += (span // self._period_ns + 1) * self._period_ns
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
        """Those that still wait: nothing has spoken against what lies ahead."""
        block, self._waiting = self._waiting, EMPTY
        t_ns = block.t_ns.item(-1)
        if block.t_ns.item(0) < self._latest_ns or not self._set(block.t_ns.item(0), t_ns):
            return Steady(EMPTY, np.zeros(block.size, dtype=np.int64))
        return Steady(_shifted(block, self._shift_ns), np.zeros(0, dtype=np.int64))


def _agree(before_ns: Nanos, t_ns: Nanos, latest_ns: Nanos) -> bool:
    """Whether a frame goes on from the one before it, which waits."""
    if before_ns > latest_ns:  # ahead, where a log may be slow
        return t_ns >= before_ns
    return 0 <= t_ns - before_ns <= APART_NS and t_ns < latest_ns


def _shifted(block: Block, shift_ns: Nanos) -> Block:
    return block._replace(t_ns=block.t_ns + shift_ns) if shift_ns else block
