"""Text logs of recorders that are recognised by their lines, and the formats that read them.

Each has a pattern (`dbc.logs.pattern`). If its lines hold more than a pattern can describe, a
separate format reads them, even if the user gave the pattern.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dbc.candump.grammar import Verdict
from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, TX
from dbc.logs.format import Format, Head, Line, framed
from dbc.logs.pattern import Pattern
from dbc.logs.recorders import CanKing, Carbus
from dbc.logs.screen import Screen
from dbc.logs.times import DAY_NS, Differences, clock_ns

CRTD: Final = "{s} {type} {id} {data}"
BUSMASTER: Final = "{clock} {dir} {channel} {id} {type} {dlc} {data}"
SCREEN: Final = "({s}) {channel} {id} [{dlc}] {data}"
PRINTED: Final = "Timestamp: {s} ID: {id} {type} DL: {dlc} {data} Channel: {channel}"
CANKING: Final = "{channel} {id} {type} {dlc} {data} {s} {dir}"
CARBUS: Final = "{s}\t{channel}\t{skip}\t{id}\t{dlc}\t{data}\t{skip}"
_SCREEN_DATES: Final = "({date}) {channel} {id} [{dlc}] {data}"
DIALECTS: Final = {
    "Cascadia Motion": "{ms:x8}x{id:x8}{data}",
    "CRTD": CRTD,
    "Microchip CAN BUS Analyzer": "{ms};{dir};{id};{dlc};{data}",
    "BusMaster": BUSMASTER,
    "candump on a screen, with times": SCREEN,
    "python-can's text": PRINTED,
    "Kvaser CanKing": CANKING,
    "CARBUS Analyzer": CARBUS,
    "GVRET": "{us} - {id} {type} {channel} {dlc} {data}",
}
"""Name and pattern of each format that is recognised by its lines."""
BUSMASTER_MARK: Final = b"***BUSMASTER"
"""Start of the first line of a BUSMASTER log."""
_DECIMAL: Final = "{clock} {dir} {channel} {id:d} {type} {dlc} {data:d}"
_MODE: Final = re.compile(r"\*{3}(?:(HEX|DEC)|(RELATIVE|ABSOLUTE|SYSTEM) MODE)\*{3}")
_ERROR: Final = re.compile(
    r"(\d{1,2}:\d{1,2}:\d{1,2}:\d{1,9})\s+([RT]x)\s+(\S{1,21})\s+(?:[0-9A-Fa-fxX]+\s+)?ERR\b.*"
)
_STAMP: Final = re.compile(r"\d{1,2}:\d{1,2}:\d{1,2}:\d{1,9}(?=\s)")
_NOTE: Final = re.compile(r"\d+\.\d+ +\d*C[A-Z]{2}\b")
"""A line of CRTD without a frame."""
_KIND: Final = re.compile(r"(\d*)([RT])(11|29)")
_BUSMASTER_KIND: Final = re.compile(r"[sx](?:r|-fd)?")
_PRINTED_LINE: Final = re.compile(
    r"^(?:[ \t]*Timestamp:[ \t]*(-?\d+\.\d+)[ \t]+ID:[ \t]*([0-9a-f]{3,8})[ \t]+([XS]|[01]{3})"
    r"((?:[ \t]+(?:[RT]x|[ERF]|BS|EI))*)[ \t]+DLC?:[ \t]*(\d{1,2})((?:[ \t]+[0-9a-f]{2})*)"
    r"(?:[ \t]+'[^\n]*')?(?:[ \t]+Channel: (\S{1,21}))?[ \t]*|(.*))$",
    re.MULTILINE,
)
_PRINTED_FLAGS: Final = {"Tx": TX, "E": ERROR, "R": REMOTE, "F": FD, "BS": BRS, "EI": ESI}


class BusMaster(Pattern):
    """BUSMASTER: its header gives the base of numbers, and whether times are differences."""

    clock_end_ns = 100 * DAY_NS
    """Times may count from the start of the log: hours have two digits."""

    def __init__(self) -> None:
        """Start with hexadecimal numbers and times of day."""
        super().__init__(BUSMASTER)
        self._differences: Differences | None = None

    def head(self, parts: tuple[str, ...]) -> Head:
        """Head from `dir channel id type dlc`."""
        if parts[3] == "ERR":
            head = super().head(parts)
            return head._replace(can_id=0, flags=ERROR | (head.flags & TX))
        if _BUSMASTER_KIND.fullmatch(parts[3]) is None:
            return Head(0, verdict=Verdict.MALFORMED)
        return super().head(parts)

    def changes(self, text: str) -> bool:
        """True for `***DEC***`, `***RELATIVE MODE***` and the like, which each session repeats."""
        return _MODE.match(text.strip()) is not None

    def line(self, text: str) -> Line:
        """Parse a line of the header or an error frame."""
        text = text.strip()
        if mode := _MODE.match(text):
            base, times = mode.groups()
            if base:
                self._compile(_DECIMAL if base == "DEC" else BUSMASTER)
            if times:
                self._differences = Differences() if times == "RELATIVE" else None
            return Line(Verdict.COMMENT)
        if error := _ERROR.fullmatch(text):
            stamp, direction, channel = error.groups()
            flags = ERROR | (TX if direction == "Tx" else 0)
            return framed(Head(0, flags, 0, channel), clock_ns(stamp))
        if stamp := _STAMP.match(text):
            # Malformed, but its time is kept, because the next one may be relative to it.
            return Line(Verdict.MALFORMED, None, clock_ns(stamp[0]))
        return super().line(text)

    def clock(self, times: NDArray[np.int64], timed: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Times of day as they are; differences are summed."""
        if self._differences is not None:
            return self._differences.continued(times, timed)
        return super().clock(times, timed)


