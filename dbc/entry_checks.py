"""Check the form of single DBC entries, and repair what can be repaired without a guess."""

from __future__ import annotations

import re
from typing import Final, NamedTuple

from dbc.entry_text import TEXT

NUMBER: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_WORD: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_MESSAGE: Final = re.compile(r"\s*(BO_\s+(\d+)\s+(\w+)\s*:\s*(\d+))(?:\s+(\S.*))?", re.DOTALL)
_SIGNAL: Final = re.compile(
    rf"\s*(SG_\s+(\w+)(?:\s+(M|m\d+M?))?\s*:\s*(\d+)\s*\|\s*(\d+)\s*@\s*[01]\s*[+-]\s*"
    rf"\(\s*({NUMBER})\s*,\s*({NUMBER})\s*\)\s*"
    rf"\[\s*({NUMBER})\s*\|\s*({NUMBER})\s*\]\s*{TEXT})(.*)",
    re.DOTALL,
)
_RECEIVERS: Final = re.compile(r"\s*[A-Za-z_]\w*(?:\s*,\s*[A-Za-z_]\w*)*\s*", re.ASCII)
_SELECTOR: Final = re.compile(r"\s*SG_\s+([A-Za-z_]\w*)\s+(M|m\d+M)\s*:", re.ASCII)
_VALUE_TYPE: Final = re.compile(r"\s*SIG_VALTYPE_\s+(\d+)\s+(\w+)\s*:\s*([0-2])\s*;")
_MULTIPLEX: Final = re.compile(
    r"\s*SG_MUL_VAL_\s+(\d+)\s+(\w+)\s+(\w+)\s+(\d+\s*-\s*\d+(?:\s*,\s*\d+\s*-\s*\d+)*)\s*;"
)
_RANGE: Final = re.compile(r"(\d+)\s*-\s*(\d+)")
_LABELS: Final = re.compile(rf"(\s*VAL_\s+\d+\s+\w+)((?:\s*\S+?\s*{TEXT})*)\s*;")
_LABEL: Final = re.compile(rf"\s*(\S+?)\s*({TEXT})")
_BARE_POINT: Final = re.compile(r"(?<!\d)\.(?=\d)")
"""Of `.25`, which cantools does not read."""
_NO_NODE: Final = " Vector__XXX"
_DIGITS: Final = 300
_MOST_BYTES, _MOST_BITS, _LAST_BIT, LAST_MUX = 64, 64, 511, 0xFFFF
_FLOAT_BITS: Final = (16, 32, 64)
_NAME: Final = "a name has letters of ASCII, digits and _, and begins with no digit"


class Checked(NamedTuple):
    """Result of the check of an entry.

    number: of the message, or None; name: of message or signal; fault: why it cannot be used, or
    empty; text: for cantools; marker: multiplexing of a signal, `M`, `m3`, `m3M` or empty; size: of
    a signal, in bits.
    """

    number: int | None
    name: str
    fault: str
    text: str
    marker: str = ""
    size: int = 0


def message_of(text: str) -> Checked:
    """Check a BO_; one without a valid sender gets the sender Vector__XXX and is not rejected."""
    match = _MESSAGE.fullmatch(text)
    if match is None:
        return Checked(None, "", "is not a message (BO_ number name: bytes sender)", text)
    head, name, size, sender = match[1], match[3], int(match[4][:9]), match[5] or ""
    number = number_of(match[2])
    fault = ""
    if not _WORD.fullmatch(name):
        fault = f"{name!r} is not a name: {_NAME}"
    elif size > _MOST_BYTES:
        fault = f"{match[4][:20]} bytes; CAN FD has 64"
    elif not _is_identifier(number):
        fault = f"no frame has the identifier {match[2][:40]}"
    if not _WORD.fullmatch(sender):
        text = head + _NO_NODE
    return Checked(number, name, fault, text)


def number_of(digits: str) -> int:
    """Number of a message; -1, which no message has, for more than 10 digits."""
    return int(digits) if len(digits) <= 10 else -1


