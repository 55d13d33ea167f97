"""A log as a source: play, pause, seek. Seeking gives exactly what playing to that time gives."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final, NamedTuple

from dbc.block import EMPTY, Block
from dbc.frame import SECOND, Nanos
from dbc.text import printable
from gateway.drivers.replay import BadLogError, OneChannel, forward, open_log
from gateway.monitor.observer import Observer
from gateway.monitor.snapshot import Snapshot

PATIENCE_S: Final = 0.1
"""Work of one `advance`."""
PIECE_NS: Final[Nanos] = SECOND // 4
"""Read in one go, so that patience is kept."""
HOLE_NS: Final[Nanos] = 15 * SECOND
"""Playing through a longer hole goes on behind it, after so long, when all has become unknown."""
CHECKPOINT_NS: Final[Nanos] = 5 * SECOND
CHECKPOINTS: Final = 64
"""More of them: every second one goes, and they are made half as often."""


class Checkpoint(NamedTuple):
    """The state at one time."""

    t_ns: Nanos
    frames: int
    """Read from the log before."""
    latest_ns: Nanos
    observer: Observer


class LogSource:
    """A log that replay can read. Time in it is counted from its first frame."""

    def __init__(
        self, path: Path, make: Callable[[], Observer], channel: str | None = None
    ) -> None:
        """Reads the log once, for its span. make: gives a fresh observer.

        Raises BadLogError, LogError or OSError for what cannot be read or has several channels.
        """
        self.title = printable(path.name)
        self.paused = False
        self.speed = 1.0
        self._path = path
        self._channel = channel
        first, latest = None, 0
        for block in self._open():
            first = block.t_ns.item(0) if first is None else first
            latest = max(latest, int(block.t_ns.max()))
        if first is None:
            msg = "no frame in the log (or none on this channel)"
            raise BadLogError(msg)
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

    @property
    def ended(self) -> bool:
        """Whether the last frame is reached."""
        return self._at_ns >= self._last_ns

    def advance(self, wall_dt_s: float) -> Snapshot:
        """See Source. Who cannot keep up with the speed goes as fast as he can."""
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
        self._held = EMPTY

    def _aim(self, t_ns: Nanos) -> None:
        self._target_ns = min(max(t_ns, self._first_ns), self._last_ns)

    def _following_ns(self) -> Nanos:
        """Stamp of the next frame, as far as it is known."""
        return self._held.t_ns.item(0) if self._held.size else self._at_ns

    def _open(self) -> Iterator[Block]:
        return iter(OneChannel(open_log(self._path, strict=False).blocks, self._channel))

    def _restore(self, checkpoint: Checkpoint) -> None:
        self._observer = checkpoint.observer.copy()
        self._at_ns, self._latest_ns = checkpoint.t_ns, checkpoint.latest_ns
        self._frames = checkpoint.frames
        self._blocks = self._open()
        self._held = EMPTY
        skip = checkpoint.frames
        for block in self._blocks:
            if block.size > skip:
                self._held = block.part(skip, block.size)
                break
            skip -= block.size

    def _work(self, patience_s: float | None) -> Snapshot:
        until = None if patience_s is None else time.monotonic() + patience_s
        while True:
            # A night between two runs is one piece: the observer has little to do in silence.
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
        """Give the observer everything up to a time."""
        while True:
            if not self._held.size and (following := next(self._blocks, None)) is not None:
                self._held = following
            if not self._held.size:
                break
            # As replay does: a frame whose time goes back is left out.
            block, dropped, latest = forward(self._held, self._latest_ns)
            now = int((block.t_ns <= to_ns).sum())
            if now < block.size:
                # Those that go back and stand before the first that is later.
                early = int((dropped <= now).sum())
                done = now + early
            else:
                early, done = len(dropped), self._held.size
            self._observer.note_dropped(early)
            self._observer.take(block.part(0, now), to_ns if now < block.size else latest)
            self._latest_ns = block.t_ns.item(now - 1) if now else self._latest_ns
            self._frames += done
            self._held = self._held.part(done, self._held.size)
            if self._held.size:
                break
        self._observer.take(EMPTY, to_ns)

    def _keep(self, checkpoint: Checkpoint) -> None:
        self._checkpoints.append(checkpoint)
        if len(self._checkpoints) > CHECKPOINTS:
            self._checkpoints = self._checkpoints[::2]
            self._every_ns *= 2