class Crtd(Pattern):
    """OVMS' CRTD: `1R11` is 11 bits, received on bus 1; `T29` 29 bits, sent."""

    def __init__(self) -> None:
        super().__init__(CRTD)

    def head(self, parts: tuple[str, ...]) -> Head:
        """Head from `type id`."""
        kind = _KIND.fullmatch(parts[0])
        if kind is None:
            return Head(0, verdict=Verdict.MALFORMED)
        head = super().head(parts)
        flags = head.flags | (TX if kind[2] == "T" else 0)
        return head._replace(channel=kind[1], flags=flags)

    def line(self, text: str) -> Line:
        """Parse a line without a frame; the recorder's events and statistics are comments."""
        return Line(Verdict.COMMENT) if _NOTE.match(text.strip()) else super().line(text)


class Printed(Format):
    """Frames as python-can prints them: its `.txt` logs, and the screen output of `can_logger`.

        Timestamp: 1.5    ID:  181    S Rx F BS    DL: 2    01 02    'ab'    Channel: can0

    `X`: 29 bits; `E` error, `R` remote, `F` CAN FD, `BS` BRS, `EI` ESI. Older versions print `DLC:`
    and no direction, and before 2.0 a digit each for remote, 29 bits and error, such as `000`. The
    data are followed by their letters and digits as text, and by the channel.
    """

    regex = _PRINTED_LINE
    order = (0, 1, 2, 3, 4, 6, 5, 7)
    has_names = True
    """The channel is at the end, so that an unterminated last line may always be incomplete."""

    def head(self, parts: tuple[str, ...]) -> Head:
        """Head from `id kind flags length channel`."""
        digits, kind, words, length, channel = parts
        flags = 0
        for word in words.split():
            flags |= _PRINTED_FLAGS.get(word, 0)
        number, size = int(digits, 16), int(length)
        if kind.isdecimal():
            bits = zip((REMOTE, EXTENDED, ERROR), kind, strict=True)
            flags = sum(flag for flag, bit in bits if bit == "1")
        elif kind == "X" and not flags & ERROR:
            flags |= EXTENDED
        if flags & REMOTE:
            return Head(number, flags, 0, channel, size or -1)
        return Head(number, flags, size, channel)


_OWN: Final[dict[str, Callable[[], Format]]] = {
    CRTD: Crtd, BUSMASTER: BusMaster, PRINTED: Printed, CANKING: CanKing, CARBUS: Carbus,
}  # fmt: skip


def format_of(pattern: str, lines: Sequence[str] = ()) -> Format:
    """A format that reads lines of this pattern, at the start of a log. Raises PatternError.

    lines: the first lines of the log, for formats that cannot interpret a line by itself.
    """
    if pattern in (SCREEN, _SCREEN_DATES):
        form = Screen(lines)
        # Times of another program may have fewer decimals.
        fits = not lines or any(form.regex.match(line)[1] for line in lines)  # type: ignore[index]
        return form if fits else Pattern(pattern)
    own = _OWN.get(pattern)
    return own() if own is not None else Pattern(pattern)
