"""Read plain lines of a text log as blocks; dbc/text_read.c parses many of them per call."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np
from _traction_core import ffi, lib
from numpy.typing import NDArray

from dbc.frames import Block, blank
from dbc.logs.format import Head
from dbc.records import TEXT_HEAD, pointer, zeros

ROWS: Final = 1 << 15
"""Largest number of lines of a scan."""
_UNKNOWN, _PLAIN, _OTHER = range(3)


def shape_of(
    unit_ns: int, words_before: int, head_words: int, marker: str = "", at: int = -1
) -> Any:
    """Form of plain lines, a `struct text_shape`. at: index of the word that must be the marker."""
    fields = (unit_ns, words_before, head_words, at, ord(marker) if marker else 0)
    return ffi.new("struct text_shape *", fields)


class Scan(NamedTuple):
    """n lines of a text. rows: frames if `plain` (n,); start (n + 1,): position of each line."""

    rows: Block
    plain: NDArray[np.bool_]
    start: NDArray[np.int64]


class Scanner:
    """Scans the texts of one log, and keeps its heads."""

    def __init__(self, learn: Callable[[str, str], Head | None]) -> None:
        """learn: from a head's text and a line with it to the head; None if it is no plain data."""
        self._learn = learn
        self._heads = zeros(lib.TEXT_HEADS, TEXT_HEAD)
        count = len(self._heads)
        self._state = np.zeros(count, dtype=np.uint8)
        self._can_id, self._flags = np.zeros(count, np.uint32), np.zeros(count, np.uint8)
        self._length, self._dlc = np.zeros(count, np.uint8), np.zeros(count, np.int8)
        self._channel = np.zeros(count, np.uint16)
        self.names: list[str] = []

    def scan(self, text: bytes, start: int, shape: Any) -> Scan:
        """Scan at most `ROWS` complete lines from text[start:] on."""
        rows = blank(ROWS, self.names)
        head, places = np.empty(ROWS, np.int32), np.empty(ROWS + 1, np.int64)
        place = ffi.from_buffer("uint8_t[]", text) + start
        n = lib.text_read(
            place, len(text) - start, ROWS, shape, rows.columns(),
            pointer("struct text_head", self._heads), pointer("int32_t", head),
            pointer("int64_t", places),
        )  # fmt: skip
        head, rows = head[:n], rows.part(0, n)
        found = head >= 0
        mine = np.where(found, head, 0)
        unknown = np.flatnonzero(found & (self._state[mine] == _UNKNOWN))
        for new, row in zip(*np.unique(mine[unknown], return_index=True), strict=True):
            line = places[unknown[row] : unknown[row] + 2] + start
            self._enter(int(new), text[line[0] : line[1]].decode("latin-1"))
        plain = found & (self._state[mine] == _PLAIN) & (rows.length == self._length[mine])
        rows.can_id[:], rows.flags[:] = self._can_id[mine], self._flags[mine]
        rows.dlc[:], rows.channel[:] = self._dlc[mine], self._channel[mine]
        return Scan(rows, plain, places[: n + 1] + start)

    def _enter(self, place: int, line: str) -> None:
        text, length = self._heads[place].item()
        known = self._learn(bytes(text[:length]).decode("latin-1"), line)
        self._state[place] = _OTHER if known is None else _PLAIN
        if known is None:
            return
        if known.channel not in self.names:
            self.names.append(known.channel)
        self._can_id[place], self._flags[place] = known.can_id, known.flags
        self._length[place], self._dlc[place] = known.length, known.dlc
        self._channel[place] = self.names.index(known.channel)
