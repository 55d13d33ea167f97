"""What a run was like over time, for pictures: smallest and largest values, in flat memory.

A run of any length is kept as at most `MOST` stretches of equally many ticks, each with the
smallest and the largest value of every column: a spike of one tick in an hour is still in the
picture.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.core.codes import Flag
from gateway.core.inbox import Temperatures
from gateway.core.view import GatewayView

Array = NDArray[np.float64]

MOST: Final = 1024
"""A figure is less than 600 points wide, and there are never less than half as many."""
CHUNK: Final = 512
"""Ticks that are kept as they came until they are put together; divides `MOST`."""
COLUMNS: Final = (
    "load_nm", "low_nm", "high_nm", "loss_probability", "speed_rad_s", "adhesion", "thermal",
    "mixed_c", "maisd_k", "stator_c", "drive_end_c", "non_drive_end_c", "ambient_c",
)  # fmt: skip
"""Of a drive. low, high: the estimate's band of two sigma."""
OF_ALL: Final = ("bus_load_percent",)
POINTS: Final = COLUMNS[-4:]
RANK: Final = {Flag.GOOD: 1.0, Flag.UNKNOWN: 2.0, Flag.BAD: 3.0}
"""Of a stretch with several flags the largest is shown: bad hides nothing that matters more."""
_NAN: Final = float("nan")
_NO_POINTS: Final = (_NAN,) * len(POINTS)


class Curve(NamedTuple):
    """One column. t_s: begin of each stretch, (K,); low, high: (K,), NaN where nothing is known."""

    t_s: Array
    low: Array
    high: Array

    @property
    def known(self) -> bool:
        """Whether there is anything to draw."""
        return bool(np.isfinite(self.low).any())


class Envelope:
    """Rows of (t_s, C columns), put together as they come. Memory: 2 x `most` rows, and a chunk."""

    def __init__(self, columns: int, most: int = MOST) -> None:
        """most: a multiple of `CHUNK`."""
        self.width = 1
        """Rows in a stretch."""
        self.used = 0
        self._most = most
        self._columns = columns + 1
        self._low = np.full((most, self._columns), _NAN)
        self._high = np.full((most, self._columns), _NAN)
        self._raw = array("d")
        self._rows = 0
        self._open = 0
        """Chunks in the last stretch, where it takes several and is not full yet."""

    def add(self, row: Sequence[float]) -> None:
        """Take one row: seconds, then the columns; NaN where a value is not known."""
        self._raw.extend(row)
        self._rows += 1
        if self._rows == CHUNK:
            self._put()

    def curve(self, column: int) -> Curve:
        """One column of what came so far, counted from 0 without the time."""
        self._put()
        end = self.used
        t_s, k = self._low[:end, 0], column + 1
        return Curve(t_s, self._low[:end, k], self._high[:end, k])

    @property
    def last_s(self) -> float:
        """Time of the last row; NaN before any."""
        self._put()
        return self._high.item(self.used - 1, 0) if self.used else _NAN

    def _put(self) -> None:
        """Put the chunk together with what is there."""
        if not self._rows:
            return
        rows = np.frombuffer(self._raw).reshape(self._rows, self._columns)
        if not self._open:
            while self.used + -(-self._rows // self.width) > self._most:
                self._halve()
        per = min(self.width, CHUNK)
        if short := -self._rows % per:
            rows = np.concatenate((rows, np.full((short, self._columns), _NAN)))
        stretches = rows.reshape(-1, per, self._columns)
        low, high = np.fmin.reduce(stretches, axis=1), np.fmax.reduce(stretches, axis=1)
        if self._open:
            at = slice(self.used - 1, self.used)
            low, high = np.fmin(low, self._low[at]), np.fmax(high, self._high[at])
        else:
            at = slice(self.used, self.used + len(low))
            self.used += len(low)
        self._low[at], self._high[at] = low, high
        self._open = (self._open + 1) % max(self.width // CHUNK, 1)
        self._raw = array("d")
        self._rows = 0

    def _halve(self) -> None:
        """Two neighbours become one."""
        half = self.used // 2
        self._low[:half] = np.fmin(self._low[0 : 2 * half : 2], self._low[1 : 2 * half : 2])
        self._high[:half] = np.fmax(self._high[0 : 2 * half : 2], self._high[1 : 2 * half : 2])
        self.used = half
        self.width *= 2


class Trace:
    """All columns of all drives. Seconds count from the first tick."""

    def __init__(self, nodes: tuple[int, ...]) -> None:
        """nodes: in the order in which a view has its drives."""
        self.nodes = nodes
        self.first_ns: int | None = None
        self.last_ns = 0
        self.ticks = 0
        self._envelope = Envelope(len(OF_ALL) + len(COLUMNS) * len(nodes))
        self._loads = (float("inf"), float("-inf"), 0.0, 0)

    def add(self, view: GatewayView, readings: Iterable[Temperatures] = ()) -> None:
        """Take one tick; readings: of the temperatures that came in it."""
        if self.first_ns is None:
            self.first_ns = view.t_ns
        self.last_ns = view.t_ns
        self.ticks += 1
        load = view.bus_load_percent
        if load is not None:
            least, most, total, count = self._loads
            self._loads = min(least, load), max(most, load), total + load, count + 1
        row = [(view.t_ns - self.first_ns) / 1e9, _NAN if load is None else load]
        points = {reading.drive: reading.celsius for reading in readings}
        for k, d in enumerate(view.drives):
            middle = d.load_nm
            band = 2.0 * (d.load_sigma_nm or 0.0)
            row += (
                _NAN if middle is None else middle,
                _NAN if middle is None else middle - band,
                _NAN if middle is None else middle + band,
                _NAN if d.loss_probability is None else d.loss_probability,
                _NAN if d.speed_rad_s is None else d.speed_rad_s,
                RANK[d.adhesion],
                RANK[d.thermal],
                _NAN if d.mixed_c is None else d.mixed_c,
                _NAN if d.maisd_k is None else d.maisd_k,
                *points.get(k, _NO_POINTS),
            )
        self._envelope.add(row)

    @property
    def width(self) -> int:
        """Ticks in a stretch: 1 where nothing was put together."""
        return self._envelope.width

    @property
    def span_s(self) -> float:
        """From the first tick to the last."""
        return 0.0 if self.first_ns is None else (self.last_ns - self.first_ns) / 1e9

    @property
    def bus_load(self) -> tuple[float, float, float] | None:
        """Least, mean and most, percent; None where no full second was measured."""
        least, most, total, count = self._loads
        return (least, total / count, most) if count else None

    def of_all(self, column: str) -> Curve:
        """One of `OF_ALL`."""
        return self._envelope.curve(OF_ALL.index(column))

    def curve(self, node: int, column: str) -> Curve:
        """One of `COLUMNS` of a drive."""
        place = self.nodes.index(node) * len(COLUMNS)
        return self._envelope.curve(len(OF_ALL) + place + COLUMNS.index(column))
