"""Log lines on stderr: bounded by place in the code, text or JSON, marked for the journal.

A storm on the bus must not become one in the log: every place that logs may do so ten times a
minute; how many lines were left out is said with the next one. Places are lines of code, so the
memory is bounded as well.
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
"""Levels of syslog(3), as sd-daemon(3) has them before a line."""


_USUAL: Final = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName"}


class Limited(logging.Filter):
    """At most `MOST` lines in `WINDOW_S` from one place in the code."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """`clock` in seconds, for tests."""
        super().__init__()
        self._clock = clock
        self._seen: dict[tuple[str, int], list[float]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether the line goes out; the first after some that did not says how many."""
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
        """Lines left out that no later line has told of."""
        return round(sum(window[2] for window in self._seen.values()))


class Marked(logging.Formatter):
    """Lines of another form with the level in front, as the journal wants it."""

    def __init__(self, inner: logging.Formatter) -> None:
        """`inner` makes the lines."""
        super().__init__()
        self._inner = inner

    def format(self, record: logging.LogRecord) -> str:
        """`<4>name: message`; further lines, of a traceback, get the level too."""
        mark = f"<{_LEVELS.get(record.levelno, 5)}>"
        return "\n".join(mark + line for line in self._inner.format(record).splitlines())


class Text(logging.Formatter):
    """A line to a message; names of others in it cannot end the line or move the cursor."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        """Control characters are escaped."""
        record.message = printable(record.message, len(record.message))
        return super().formatMessage(record)


class Json(logging.Formatter):
    """One object to a line: time (UTC), level, logger, message, what the record has besides."""

    def format(self, record: logging.LogRecord) -> str:
        """Values that JSON does not have go in as text; a traceback is one of the fields."""
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
    """Whether a stream is systemd's journal: `JOURNAL_STREAM` names its device and inode."""
    try:
        there = os.fstat(stream.fileno())
    except (OSError, ValueError):
        return False
    return given.get("JOURNAL_STREAM") == f"{there.st_dev}:{there.st_ino}"


def begin(level: int, form: str = "text") -> Limited:
    """Log to stderr from `level` up. Returns the limit, to ask at the end what was left out."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_formatter(form))
    limit = Limited()
    handler.addFilter(limit)
    logging.basicConfig(level=level, handlers=[handler])
    return limit


def reshape(form: str) -> None:
    """Another form for what `begin` began."""
    for handler in logging.getLogger().handlers:
        handler.setFormatter(_formatter(form))


def say(text: str, form: str, level: int = logging.ERROR) -> None:
    """The last word of a program, never limited: the bare text, or a line of the log as JSON."""
    if form == "json":
        record = logging.LogRecord("traction-gateway", level, "", 0, text, None, None)
        text = _formatter(form).format(record)
    sys.stderr.write(text + "\n")


def _formatter(form: str) -> logging.Formatter:
    journal = to_journal(sys.stderr, os.environ)
    made: logging.Formatter = Json()
    if form == "text":
        # The journal has the level of its own.
        level = "" if journal else "%(levelname)s "
        made = Text(level + "%(name)s: %(message)s")
    return Marked(made) if journal else made
