"""The grammar of one candump log line, both ways; pure.

Regular expressions on bytes read any line. dbc/candump_read.c reads the form that most lines have,
many at once; dbc/candump_write.c writes lines.

The grammar is that of can-utils (lib.h, candump.c): six or nine decimals, a padded interface name,
classic, FD, remote and error frames, `_E` raw lengths, CAN XL (recognised, not decoded),
`DROPCOUNT:` lines, the ` R`/` T` suffix of `-x`. It is stricter than can-utils in one way: text
that is not exactly a frame is rejected.
"""

from __future__ import annotations

import re
from binascii import a2b_hex
from enum import IntEnum
from functools import lru_cache
from typing import Any, Final

from _traction_core import ffi, lib

from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, FD_LENGTHS, REMOTE, SECOND, TX, Frame

MAX_LINE: Final = 8192
"""Most characters of a line (CAN XL needs 4,120); a longer line is skipped without being kept."""


class Verdict(IntEnum):
    """Verdict on one line. The first four come with a frame; CUT to BAD_ID are faults."""

    OK = 0
    """Classic data frame."""
    FD = 1
    REMOTE = 2
    ERROR_FRAME = 3
    XL = 4
    BLANK = 5
    COMMENT = 6
    """A line that starts with `#`, `;` or `//`."""
    DROPCOUNT = 7
    """candump's own note that its socket lost frames."""
    CUT = 8
    """Unterminated last line that may be the start of a longer one."""
    MALFORMED = 9
    BAD_LENGTH = 10
    """More data than the format allows, or a length that CAN FD does not have."""
    BAD_ID = 11
    """An identifier with too many bits."""
    HEADER = 12
    """A line about the log itself. This one and those below do not occur in candump logs."""
    EVENT = 13
    """A line without a CAN frame: a status, a counter, a marker, another kind of bus."""
    REQUEST = 14
    """A request to send a frame; if the frame was on the bus, another line records it."""

    @property
    def is_fault(self) -> bool:
        """True if data are lost: strict reading stops there."""
        return Verdict.CUT <= self <= Verdict.BAD_ID


_HEX: Final = rb"[0-9A-Fa-f]"
# Up to 8,999,999,999 s: as nanoseconds it still fits in 64 bits.
_STAMP: Final = rb"\((\d{1,9}|[0-8]\d{9})\.(\d{6}|\d{9})\)"
_NAME: Final = rb"([^\x00-\x20\x7f]{1,21})"
_END: Final = rb"(?: {1,21}([RT]))?[ \t]{0,21}"
# candump pads interface names to the longest one.
_GAP: Final = rb" {1,21}"
_LINE: Final = re.compile(_STAMP + _GAP + _NAME + _GAP + rb"(\S+)" + _END)
_BODY: Final = re.compile(
    rb"(?P<id>%b{8}|%b{3})#"
    rb"(?:(?P<remote>[Rr](?P<request>[0-8])?(?:_(?P<raw>[9A-Fa-f]))?)"
    rb"|#(?P<flags>%b)(?P<long>(?:\.?%b{2})*)"
    rb"|(?P<data>(?:\.?%b{2})*)(?:_(?P<dlc>[9A-Fa-f]))?)" % ((_HEX,) * 5)
)
_XL: Final = re.compile(rb"(?:%b{3}|%b{5})#%b{2}:%b{2}:%b{8}#(?:\.?%b{2}){1,2048}" % ((_HEX,) * 6))
DROPS: Final = re.compile(
    rb"DROPCOUNT: dropped (\d{1,10}) CAN frames? on '[^']*' socket \(total drops \d{1,10}\)[ \t]*"
)
_COMMENTS: Final = (b"#", b";", b"//")
_ERROR_BIT: Final = 0x2000_0000
_ID_BITS: Final = 0x1FFF_FFFF
_NAMED: Final = re.compile(_NAME)


def parse_line(line: bytes) -> tuple[Verdict, Frame | None]:
    """Parse one line, with or without its line end. Never raises.

    The frame comes with OK, FD, REMOTE and ERROR_FRAME only. Interface names that are not
    UTF-8 keep their bytes as surrogates, so that they can be written back unchanged.
    """
    text = line[:-1] if line.endswith(b"\n") else line
    text = text[:-1] if text.endswith(b"\r") else text
    match = _LINE.fullmatch(text) if len(text) <= MAX_LINE else None
    if match is None:
        return _no_frame(text), None
    seconds, fraction, name, body, direction = match.groups()
    t_ns = int(seconds) * SECOND + int(fraction) * (1000 if len(fraction) == 6 else 1)
    parts = _BODY.fullmatch(body)
    if parts is None:
        return Verdict.XL if _XL.fullmatch(body) else Verdict.MALFORMED, None
    verdict, frame = _frame(t_ns, name.decode("utf-8", "surrogateescape"), parts)
    if frame is not None and direction == b"T":
        frame = frame._replace(flags=frame.flags | TX)
    return verdict, frame


