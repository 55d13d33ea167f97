"""Log lines on stderr: rate-limited by line of code, text or JSON, with levels for the journal.

A storm on the bus must not cause one in the log: every line of code may log ten times a minute;
the next line from it gives the number suppressed. The number of lines of code bounds the memory
as well.
"""

from __future__ import annotations

import json
import logging
import os
import sys
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any, Final, TextIO

from dbc.text import printable

MOST: Final = 10
WINDOW_S: Final = 60.0
_LEVELS: Final = {
    logging.DEBUG: 7, logging.INFO: 6, logging.WARNING: 4, logging.ERROR: 3, logging.CRITICAL: 2,
}  # fmt: skip
"""Levels of syslog(3), which sd-daemon(3) expects before a line."""


_USUAL: Final = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName"}


class Limited(logging.Filter):
    """Passes at most `MOST` records in `WINDOW_S` from one line of code."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """`clock` in seconds, for tests."""
        super().__init__()
        self._clock = clock
        self._seen: dict[tuple[str, int], list[float]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether the record is logged; the first after suppressed ones gets their number."""
        now = self._clock()
        window = self._seen.setdefault((record.pathname, record.lineno), [now, 0, 0])
        if now - window[0] >= WINDOW_S:
            window[:2] = now, 0
        if window[1] >= MOST:
            window[2] += 1
            return False
        window[1] += 1
        if window[2]:
            record.msg = f"{record.getMessage()} ({window[2]:.0f} more suppressed)"
            record.args = ()
            window[2] = 0
        return True

    def suppressed(self) -> int:
        """Number of suppressed records that no later one has reported."""
        return round(sum(window[2] for window in self._seen.values()))


class Marked(logging.Formatter):
    """Lines of another formatter with the level in front, as the journal expects it."""

    def __init__(self, inner: logging.Formatter) -> None:
        """`inner` formats the lines."""
        super().__init__()
        self._inner = inner

    def format(self, record: logging.LogRecord) -> str:
        """`<4>name: message`; the further lines of a traceback get the level as well."""
        mark = f"<{_LEVELS.get(record.levelno, 5)}>"
        return "\n".join(mark + line for line in self._inner.format(record).splitlines())


class Text(logging.Formatter):
    """One line per message; foreign names in it cannot end the line or move the cursor."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        """Format the message with control characters escaped."""
        record.message = printable(record.message, len(record.message))
        return super().formatMessage(record)


class Json(logging.Formatter):
    """One object per line: time (UTC), level, logger, message, the record's extra fields."""

    def format(self, record: logging.LogRecord) -> str:
        """Values without a JSON type become text; a traceback is one of the fields."""
        fields: dict[str, Any] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        fields |= {k: v for k, v in vars(record).items() if k not in _USUAL and k not in fields}
        if record.exc_info:
            fields["traceback"] = self.formatException(record.exc_info)
        return json.dumps(fields, default=str)


def to_journal(stream: TextIO, given: Mapping[str, str]) -> bool:
    """Whether a stream is systemd's journal; `JOURNAL_STREAM` gives its device and inode."""
    try:
        there = os.fstat(stream.fileno())
    except (OSError, ValueError):
        return False
    return given.get("JOURNAL_STREAM") == f"{there.st_dev}:{there.st_ino}"


def begin(level: int, form: str = "text") -> Limited:
    """Log to stderr from `level` up. Return the filter, which counts suppressed records."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_formatter(form))
    limit = Limited()
    handler.addFilter(limit)
    logging.basicConfig(level=level, handlers=[handler])
    return limit


def reshape(form: str) -> None:
    """Change the form of the log lines after `begin`."""
    for handler in logging.getLogger().handlers:
        handler.setFormatter(_formatter(form))


def say(text: str, form: str, level: int = logging.ERROR) -> None:
    """Write a program's last message, never rate-limited: the bare text, or a JSON log line."""
    if form == "json":
        record = logging.LogRecord("traction-gateway", level, "", 0, text, None, None)
        text = _formatter(form).format(record)
    sys.stderr.write(text + "\n")


def _formatter(form: str) -> logging.Formatter:
    journal = to_journal(sys.stderr, os.environ)
    made: logging.Formatter = Json()
    if form == "text":
        # The journal has its own field for the level.
        level = "" if journal else "%(levelname)s "
        made = Text(level + "%(name)s: %(message)s")
    return Marked(made) if journal else made
