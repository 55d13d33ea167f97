"""Dates behind `Begin Triggerblock` of an ASC, in the language and order of the recorder."""

from __future__ import annotations

import re
from contextlib import suppress
from datetime import datetime, timedelta
from typing import Final

_MONTHS: Final = {
    name: number
    for number, names in enumerate(
        ("jan jän ene gen", "feb fév fev", "mar mär mrz", "apr avr abr", "may mai mag",
         "jun jui giu", "jul lug juil", "aug aoû ago", "sep set", "oct okt ott out", "nov",
         "dec dez déc dic"), 1,
    )
    for name in names.split()
}  # fmt: skip
"""Month by its first letters, as Windows writes them in several languages."""
_TIME: Final = re.compile(r"\b(\d{1,2}):(\d\d):(\d\d)(?:[.,](\d{1,9}))?\b")
_NUMBERS: Final = (
    ("ymd", re.compile(r"\b(\d{4})[-./](\d{1,2})[-./](\d{1,2})\b")),
    ("dmy", re.compile(r"\b(\d{1,2})[-.](\d{1,2})[-.](\d{4})\b")),
    ("mdy", re.compile(r"\b(\d{1,2})/(\d{1,2})/(\d{4})\b")),
)
_DAY: Final = re.compile(r"(?<!\S)(\d{1,2})\.?(?!\S)")
_YEAR: Final = re.compile(r"(?<!\S)(\d{4})(?!\S)")
_AFTERNOON: Final = re.compile(r"(?<!\S)(?:p\.? ?m\b|nachm)", re.I)
_FORENOON: Final = re.compile(r"(?<!\S)(?:a\.? ?m\b|vorm)", re.I)


def date_of(text: str) -> datetime | None:
    """Date and time without a zone; None if the language or order is not known."""
    with suppress(UnicodeError):  # not UTF-8: cp1252, whose letters are those of latin-1
        text = text.encode("latin-1").decode("utf-8")
    clock = _TIME.search(text)
    day = _day_of(text[: clock.start()] + " " + text[clock.end() :]) if clock else None
    if clock is None or day is None:
        return None
    hour, minute, second = int(clock[1]), int(clock[2]), int(clock[3])
    if hour <= 12 and _AFTERNOON.search(text):
        hour = hour % 12 + 12
    elif hour <= 12 and _FORENOON.search(text):
        hour %= 12
    try:
        return datetime(*day, hour, minute, second, int((clock[4] or "0").ljust(6, "0")[:6]))  # noqa: DTZ001 only differences are used
    except ValueError:
        return None


def _day_of(text: str) -> tuple[int, int, int] | None:
    """Year, month and day of a date."""
    for order, pattern in _NUMBERS:
        if match := pattern.search(text):
            parts = dict(zip(order, map(int, match.groups()), strict=True))
            return parts["y"], parts["m"], parts["d"]
    words = text.lower().split()
    months = [m for w in words if (m := _MONTHS.get(w[:4]) or _MONTHS.get(w[:3]))]
    day, year = _DAY.search(text), _YEAR.search(text)
    if not (months and day and year):
        return None
    # The last match is the month: `mar` is also a day of the week.
    return int(year[1]), months[-1], int(day[1])


def nanoseconds_between(first: datetime, later: datetime) -> int:
    """Time from `first` to `later` in nanoseconds, at least 0."""
    return max((later - first) // timedelta(microseconds=1), 0) * 1000
