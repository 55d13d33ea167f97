"""Pieces of candump text as blocks: dbc/candump_read.c reads most lines, and marks the others."""

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
"""Most lines of a block."""
_NAMES_KEPT: Final = 40_000
"""Interface names that a hostile log may fill before they are forgotten."""


class LineKind(IntEnum):
    """What a line is, as far as dbc/candump_read.c decides. Only the first two have a frame."""

    CLASSIC = lib.LINE_CLASSIC
    FD = lib.LINE_FD
    OTHER = lib.LINE_OTHER
    """For `logline.parse_line`."""
    BLANK = lib.LINE_BLANK
    COMMENT = lib.LINE_COMMENT
    MALFORMED = lib.LINE_MALFORMED


class Lines(NamedTuple):
    """n consecutive lines of a text.

    rows: a row per line, with numbers where there is a frame; kind (n,): `LineKind`; start
    (n + 1,): where each line starts, and where the next one would; tail (n,): characters after
    the `#`.
    """

    rows: Block
    kind: NDArray[np.uint8]
    start: NDArray[np.int64]
    tail: NDArray[np.int64]

    @property
    def end(self) -> int:
        """Place behind the last line."""
        return self.start.item(-1)

    def line(self, text: bytes, k: int) -> bytes:
        """One line, without its line feed."""
        return text[self.start.item(k) : self.start.item(k + 1) - 1]


class Scanner:
    """Scans texts one after the other; remembers interface names and the lines' shapes."""

    def __init__(self) -> None:
        """Nothing seen yet."""
        self.names: list[str] = []
        self.tails = np.full(0x800, -1, dtype=np.int64)
        """Characters after the `#` in the last line of each 11-bit identifier; -1 none."""
        self._names = zeros(lib.CANDUMP_NAMES, INTERFACE_NAME)
        """The first of `names`, as dbc/candump_read.c looks them up."""

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
        """Enter the frame of a line that was not plain."""
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
        """The kept rows as a block; their shapes are remembered."""
        rows, tail = lines.rows, lines.tail
        standard = kept & (rows.flags & EXTENDED == 0) & (tail >= 0)
        # Of an identifier that comes twice the last one stands.
        self.tails[rows.can_id[standard]] = tail[standard]
        return rows if kept.all() else rows.pick(kept)
