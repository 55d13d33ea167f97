"""Base of the readers of binary logs: counts by verdict, problems, truncated files, as for text."""

from __future__ import annotations

import gzip
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Final, cast

import numpy as np

from dbc.candump.grammar import Verdict
from dbc.candump.reader import LogReader, Problem
from dbc.frame import Frame
from dbc.frames import Block, in_blocks
from dbc.logs.format import verdict_of
from dbc.text import printable

FRAMES: Final = (Verdict.OK, Verdict.FD, Verdict.REMOTE, Verdict.ERROR_FRAME)
BLOCK: Final = 1 << 13
"""Number of frames of a block."""


class ObjectReader(LogReader):
    """Frames of a log that consists of objects, not lines.

    `lines` counts objects; a problem's `line` is the number of its object.
    """

    unit = "objects"
    zipped = False
    """Whether the file that `_open` opened is gzip."""

    def __init__(self, path: Path, *, strict: bool = False) -> None:
        """Nothing is opened before iteration."""
        self.path = path
        super().__init__(str(path), strict=strict)

    def blocks(self) -> Iterator[Block]:
        """Read from the start. Raises LogError for another format; with `strict`, at a fault."""
        self._reset()
        yield from in_blocks(self._counted(), BLOCK)
        self._end()

    def _end(self) -> None:
        """Report a fault if the log is truncated."""
        if self.truncated:
            read = sum(self.counts[verdict] for verdict in FRAMES)
            self.truncated = f"ends early after {read} frames: {self.truncated}"
            self._skip_fault(Verdict.CUT, self.truncated)

    def _counted(self) -> Iterator[Frame]:
        counts: Counter[int] = Counter()
        try:
            for frame in self.frames():
                counts[frame.flags] += 1
                yield frame
        finally:
            for flags, count in counts.items():
                self.counts[verdict_of(flags)] += count
            self.lines += counts.total()

    def _open(self, stack: ExitStack) -> IO[bytes]:
        """The open file; gzip is unpacked."""
        stream: IO[bytes] = stack.enter_context(self.path.open("rb"))
        self.zipped = stream.read(2) == b"\x1f\x8b"
        stream.seek(0)
        if not self.zipped:
            return stream
        plain = cast("IO[bytes]", gzip.GzipFile(fileobj=stream))
        stack.callback(plain.close)
        return plain

    def _count(self, block: Block) -> None:
        """Count the frames of a block by verdict."""
        numbers, counts = np.unique(block.flags, return_counts=True)
        for flags, count in zip(numbers.tolist(), counts.tolist(), strict=True):
            self._skip(verdict_of(flags), count)

    def frames(self) -> Iterator[Frame]:
        """Yield the frames of the format; other objects go to `_skip` and `_skip_fault`."""
        raise NotImplementedError

    def _skip(self, verdict: Verdict, count: int = 1) -> None:
        self.counts[verdict] += count
        self.lines += count

    def _skip_fault(self, verdict: Verdict, text: str) -> None:
        self._skip(verdict)
        self._fault(Problem(self.lines, verdict, printable(text[:120])))
