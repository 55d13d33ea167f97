"""A log as a source: play, pause, seek. A seek gives the same result as playing to that time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from dbc.frame import MS, SECOND, Nanos
from dbc.frames import EMPTY
from dbc.text import printable
from gateway.io.log_file import NO_FRAME, BadLogError, OneChannel, open_log
from gateway.io.logtime import LogTime, Steady
from gateway.monitor.model.observer import Observer
from gateway.monitor.model.snapshot import Snapshot

PATIENCE_S: Final = 0.1
"""Time in s that one `advance` may work."""
PIECE_NS: Final[Nanos] = SECOND // 4
"""Time of the log that is read in one step, so that a call ends near its `patience_s`."""
HOLE_NS: Final[Nanos] = 15 * SECOND
"""A longer gap is played for this time, until everything is unknown; then its rest is skipped."""
STEP_NS: Final[Nanos] = 10 * MS
"""If the log's clock was set back, times shift by a multiple of this, as in a replay at 100 Hz."""
CHECKPOINT_NS: Final[Nanos] = 5 * SECOND
CHECKPOINTS: Final = 64
"""Most checkpoints; beyond, every second one is dropped and they are made half as often."""


class Checkpoint(NamedTuple):
    """State of the observer and the reader at one time."""

    t_ns: Nanos
    frames: int
    """Number of frames read from the log before, dropped ones included."""
    latest_ns: Nanos
    observer: Observer


class LogSource:
    """A log that replay can read. Its time counts from its first frame, as that of the ticks."""

    def __init__(
        self, path: Path, make: Callable[[], Observer], channel: str | None = None
    ) -> None:
        """Read the log once, for its span. make: returns a new observer.

        Raises BadLogError, LogError or OSError if it cannot be read or has several channels.
        """
        self.title = printable(path.name)
        self.paused = False
        self.speed = 1.0
        self._path = path
        self._channel = channel
        first, latest = None, 0
        for block, *_ in self._open():
            if block.size:
                first = block.t_ns.item(0) if first is None else first
                latest = block.t_ns.item(-1)
        if first is None:
            raise BadLogError(NO_FRAME)
        self._first_ns: Nanos = first
        self._last_ns: Nanos = max(first, latest)
        self._target_ns: Nanos = first
        self._every_ns: Nanos = CHECKPOINT_NS
        start = Checkpoint(first, 0, first, make())
        self._checkpoints = [start]
        self._restore(start)

    @property
    def span_s(self) -> tuple[float, float]:
        """See Source."""
        return 0.0, (self._last_ns - self._first_ns) / SECOND

    @property
    def behind(self) -> bool:
        """See Source."""
        return self._at_ns < self._target_ns

    def advance(self, wall_dt_s: float) -> Snapshot:
        """See Source. If it cannot keep up with the speed, it plays as fast as it can."""
        if not self.paused and not self.behind:
            following = self._following_ns()
            if self._at_ns - self._latest_ns > HOLE_NS and following - self._at_ns > HOLE_NS:
                self._aim(following)
            else:
                self._aim(self._target_ns + round(wall_dt_s * self.speed * SECOND))
        return self._work(PATIENCE_S)

    def seek(self, t_s: float, patience_s: float | None = None) -> Snapshot:
        """See Source."""
        span = self.span_s[1]
        self._aim(self._first_ns + round(min(max(t_s, 0.0), span) * SECOND))
        best = [c for c in self._checkpoints if c.t_ns <= self._target_ns][-1]
        if self._target_ns < self._at_ns or best.t_ns > self._at_ns:
            self._restore(best)
        return self._work(patience_s)

    def close(self) -> None:
        """See Source. The file is closed with the iterator that reads it."""
        self._blocks = self._open()
        self._held = _NOTHING

    def _aim(self, t_ns: Nanos) -> None:
        self._target_ns = min(max(t_ns, self._first_ns), self._last_ns)

    def _following_ns(self) -> Nanos:
        """Stamp of the next frame if one is held, else the present time."""
        held = self._held.block
        return held.t_ns.item(0) if held.size else self._at_ns

    def _open(self) -> Iterator[Steady]:
        """Read the log as replay does: a frame with a wrong time is dropped."""
        blocks = iter(OneChannel(open_log(self._path, strict=False).blocks, self._channel))
        first = next(blocks, EMPTY)
        if first.size:
            yield from LogTime(first.t_ns.item(0), STEP_NS).steady(chain([first], blocks))

    def _restore(self, checkpoint: Checkpoint) -> None:
        self._observer = checkpoint.observer.copy()
        self._at_ns, self._latest_ns = checkpoint.t_ns, checkpoint.latest_ns
        self._frames = checkpoint.frames
        self._blocks = self._open()
        self._held = _NOTHING
        skip = checkpoint.frames
        for read in self._blocks:
            total = read.block.size + len(read.dropped)
            if total > skip:
                gone = int((read.dropped + np.arange(len(read.dropped)) < skip).sum())
                self._held = _rest(read, skip - gone, gone)
                break
            skip -= total

    def _work(self, patience_s: float | None) -> Snapshot:
        until = None if patience_s is None else time.monotonic() + patience_s
        while True:
            # A night between two runs is one step: the observer has little to do without frames.
            to = min(self._target_ns, max(self._at_ns + PIECE_NS, self._following_ns()))
            self._read(to)
            self._at_ns = to
            newest = self._checkpoints[-1]
            if to >= newest.t_ns + self._every_ns:
                self._keep(Checkpoint(to, self._frames, self._latest_ns, self._observer.copy()))
            if not self.behind or (until is not None and time.monotonic() >= until):
                break
        return self._observer.snapshot(self._at_ns)._replace(span_s=self.span_s)

    def _read(self, to_ns: Nanos) -> None:
        """Pass everything up to a time to the observer."""
        while True:
            if _is_empty(self._held) and (following := next(self._blocks, None)) is not None:
                self._held = following
            if _is_empty(self._held):
                break
            block, dropped, _ = self._held
            now = int((block.t_ns <= to_ns).sum())
            # Number of dropped frames before the first frame that is later.
            early = int((dropped <= now).sum()) if now < block.size else len(dropped)
            self._latest_ns = block.t_ns.item(now - 1) if now else self._latest_ns
            self._observer.note_dropped(early)
            self._observer.add_frames(
                block.part(0, now), to_ns if now < block.size else self._latest_ns
            )  # fmt: skip
            self._frames += now + early
            self._held = _rest(self._held, now, early)
            if not _is_empty(self._held):
                break
        self._observer.add_frames(EMPTY, to_ns)

    def _keep(self, checkpoint: Checkpoint) -> None:
        self._checkpoints.append(checkpoint)
        if len(self._checkpoints) > CHECKPOINTS:
            self._checkpoints = self._checkpoints[::2]
            self._every_ns *= 2


_NOTHING: Final = Steady(EMPTY, np.zeros(0, dtype=np.int64))


def _is_empty(held: Steady) -> bool:
    return not held.block.size and not len(held.dropped)


def _rest(held: Steady, frames: int, gone: int) -> Steady:
    """The rest, without the first `frames` frames and the first `gone` dropped frames."""
    block = held.block.part(frames, held.block.size)
    return Steady(block, held.dropped[gone:] - frames)
