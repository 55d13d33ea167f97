"""Pieces of candump text as blocks: plain lines by the compiled scan, the others left marked."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc._candump_kernels import FD_LENGTH, HEX, scan
from dbc.block import ROOM, Block, blank
from dbc.frame import EXTENDED, FD, Frame
from dbc.logline import tail_of

ROWS: Final = 1 << 15
"""Most lines of a block."""
_NAMES: Final = 64
MOST_NAME: Final = 21
_NAMES_KEPT: Final = 40_000
"""Interface names that a hostile log may fill before they are forgotten."""


class Lines(NamedTuple):
    """Consecutive lines of a text.

    rows: a row per line; what (n,): PLAIN for frames, the others' text is `line`; place: behind the
    last line; tail (n,): characters after the `#`.
    """

    rows: Block
    what: NDArray[np.uint8]
    place: int
    tail: NDArray[np.int64]

    def line(self, text: bytes, k: int) -> bytes:
        """A line that is not plain, until it is `put`."""
        return text[self.rows.can_id.item(k) : self.rows.t_ns.item(k)]


class Scanner:
    """Scans texts one after the other; remembers interface names and the lines' shapes."""

    def __init__(self) -> None:
        """Nothing seen yet."""
        self.names: list[str] = []
        self.tails = np.full(0x800, -1, dtype=np.int64)
        """Characters after the `#` in the last line of each 11-bit identifier; -1 none."""
        self._table = np.zeros((_NAMES, MOST_NAME), dtype=np.uint8)
        self._sizes = np.zeros(_NAMES, dtype=np.int64)

    def read(self, text: NDArray[np.uint8], start: int) -> Lines:
        """At most `ROWS` complete lines from text[start:] on; none if there is no line end."""
        if len(self.names) > _NAMES_KEPT:
            self.names = []
            self._sizes[:] = 0
        rows = blank(ROWS, self.names)
        what = np.empty(ROWS, dtype=np.uint8)
        n, place = scan(
            text, start, rows.t_ns, rows.can_id, rows.flags, rows.length, rows.data,
            rows.channel, what, self._table, self._sizes, HEX, FD_LENGTH,
        )  # fmt: skip
        for k in range(len(self.names), np.count_nonzero(self._sizes)):
            name = self._table[k, : self._sizes[k]].tobytes()
            self.names.append(name.decode("utf-8", "surrogateescape"))
        rows = rows.part(0, n)
        tail = np.where(rows.flags & FD, 2, 0) + 2 * rows.length.astype(np.int64)
        return Lines(rows, what[:n], place, tail)

    def put(self, lines: Lines, k: int, frame: Frame, line: bytes) -> None:
        """Enter the frame of a line that was not plain."""
        rows = lines.rows
        digits, lines.tail[k] = tail_of(line)
        rows.t_ns[k], rows.can_id[k], rows.flags[k] = frame.t_ns, frame.can_id, frame.flags
        rows.length[k], rows.dlc[k] = len(frame.data), frame.dlc
        rows.data[k] = np.frombuffer(frame.data.ljust(ROOM, b"\0"), dtype=np.uint8)
        rows.channel[k] = self._number(frame.channel)
        if len(digits) != 3:
            lines.tail[k] = -1

    def _number(self, name: str) -> int:
        if name not in self.names:
            n = len(self.names)
            raw = name.encode("utf-8", "surrogateescape")
            if n < _NAMES:
                self._sizes[n] = len(raw)
                self._table[n, : len(raw)] = list(raw)
            self.names.append(name)
        return self.names.index(name)

    def finish(self, lines: Lines, kept: NDArray[np.bool_]) -> Block:
        """The kept rows as a block; their shapes are remembered."""
        rows, tail = lines.rows, lines.tail
        standard = kept & (rows.flags & EXTENDED == 0) & (tail >= 0)
        # Of an identifier that comes twice the last one stands.
        self.tails[rows.can_id[standard]] = tail[standard]
        return rows if kept.all() else rows.pick(kept)
