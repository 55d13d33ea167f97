"""Ticks of a run in columns, from which its tables, pictures and intervals are made.

The core keeps a row of each tick (`gateway/core/tick_log.c`); the rest processes many at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from _traction_core import ffi, lib
from numpy.typing import NDArray

from dbc.arrays import Array
from dbc.records import DRIVE_ROW, TICK_LOG, TICK_ROW, Records
from gateway.core.gateway import Gateway

MOST: Final = 8
"""Ticks processed together while a live loop waits for them."""
MOST_OF_LOG: Final = 512
"""Ticks processed together if no loop waits: less than 1 MB for three drives."""
WEAR: Final = ("degradation_k_h", "degradation_sigma_k_h", "hours_to_limit")


class Ticks(NamedTuple):
    """K ticks of N drives, in the order of time.

    t_ns (K,); drives (K, N) of `drive_status`; train (K,) of `train_status`. NaN if a value is not
    known: bus_load_percent (K,); wear (K, N, 3): K/h, its sigma, h to the limit; celsius
    (K, N, 4): readings received in the tick.
    """

    t_ns: NDArray[np.int64]
    drives: Records
    train: Records
    bus_load_percent: Array
    wear: Array
    celsius: Array


Use = Callable[[Ticks], None]


class TickLog:
    """Keeps ticks of a gateway, and passes them on, many at a time."""

    def __init__(self, uses: Sequence[Use], most: int = MOST) -> None:
        """uses: functions that get the ticks, in this order; most: ticks at a time."""
        self._uses = uses
        self._most = most
        self.follows = False
        """Whether `follow` was called."""
        self._drives = 0
        self._log: Any = ffi.NULL

    def append(self, gateway: Gateway) -> None:
        """Keep the last tick of the gateway."""
        if self._drives != len(gateway.nodes):
            self._allocate(gateway)
        lib.log_tick(gateway.pointer, self._log, gateway.now_ns)
        self._flush_full()

    def follow(self, gateway: Gateway) -> None:
        """Keep its last tick, and let the core keep all later ones; call it after each `run`."""
        if not self.follows:
            self.append(gateway)
            gateway.keep_ticks(self._log)
            self.follows = True
        self._flush_full()

    def _flush_full(self) -> None:
        if self._log.count == self._most:
            self.flush()

    def _allocate(self, gateway: Gateway) -> None:
        """Allocate the log for the number of drives of this gateway."""
        self.flush()
        self._drives = len(gateway.nodes)
        # One piece of memory: a followed gateway keeps it alive as long as its address.
        self._rows = np.zeros(1, [
            ("log", TICK_LOG), ("ticks", TICK_ROW, (self._most,)),
            ("drives", DRIVE_ROW, (self._most, self._drives)),
        ])  # fmt: skip
        for name in ("ticks", "drives"):
            self._rows["log"][name] = self._rows[name].ctypes.data
        self._log = ffi.from_buffer("struct tick_log *", self._rows)
        self._log.capacity, self._log.limit_k = self._most, gateway.thermal.limit_k

    def flush(self) -> None:
        """Pass on the ticks that are kept."""
        count = self._log.count if self._drives else 0
        if not count:
            return
        rows, drives = (self._rows[name][0, :count].copy() for name in ("ticks", "drives"))
        self._log.count = 0
        wear = np.stack([drives[name] for name in WEAR], axis=2)
        ticks = Ticks(rows["t_ns"], drives["status"], rows["train"], rows["bus_load_percent"],
                      wear, drives["celsius"])  # fmt: skip
        for use in self._uses:
            use(ticks)
