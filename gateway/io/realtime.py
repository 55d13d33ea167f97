"""Fixed-rate loop on absolute monotonic deadlines, and a histogram of its lateness.

A late tick is not made up for: missed ticks are skipped and counted, the next deadline is on the
original grid, and the caller gets the true time.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

from dbc.frame import SECOND, Nanos

_SUB_BITS = 2
_SUB = 1 << _SUB_BITS


class Histogram:
    """Counts of non-negative integers in four buckets per octave; never grows.

    Relative width of a bucket is at most 1/4; values below 8 are exact.
    """

    def __init__(self) -> None:
        """Start empty, with buckets for any 64-bit value."""
        self.counts = [0] * (64 * _SUB)
        self.total = 0
        self.largest = 0

    def count(self, value: int) -> None:
        """Count one value; negative counts as zero."""
        value = max(value, 0)
        self.counts[min(_bucket(value), len(self.counts) - 1)] += 1
        self.total += 1
        self.largest = max(self.largest, value)

    def quantile(self, fraction: float) -> int:
        """Smallest bucket end that `fraction` of the values do not exceed; 0 if empty.

        Never more than the largest value counted; an upper bound that is at most 25 % too high.
        """
        wanted = fraction * self.total
        seen = 0
        for bucket, count in enumerate(self.counts):
            seen += count
            if count and seen >= wanted:
                return min(_bucket_end(bucket), self.largest)
        return 0

    def octaves(self) -> list[tuple[int, int, int]]:
        """(from, below, count) by powers of two, from the first with a value to the last."""
        sums: dict[int, int] = {}
        for bucket, count in enumerate(self.counts):
            if count:
                octave = _bucket_end(bucket).bit_length()
                sums[octave] = sums.get(octave, 0) + count
        span = range(min(sums, default=0), max(sums, default=-1) + 1)
        return [((1 << k) >> 1, 1 << k, sums.get(k, 0)) for k in span]


def _bucket(value: int) -> int:
    shift = max(value.bit_length() - 1 - _SUB_BITS, 0)
    return (shift << _SUB_BITS) + (value >> shift)


def _bucket_end(bucket: int) -> int:
    """Largest value that falls into the bucket."""
    shift = max((bucket >> _SUB_BITS) - 1, 0)
    return ((bucket - (shift << _SUB_BITS) + 1) << shift) - 1


class Tick(NamedTuple):
    """One turn of the loop."""

    number: int
    """Number on the grid since the start; missed ticks count."""
    now_ns: Nanos
    """Time of waking on the ticker's clock."""
    missed: int
    """Ticks skipped just before this one."""


class Ticker:
    """Wakes every `period_ns`, on the grid start + k * period."""

    def __init__(
        self,
        period_ns: Nanos,
        clock: Callable[[], Nanos] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Take the period and, for tests, a clock in ns and a sleep in seconds.

        Raises ValueError for a period that is not positive.
        """
        if period_ns <= 0:
            raise ValueError(f"period_ns must be positive, not {period_ns}")
        self.period_ns = period_ns
        self.clock = clock
        self._sleep = sleep
        self._start_ns: Nanos | None = None
        self._number = -1
        self.missed = 0
        """All ticks skipped so far."""
        self.lateness = Histogram()
        """Time of waking after the deadline, ns."""

    def wait(self) -> Tick:
        """Sleep until the next deadline. The first call returns at once and starts the grid."""
        now = self.clock()
        if self._start_ns is None:
            self._start_ns = now
        self._number += 1
        deadline = self._start_ns + self._number * self.period_ns
        # Python's sleep uses an absolute monotonic deadline and resumes after signals (PEP 475);
        # the loop handles sleeps that end early.
        while now < deadline:
            self._sleep((deadline - now) / SECOND)
            now = self.clock()
        late = now - deadline
        self.lateness.count(late)
        missed = late // self.period_ns
        self._number += missed
        self.missed += missed
        return Tick(self._number, now, missed)
