"""Measure how long evidence of lost adhesion lasts where nothing is lost.

For `[adhesion] fault_free`: the flags of a gateway that raises and clears them without delay show
the evidence. Unknown evidence clears no flag, so a time that it interrupts is measured as longer.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from dbc.arrays import Ints
from dbc.frame import MS, SECOND, Nanos
from estimators.tolerance import STORED
from gateway.core.codes import Flag
from gateway.core.gateway import Gateway
from gateway.settings.config import Config

MINUTE_NS: Final = 60 * SECOND
AT_ONCE: Final = {
    "raise_ms": 0, "raise_severe_ms": 0, "clear_ms": 0, "false_alarms_per_1000_h": None,
    "fault_free": None,
}  # fmt: skip


def at_once(config: Config) -> Config:
    """The same configuration, but its adhesion flags follow the evidence without delay."""
    return config.model_copy(update={"adhesion": config.adhesion.model_copy(update=AT_ONCE)})


class Evidence:
    """Longest evidence of a loss in every minute, over several logs, joined end to end."""

    def __init__(self) -> None:
        """Begin with the first log."""
        self._longest: dict[int, Nanos] = {}
        self._begun: dict[int, Nanos] = {}
        self._before: Nanos = 0
        self._start: Nanos = 0

    def begin_log(self, start_ns: Nanos) -> None:
        """Start a log at this time of its gateway's clock."""
        self._start = start_ns

    def follow_flags(self, gateway: Gateway) -> None:
        """Take the flags of a tick in which one of them has changed."""
        now = gateway.now_ns
        for k, state in enumerate(gateway.status.drives["flag"]["state"][:, 0].tolist()):
            if state == Flag.BAD:
                self._begun.setdefault(k, now)
            elif k in self._begun:
                self._end(k, now)

    def end_log(self, now_ns: Nanos) -> None:
        """End a log at this time: evidence that lasts ends here."""
        for k in list(self._begun):
            self._end(k, now_ns)
        self._before += max(now_ns - self._start, 0)

    def _end(self, k: int, now: Nanos) -> None:
        minute = (self._before + now - self._start) // MINUTE_NS
        lasted = now - self._begun.pop(k)
        self._longest[minute] = max(self._longest.get(minute, 0), lasted)

    @property
    def longest_ms(self) -> Ints:
        """(M,) longest evidence of any drive in each whole minute, in the order of time, ms."""
        minutes = range(self._before // MINUTE_NS)
        return np.array([-(-self._longest.get(k, 0) // MS) for k in minutes], dtype=np.int64)


def largest(longest_ms: Ints) -> list[int]:
    """The times of the worst minutes, descending, as `fault_free` keeps them."""
    times: list[int] = np.sort(longest_ms)[::-1][:STORED].tolist()
    return times
