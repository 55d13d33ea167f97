"""Ticks of a run in columns: what its tables, pictures and intervals are made from.

A tick costs a copy of the status; the rest is done for many ticks together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.records import DRIVE_STATUS, TRAIN_STATUS, Records
from gateway.core.gateway import Gateway
from gateway.core.view import Wear

Array = NDArray[np.float64]

MOST: Final = 8
"""Ticks that are worked on together where a live loop waits for them."""
MOST_OF_LOG: Final = 512
"""The same where nobody waits: less than 1 MB of three drives."""
POINTS: Final = 4
_NAN: Final = float("nan")


class Ticks(NamedTuple):
    """K ticks of N drives, in their order.

    t_ns (K,); drives (K, N) of `drive_status`, train (K,) of `train_status`. NaN where a value is
    not known: bus_load_percent (K,); wear (K, N, 3): K/h, its sigma, h to the limit; celsius
    (K, N, 4): of readings that came in the tick.
    """

    t_ns: NDArray[np.int64]
    drives: Records
    train: Records
    bus_load_percent: Array
    wear: Array
    celsius: Array


Use = Callable[[Ticks], None]


class TickLog:
    """Notes ticks of a gateway, and hands them on, many at a time."""

    def __init__(self, uses: Sequence[Use], most: int = MOST) -> None:
        """uses: who gets them, in this order; most: ticks at a time."""
        self._uses = uses
        self._most = most
        self._times: list[int] = []
        self._drives: list[bytes] = []
        self._train: list[bytes] = []
        self._load: list[float] = []
        self._wear: list[Array] = []
        self._readings: list[tuple[int, int, tuple[float, ...]]] = []
        self._wear_of: object = None
        self._worn = np.zeros((0, 3))

    def append(self, gateway: Gateway) -> None:
        """The gateway's last tick."""
        if gateway.inbox.receiver.pointer.tick.temperatures:
            now = len(self._times)
            self._readings += [(now, r.drive, r.celsius) for r in gateway.inbox.temperatures]
        load = gateway.load.percent(gateway.now_ns)
        self._times.append(gateway.now_ns)
        self._drives.append(gateway.status.drives.tobytes())
        self._train.append(gateway.status.train.tobytes())
        self._load.append(_NAN if load is None else load)
        self._wear.append(self._worn_now(gateway))
        if len(self._times) == self._most:
            self.flush()

    def _worn_now(self, gateway: Gateway) -> Array:
        """(N, 3); it changes with a temperature cycle, or with what is fresh."""
        thermal = gateway.thermal
        state = thermal.cycles, thermal.motors["fresh"].tobytes()
        if state != self._wear_of:
            self._wear_of = state
            self._worn = np.array([_numbers(wear) for wear in thermal.wear])
        return self._worn

    def flush(self) -> None:
        """Hand on what was noted."""
        count = len(self._times)
        if not count:
            return
        drives = np.frombuffer(b"".join(self._drives), DRIVE_STATUS).reshape(count, -1)
        celsius = np.full((count, drives.shape[1], POINTS), _NAN)
        for tick, drive, values in self._readings:
            celsius[tick, drive] = values
        ticks = Ticks(
            np.array(self._times), drives, np.frombuffer(b"".join(self._train), TRAIN_STATUS),
            np.array(self._load), np.array(self._wear), celsius,
        )  # fmt: skip
        for held in (
            self._times, self._drives, self._train, self._load, self._wear, self._readings,
        ):  # fmt: skip
            held.clear()
        for use in self._uses:
            use(ticks)


def _numbers(wear: Wear) -> tuple[float, ...]:
    """NaN where one is not known."""
    values = wear.rate_k_h, wear.sigma_k_h, wear.hours
    return tuple(_NAN if value is None else value for value in values)
