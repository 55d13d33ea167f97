"""The last minute of every drive, for plots. Pure, bounded."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Final

from dbc.frame import MS, Nanos
from gateway.monitor.model.snapshot import DriveRow, Trace

POINT_NS: Final[Nanos] = 100 * MS
POINTS: Final = 600


class Recent:
    """A point of every drive each `POINT_NS`; the oldest are dropped."""

    def __init__(self, nodes: Iterable[int]) -> None:
        self._t_s: deque[float] = deque(maxlen=POINTS)
        self._rows: dict[int, deque[DriveRow]] = {n: deque(maxlen=POINTS) for n in nodes}

    def __deepcopy__(self, _memo: dict[int, object]) -> Recent:
        """Return a copy that shares the rows, because they never change."""
        other = Recent(self._rows)
        other._t_s = self._t_s.copy()
        other._rows = {node: rows.copy() for node, rows in self._rows.items()}
        return other

    def append(self, t_s: float, drives: Iterable[DriveRow]) -> None:
        """Add a point: a time and a row of every drive."""
        self._t_s.append(t_s)
        for row in drives:
            self._rows[row.node].append(row)

    def traces(self) -> tuple[Trace, ...]:
        """A trace for each drive, in the order of `nodes`."""
        t_s = tuple(self._t_s)
        return tuple(
            Trace(
                node,
                t_s,
                tuple([r.speed_rad_s for r in rows]),
                tuple([r.load_nm for r in rows]),
                tuple([r.load_sigma_nm for r in rows]),
                tuple([r.loss_probability for r in rows]),
                tuple([r.adhesion for r in rows]),
            )
            for node, rows in self._rows.items()
        )
