"""Frames as python-can prints them: its `.txt` logs, and the screen output of `can_logger`.

    Timestamp: 1.5    ID:  181    S Rx F BS    DL: 2    01 02    'ab'    Channel: can0

`X`: 29 bits; `E` error, `R` remote, `F` CAN FD, `BS` BRS, `EI` ESI. Older versions print `DLC:`
and no direction. The data are followed by their letters and digits as text, and by the channel.
"""

from __future__ import annotations

import re
from typing import Final

from dbc.candump.grammar import Verdict
from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, TX
from dbc.logs.format import Format, Head, Line

_LINE: Final = re.compile(
    r"^(?:[ \t]*Timestamp:[ \t]*(-?\d+\.\d+)[ \t]+ID:[ \t]*([0-9a-f]{3,8})[ \t]+([XS])"
    r"((?:[ \t]+(?:[RT]x|[ERF]|BS|EI))*)[ \t]+DLC?:[ \t]*(\d{1,2})((?:[ \t]+[0-9a-f]{2})*)"
    r"(?:[ \t]+'[^\n]*')?(?:[ \t]+Channel: (\S{1,21}))?[ \t]*|(.*))$",
    re.MULTILINE,
)
_FLAGS: Final = {"Tx": TX, "E": ERROR, "R": REMOTE, "F": FD, "BS": BRS, "EI": ESI}


class Printed(Format):
    """The lines of one log, see `dbc.logs.format.Format`."""

    regex = _LINE
    order = (0, 1, 2, 3, 4, 6, 5, 7)
    has_names = True
    """The channel is at the end, so that an unterminated last line may always be incomplete."""

    def head(self, parts: tuple[str, ...]) -> Head:
        """Head from `id kind flags length channel`."""
        digits, kind, words, length, channel = parts
        flags = 0
        for word in words.split():
            flags |= _FLAGS.get(word, 0)
        number, size = int(digits, 16), int(length)
        if kind == "X" and not flags & ERROR:
            flags |= EXTENDED
        if flags & REMOTE:
            return Head(number, flags, 0, channel, size or -1)
        return Head(number, flags, size, channel)

    def line(self, text: str) -> Line:
        """Parse a line without a frame, such as those `can_logger` prints before the first one."""
        if not text.strip():
            return Line(Verdict.BLANK)
        return self._unknown()