def _no_frame(text: bytes) -> Verdict:
    if not text.strip(b" \t"):
        return Verdict.BLANK
    if text.startswith(_COMMENTS):
        return Verdict.COMMENT
    return Verdict.DROPCOUNT if DROPS.fullmatch(text) else Verdict.MALFORMED


def _frame(t_ns: int, channel: str, parts: re.Match[bytes]) -> tuple[Verdict, Frame | None]:
    """The frame of a line that matches the grammar; its numbers are checked here."""
    can_id = int(parts["id"], 16)
    flags = 0
    if len(parts["id"]) == 8:
        flags = ERROR if can_id & _ERROR_BIT else EXTENDED
        if can_id & ~(_ID_BITS | _ERROR_BIT):
            return Verdict.BAD_ID, None
        can_id &= _ID_BITS
    elif can_id > 0x7FF:
        return Verdict.BAD_ID, None

    if parts["remote"] is not None:
        dlc = int(parts["request"] or b"0")
        # A raw length follows only the full length of 8, and an error frame is never remote.
        if flags & ERROR or (parts["raw"] is not None and dlc != 8):
            return Verdict.MALFORMED, None
        dlc = int(parts["raw"], 16) if parts["raw"] else dlc
        return Verdict.REMOTE, Frame(t_ns, can_id, b"", flags | REMOTE, channel, dlc or -1)

    if parts["flags"] is not None:
        data = a2b_hex(parts["long"].replace(b".", b""))
        if flags & ERROR:
            return Verdict.MALFORMED, None
        if len(data) not in FD_LENGTHS:
            return Verdict.BAD_LENGTH, None
        bits = int(parts["flags"], 16)
        flags |= FD | (BRS if bits & 1 else 0) | (ESI if bits & 2 else 0)
        return Verdict.FD, Frame(t_ns, can_id, data, flags, channel)

    data = a2b_hex(parts["data"].replace(b".", b""))
    if len(data) > 8:
        return Verdict.BAD_LENGTH, None
    dlc = -1
    if parts["dlc"] is not None:
        if len(data) != 8:
            return Verdict.MALFORMED, None
        dlc = int(parts["dlc"], 16)
    verdict = Verdict.ERROR_FRAME if flags & ERROR else Verdict.OK
    return verdict, Frame(t_ns, can_id, data, flags, channel, dlc)


def tail_of(line: bytes) -> tuple[bytes, int]:
    """(id digits, characters after the id's `#` up to the suffix) of a line with a frame."""
    match = _LINE.match(line)
    body = match[4] if match else b"#"
    digits, _, rest = body.partition(b"#")
    return digits, len(rest)


def format_frame(frame: Frame, channel: str = "can0") -> bytes:
    """One line without its end: `(sec.usec) name id#data`; nine decimals only if they are needed.

    `channel` is used if the frame has none. Everything that `parse_line` reads is written, error
    class, length of a remote frame and ` T` (sent) included. Raises ValueError for a frame that no
    candump line can hold (negative time, impossible id, length or name). See dbc/candump_write.c.
    """
    t_ns, can_id, data, flags, own, dlc = frame
    text = ffi.new("char[]", lib.CANDUMP_MAX_TEXT)
    try:
        size = lib.candump_write_line(
            t_ns, can_id, flags, dlc, len(data), data, _name_record(own or channel), text
        )
    except OverflowError:
        size = 0
    if not size:
        raise not_writable(frame)
    return ffi.unpack(text, size)  # type: ignore[no-any-return]


def not_writable(frame: Frame) -> ValueError:
    """The error for a frame that no candump line can hold."""
    return ValueError(f"cannot be written as a candump line: {frame}")


@lru_cache(maxsize=64)
def _name_record(channel: str) -> Any:
    name = name_bytes(channel)
    return ffi.new("struct interface_name *", (name, len(name)))


@lru_cache(maxsize=64)
def name_bytes(channel: str) -> bytes:
    """Bytes of a channel's name in a line; empty if no line can hold this name."""
    name = channel.encode("utf-8", "surrogateescape")
    return name if _NAMED.fullmatch(name) else b""
