"""Explain why cantools rejects a DBC: which line, what is wrong with it, what to do.

cantools reports where its parser stopped, or names entries without a line. Two causes are common
in foreign files and have a sure cure; for any other syntax error the line is reported.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

SYNTAX: Final = re.compile(r"Invalid syntax at line (\d+), column (\d+)")
_UNUSED: Final = re.compile(r"VAL_ (\d+) (\w+)")
_MESSAGE: Final = re.compile(rb"\s*BO_\s+\d+\s")
_NAMED: Final = re.compile(rb"\s*BO_\s+\d+\s+(\w+)\s*:")
_SIGNAL: Final = re.compile(rb"\s*SG_\s+(\w+)")
_PLACE: Final = re.compile(r"(\w+)(?:\.(\w+))?: ")
_NODES: Final = re.compile(rb"^\s*BU_\s*:", re.MULTILINE)


@contextmanager
def quiet() -> Iterator[None]:
    """Hide the warnings of cantools, which only logs duplicates; `dbc.layout` lists them."""
    logger = logging.getLogger("cantools.database.can.database")
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)


def one_line(error: Exception) -> str:
    """Message of an error of cantools, in one line; the error's name if it has none."""
    text = " ".join(str(error).split()).removeprefix("DBC: ")
    return text.strip('"') or type(error).__name__


def explained(message: str, text: bytes) -> list[str]:
    """Problems with their cures, one a line, from the one-line `message` of cantools for a file."""
    lines = text.splitlines()
    if message.startswith("unused VAL_ entries"):
        return list(_unused(message, lines)) or [message]
    if match := SYNTAX.match(message):
        number = int(match[1])
        if 1 <= number <= len(lines) and _MESSAGE.match(lines[number - 1]):
            before = b"\n".join(lines[: number - 1])
            if not _NODES.search(before):
                return [
                    f"line {number}: the first message (BO_) stands before any list of nodes; "
                    f'add a line "BU_: XXX" above it ({message})'
                ]
        return [f"{message}; correct this line, or the one before it, or take both out"]
    return [message]


def placed(fault: str, text: bytes) -> str:
    """A fault `Message.Signal: ..` or `Message: ..`, with the line of that signal or message."""
    found = _PLACE.match(fault)
    names = [name.encode() if name else None for name in found.groups()] if found else [None] * 2
    inside = False
    for number, line in enumerate(text.splitlines(), 1):
        if message := _NAMED.match(line):
            inside = message[1] == names[0]
            if inside and names[1] is None:
                return f"{fault} (line {number})"
        elif inside and (signal := _SIGNAL.match(line)) and signal[1] == names[1]:
            return f"{fault} (line {number})"
    return fault


def _unused(message: str, lines: list[bytes]) -> Iterator[str]:
    """Yield a problem for each value table whose message or signal the file does not have."""
    for can_id, signal in dict.fromkeys(_UNUSED.findall(message)):
        table = re.compile(rf"\s*VAL_\s+{can_id}\s+{signal}\s".encode())
        found = [k for k, line in enumerate(lines, 1) if table.match(line)]
        # A table in another encoding or over two lines is not found: reported without a line.
        for where in [f"line {k}: " for k in found] or [""]:
            yield (
                f"{where}VAL_ {can_id} {signal}: a value table of a signal that the file does not "
                f"have; delete the line, or define {signal} in message {can_id}"
            )
