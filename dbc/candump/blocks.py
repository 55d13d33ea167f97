"""Read candump text as blocks: dbc/candump_read.c reads most lines, and marks the others."""

from __future__ import annotations

from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
from _traction_core import lib
from numpy.typing import NDArray

from dbc.candump.grammar import tail_of
from dbc.frame import EXTENDED, FD, Frame
from dbc.frames import MAX_DATA_BYTES, Block, blank
from dbc.records import INTERFACE_NAME, pointer, zeros

ROWS: Final = 1 << 15
"""Largest number of lines of a block."""
_NAMES_KEPT: Final = 40_000
"""Interface names kept before all are dropped; a hostile log may have any number of them."""


class LineKind(IntEnum):
    """Kind of a line as far as dbc/candump_read.c decides it. Only the first two have a frame."""

    CLASSIC = lib.LINE_CLASSIC
    FD = lib.LINE_FD
    OTHER = lib.LINE_OTHER
    """Left to `grammar.parse_line`."""
    BLANK = lib.LINE_BLANK
    COMMENT = lib.LINE_COMMENT
    MALFORMED = lib.LINE_MALFORMED


class Lines(NamedTuple):
    """n consecutive lines of a text.

    rows: a row per line, filled only for lines with a frame; kind (n,): `LineKind`; start (n + 1,):
    position of each line, and of the one that follows; tail (n,): number of characters after the
    `#`.
    """

    rows: Block
    kind: NDArray[np.uint8]
    start: NDArray[np.int64]
    tail: NDArray[np.int64]

    @property
    def end(self) -> int:
        """Position behind the last line."""
        return self.start.item(-1)

    def line(self, text: bytes, k: int) -> bytes:
        """One line, without its line feed."""
        return text[self.start.item(k) : self.start.item(k + 1) - 1]


class Scanner:
    """Scans texts one after the other; keeps interface names and the length of lines per id."""

    def __init__(self) -> None:
        """Start without names and lines."""
        self.names: list[str] = []
        self.tails = np.full(0x800, -1, dtype=np.int64)
        """Characters after the `#` in the last line of each 11-bit identifier; -1: no line yet."""
        self._names = zeros(lib.CANDUMP_NAMES, INTERFACE_NAME)
        """The first of `names`, in the form in which dbc/candump_read.c looks them up."""

    def read(self, text: bytes, start: int) -> Lines:
        """At most `ROWS` complete lines from text[start:] on; none if there is no line end."""
        if len(self.names) > _NAMES_KEPT:
            self.names = []
            self._names.length = 0
        rows = blank(ROWS, self.names)
        kind = np.empty(ROWS, dtype=np.uint8)
        places = np.empty(ROWS + 1, dtype=np.int64)
        n = lib.candump_read(
            text, start, len(text), ROWS, rows.columns(),
            pointer("struct interface_name", self._names), pointer("uint8_t", kind),
            pointer("int64_t", places),
        )  # fmt: skip
        known = np.count_nonzero(self._names.length)
        for name, length in self._names[len(self.names) : known].tolist():
            self.names.append(name[:length].tobytes().decode("utf-8", "surrogateescape"))
        rows = rows.part(0, n)
        tail = np.where(rows.flags & FD, 2, 0) + 2 * rows.length.astype(np.int64)
        return Lines(rows, kind[:n], places[: n + 1], tail)

    def put(self, lines: Lines, k: int, frame: Frame, line: bytes) -> None:
        """Store in row k the frame of a line that `grammar.parse_line` has read."""
        rows = lines.rows
        digits, lines.tail[k] = tail_of(line)
        rows.t_ns[k], rows.can_id[k], rows.flags[k] = frame.t_ns, frame.can_id, frame.flags
        rows.length[k], rows.dlc[k] = len(frame.data), frame.dlc
        rows.data[k] = np.frombuffer(frame.data.ljust(MAX_DATA_BYTES, b"\0"), dtype=np.uint8)
        rows.channel[k] = self._number(frame.channel)
        if len(digits) != 3:
            lines.tail[k] = -1

    def _number(self, name: str) -> int:
        if name not in self.names:
            n = len(self.names)
            raw = name.encode("utf-8", "surrogateescape")
            if n < len(self._names):
                self._names.text[n, : len(raw)] = list(raw)
                self._names.length[n] = len(raw)
            self.names.append(name)
        return self.names.index(name)

    def finish(self, lines: Lines, kept: NDArray[np.bool_]) -> Block:
        """The kept rows as a block; the lengths of their lines go into `tails`."""
        rows, tail = lines.rows, lines.tail
        standard = kept & (rows.flags & EXTENDED == 0) & (tail >= 0)
        # If an identifier occurs twice, its last line counts.
        self.tails[rows.can_id[standard]] = tail[standard]
        return rows if kept.all() else rows.pick(kept)