def _is_identifier(number: int) -> bool:
    """Whether a frame can have this identifier; bit 31 marks one of 29 bits."""
    if not 0 <= number < 1 << 32:
        return False
    return number & 0x7FFF_FFFF <= (0x1FFF_FFFF if number >> 31 else 0x7FF)


def signal_of(text: str) -> Checked:
    """Check an SG_; unreadable receivers become Vector__XXX, and the signal is not rejected."""
    match = _SIGNAL.fullmatch(text)
    if match is None:
        fault = "is not a signal (SG_ name : start|length@order sign (scale,offset) [min|max] unit"
        return Checked(None, "", f"{fault} nodes)", text)
    head, name, marker, tail = match[1], match[2], match[3] or "", match[10]
    start, size = int(match[4][:9]), int(match[5][:9])
    fault = ""
    if not _WORD.fullmatch(name):
        fault = f"{name!r} is not a name: {_NAME}"
    elif not 1 <= size <= _MOST_BITS:
        fault = f"{size} bits; 1 to 64 are possible"
    elif start > _LAST_BIT:
        fault = f"starts at bit {start} of 512"
    elif any(len(n) > _DIGITS or abs(float(n)) == float("inf") for n in match.groups()[5:9]):
        fault = "a number too large for a double"
    elif int(marker.strip("mM")[:20] or 0) > LAST_MUX:
        fault = f"multiplexer value above {LAST_MUX}"
    tail = tail if _RECEIVERS.fullmatch(tail) else _NO_NODE
    numbers, quote, unit = head.partition('"')
    text = _BARE_POINT.sub("0.", numbers) + quote + unit + tail
    return Checked(None, name, fault, text, marker, size)


def stand_in(text: str) -> Checked | None:
    """Readable replacement of a selector that cannot be read, so that its dependents are known.

    None for any other signal.
    """
    match = _SELECTOR.match(text)
    if match is None or int(match[2].strip("mM")[:20] or 0) > LAST_MUX:
        return None
    made = f'SG_ {match[1]} {match[2]} : 0|1@1+ (1,0) [0|0] ""{_NO_NODE}'
    return Checked(None, match[1], "", made, match[2], 1)


def value_type_of(text: str, size: int) -> tuple[str, str]:
    """Why a SIG_VALTYPE_ of a signal of `size` bits cannot be used (empty: it can); its text."""
    match = _VALUE_TYPE.fullmatch(text)
    if match is None:
        return "is not of the form SIG_VALTYPE_ number name : 0, 1 or 2;", text
    if match[3] != "0" and size not in _FLOAT_BITS:
        return f"a float of {size} bits", text
    return "", text


def multiplexing_of(text: str) -> tuple[str, str]:
    """Why a SG_MUL_VAL_ cannot be used (empty: it can), and its text for cantools."""
    match = _MULTIPLEX.fullmatch(text)
    if match is None:
        return (
            "is not of the form SG_MUL_VAL_ number name selector first-last, ..;",
            text,
        )
    ranges = _RANGE.findall(match[4])
    if any(len(n) > 9 or int(n) > LAST_MUX for pair in ranges for n in pair):
        return f"multiplexer values above {LAST_MUX}", text
    if any(int(low) > int(high) for low, high in ranges):
        return "a range of multiplexer values that ends before it begins", text
    values = ", ".join(f"{low}-{high}" for low, high in ranges)
    return "", f"SG_MUL_VAL_ {match[1]} {match[2]} {match[3]} {values};"


def labels_of(text: str) -> tuple[str, str]:
    """Which labels of a VAL_ cannot be used (empty: none), and its text with the others."""
    match = _LABELS.fullmatch(text)
    if match is None:
        return "", text
    pairs = _LABEL.findall(match[2])
    good = [(n, label) for n, label in pairs if re.fullmatch(r"[-+]?\d{1,20}", n)]
    if len(good) == len(pairs):
        return "", text
    bad = ", ".join(n[:40] for n, label in pairs if (n, label) not in good)
    return (
        f"the label of {bad} is left out: no whole number of 64 bits",
        f"{match[1]} {' '.join(f'{n} {label}' for n, label in good)} ;",
    )
