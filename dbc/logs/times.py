"""Times of log lines: dates, times of day, and differences from the stamp before."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dbc.frame import SECOND

_DATE: Final = re.compile(r"(.*?)(?:[.,](\d{1,9}))?(Z|[+-]\d\d:?\d\d)?", re.DOTALL)
EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
DAY_NS: Final = 86_400 * SECOND
_CSS: Final = re.compile(
    r"(?:(\d{4})[-/.]?(\d\d)[-/.]?)?(\d\d)T(\d\d)[:.]?(\d\d)[:.]?(\d\d)[:.,]?(\d{3})?"
)


def clock_ns(text: str) -> int:
    """Nanoseconds of a time of day, `22:20:14.992`, also with a colon or comma for the point.

    Behind a colon, up to three digits are a number of ms, which SavvyCAN writes without zeros.
    Hours have no limit, because it may be a time since a start. Raises ValueError.
    """
    hours, minutes, rest = text.split(":", 2)
    second, colon, ms = rest.partition(":")
    rest = f"{second}.{ms:0>3}" if colon else rest
    seconds, _, fraction = rest.replace(",", ".").partition(".")
    if int(minutes) >= 60 or int(seconds) >= 60:
        raise ValueError(text)
    whole = (int(hours) * 60 + int(minutes)) * 60 + int(seconds)
    return whole * SECOND + int(fraction.ljust(9, "0"))


def date_ns(text: str) -> int:
    """Exact nanoseconds of an ISO 8601 date; UTC if it has no zone. Raises ValueError."""
    match = _DATE.fullmatch(text.strip())
    date, fraction, zone = match.groups() if match else (text, None, None)
    if ":" not in date:
        # Else the month behind a year would be taken for a zone.
        date, fraction, zone = text.strip(), None, None
    moment = datetime.fromisoformat(date + (zone or ""))
    return epoch_ns(moment) + int((fraction or "").ljust(9, "0"))


def epoch_ns(moment: datetime) -> int:
    """Nanoseconds since 1970; UTC if the moment has no zone."""
    moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    return (moment - EPOCH) // timedelta(microseconds=1) * 1000


class DayTimes:
    """Times of day that continue past midnight, a step back by more than half a day."""

    def __init__(self, day_ns: int = DAY_NS) -> None:
        """Start on day 0. day_ns: another period, after which times begin again at 0."""
        self._day_ns = day_ns
        self._days = 0
        self._last_ns = 0

    def continued(self, times: NDArray[np.int64], timed: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Times of consecutive lines; lines that are not `timed` have no time."""
        stamps = times[timed]
        if not stamps.size:
            return times
        back = np.diff(stamps, prepend=self._last_ns) < -self._day_ns // 2
        days = self._days + np.cumsum(back)
        self._days, self._last_ns = days.item(-1), stamps.item(-1)
        moved = times.copy()
        moved[timed] = stamps + days * self._day_ns
        return moved


class Differences:
    """Sums of stamps that count from the line before."""

    def __init__(self, last_ns: int = 0) -> None:
        """last_ns: the time of the line before the first one."""
        self._last_ns = last_ns

    def continued(self, times: NDArray[np.int64], timed: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Times of consecutive lines; lines that are not `timed` have no time."""
        if not timed.any():
            return times
        total: NDArray[np.int64] = np.cumsum(np.where(timed, times, 0)) + self._last_ns
        self._last_ns = total.item(-1)
        return total


def logger_ns(text: str, start: datetime | None) -> int:
    """Nanoseconds of a CL1000/CL2000 stamp: `20230515T100000250`, or `15T100000250` with the day.

    start: start of the log; a day without a month is in its month, or in the next one. Without
    `start` it is in January 1970. Raises ValueError.
    """
    match = _CSS.fullmatch(text)
    if match is None:
        raise ValueError(text)
    year, month, *rest = match.groups()
    day, hour, minute, second, ms = (int(part or 0) for part in rest)
    if year is None:
        month_start = (start or EPOCH).replace(day=1, hour=0, minute=0, second=0)
        if start is not None and day < start.day:
            month_start = (month_start + timedelta(days=31)).replace(day=1)
        year, month = month_start.year, month_start.month
    moment = datetime(int(year), int(month), day, hour, minute, second, ms * 1000, UTC)
    return epoch_ns(moment)
