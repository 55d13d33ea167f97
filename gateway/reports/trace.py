"""Smallest and largest values of a run over time, for pictures, in constant memory.

A run of any length is kept as at most `MOST` bins of equally many ticks. Each bin has the smallest
and the largest value of every column, so that a spike of one tick in an hour is still in the
picture.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from dbc.arrays import Array
from gateway.core.codes import Flag
from gateway.core.flags import FlagKind

if TYPE_CHECKING:
    from gateway.reports.ticks import Ticks


MOST: Final = 1024
"""Most bins; a long run has at least half as many, and a figure is less than 600 points wide."""
CHUNK: Final = 512
"""Number of ticks that are kept unchanged until they are merged; divides `MOST`."""
COLUMNS: Final = (
    "load_nm", "low_nm", "high_nm", "loss_probability", "speed_rad_s", "adhesion", "thermal",
    "mixed_c", "maisd_k", "stator_c", "drive_end_c", "non_drive_end_c", "ambient_c",
)  # fmt: skip
"""Columns of a drive. low, high: the band of two sigma of the load estimate."""
OF_ALL: Final = ("bus_load_percent",)
POINTS: Final = COLUMNS[-4:]
RANK: Final = {Flag.GOOD: 1.0, Flag.UNKNOWN: 2.0, Flag.BAD: 3.0}
"""Of a bin with several flags the largest rank is shown: no state matters more than bad."""
_NAN: Final = float("nan")
_RANKS: Final = np.array([RANK[flag] for flag in Flag])


class Curve(NamedTuple):
    """One column. t_s: begin of each bin, (K,); low, high: (K,), NaN if no value is known."""

    t_s: Array
    low: Array
    high: Array

    @property
    def known(self) -> bool:
        """Whether any value is known."""
        return bool(np.isfinite(self.low).any())


class Envelope:
    """Rows of (t_s, C columns), merged into bins as they come, in 2 x `MOST` rows and a chunk."""

    def __init__(self, columns: int) -> None:
        self.width = 1
        """Rows in a bin."""
        self.used = 0
        self._columns = columns + 1
        self._low = np.full((MOST, self._columns), _NAN)
        self._high = np.full((MOST, self._columns), _NAN)
        self._held: list[Array] = []
        self._rows = 0
        self._open = 0
        """Chunks in the last bin, if a bin takes several and this one is not full yet; else 0."""

    def add_rows(self, rows: Array) -> None:
        """Add rows (K, 1 + C): seconds, then the columns; NaN if a value is not known."""
        while len(rows):
            part, rows = np.split(rows, [CHUNK - self._rows])
            self._held.append(part)
            self._rows += len(part)
            if self._rows == CHUNK:
                self._put()

    def curve(self, column: int) -> Curve:
        """One column of the rows so far; columns count from 0, without the time."""
        self._put()
        end = self.used
        t_s, k = self._low[:end, 0], column + 1
        return Curve(t_s, self._low[:end, k], self._high[:end, k])

    def _put(self) -> None:
        """Merge the held chunk into the bins."""
        if not self._rows:
            return
        rows = np.concatenate(self._held)
        if not self._open:
            while self.used + -(-self._rows // self.width) > MOST:
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
        self._held = []
        self._rows = 0

    def _halve(self) -> None:
        """Merge every two neighbouring bins."""
        half = self.used // 2
        self._low[:half] = np.fmin(self._low[0 : 2 * half : 2], self._low[1 : 2 * half : 2])
        self._high[:half] = np.fmax(self._high[0 : 2 * half : 2], self._high[1 : 2 * half : 2])
        self.used = half
        self.width *= 2


class Trace:
    """All columns of all drives. Seconds count from the first tick."""

    def __init__(self, nodes: tuple[int, ...]) -> None:
        """nodes: in the order of the drives in the ticks."""
        self.nodes = nodes
        self.first_ns: int | None = None
        self.last_ns = 0
        self.ticks = 0
        self._envelope = Envelope(len(OF_ALL) + len(COLUMNS) * len(nodes))
        self._loads = (float("inf"), float("-inf"), 0.0, 0)

    def add_ticks(self, ticks: Ticks) -> None:
        """Add ticks."""
        count, drives = len(ticks.t_ns), ticks.drives
        if self.first_ns is None:
            self.first_ns = ticks.t_ns.item(0)
        self.last_ns = ticks.t_ns.item(-1)
        self.ticks += count
        known = ticks.bus_load_percent[np.isfinite(ticks.bus_load_percent)]
        if len(known):
            least, most, total, before = self._loads
            self._loads = (
                min(least, float(known.min())), max(most, float(known.max())),
                total + float(known.sum()), before + len(known),
            )  # fmt: skip
        band = 2.0 * np.nan_to_num(drives["load_sigma_nm"])
        load, states = drives["load_nm"], drives["flag"]["state"]
        columns = np.stack([
            load, load - band, load + band, drives["loss_probability"], drives["speed_rad_s"],
            _RANKS[states[:, :, FlagKind.ADHESION]], _RANKS[states[:, :, FlagKind.THERMAL]],
            drives["mixed_c"], drives["maisd_k"], *np.moveaxis(ticks.celsius, 2, 0),
        ], axis=2)  # fmt: skip
        seconds = (ticks.t_ns - self.first_ns) / 1e9
        self._envelope.add_rows(
            np.column_stack([seconds, ticks.bus_load_percent, columns.reshape(count, -1)])
        )

    @property
    def width(self) -> int:
        """Ticks in a bin: 1 if none were merged."""
        return self._envelope.width

    @property
    def span_s(self) -> float:
        """Time from the first tick to the last."""
        return 0.0 if self.first_ns is None else (self.last_ns - self.first_ns) / 1e9

    @property
    def bus_load(self) -> tuple[float, float, float] | None:
        """Least, mean and largest bus load in percent; None if no full second was measured."""
        least, most, total, count = self._loads
        return (least, total / count, most) if count else None

    def of_all(self, column: str) -> Curve:
        """The curve of a column of `OF_ALL`."""
        return self._envelope.curve(OF_ALL.index(column))

    def curve(self, node: int, column: str) -> Curve:
        """The curve of a column of `COLUMNS` of a drive."""
        place = self.nodes.index(node) * len(COLUMNS)
        return self._envelope.curve(len(OF_ALL) + place + COLUMNS.index(column))
