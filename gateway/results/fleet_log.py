"""One log of a fleet: its estimates as a Parquet file, and what is counted along the way.

A row per drive every 100 ms, and one more in the tick in which a flag of that drive changes.
Missing is null. The file gets its name only when it is whole.
"""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import pyarrow as pa
import pyarrow.parquet as pq

from dbc.frame import MS, Nanos
from gateway.health import FaultClass, FaultSensor, Flag, Health, Reason
from gateway.results.fleet_table import PART
from gateway.results.record import ADHESION, FAULT, camel
from gateway.view import DriveView, GatewayView

EVERY_NS: Final[Nanos] = 100 * MS
GROUP: Final = 30_000
"""Rows that are kept in memory before they are written."""

Flags = tuple[Flag, Flag, Flag, Flag, Flag]


def _words(kind: Iterable[Any]) -> list[str]:
    return [camel(member.name) for member in kind]


_WORDS: Final[dict[str, tuple[list[str], Callable[[DriveView], int]]]] = {
    "adhesion": (list(ADHESION.values()), lambda d: d.adhesion),
    "thermal": (list(FAULT.values()), lambda d: d.thermal),
    "sensor": (list(FAULT.values()), lambda d: d.sensor),
    "comm": (list(FAULT.values()), lambda d: d.comm),
    "estimator": (list(FAULT.values()), lambda d: d.estimator),
    "reason": (_words(Reason), lambda d: d.adhesion_reason or d.thermal_reason),
    "health": (_words(Health), lambda d: d.health),
    "fault_class": (_words(FaultClass), lambda d: d.fault_class),
    "fault_sensor": (_words(FaultSensor), lambda d: d.fault_sensor),
}
"""Column -> its words in the order of their numbers, and where the number stands."""
_NUMBERS: Final[dict[str, Callable[[DriveView], float | None]]] = {
    "speed_rad_s": lambda d: d.speed_rad_s,
    "load_nm": lambda d: d.load_nm,
    "load_sigma_nm": lambda d: d.load_sigma_nm,
    "loss_probability": lambda d: d.loss_probability,
    "nis": lambda d: d.nis,
    "mixed_c": lambda d: d.mixed_c,
    "maisd_k": lambda d: d.maisd_k,
    "degradation_k_h": lambda d: d.wear.rate_k_h,
    "degradation_sigma_k_h": lambda d: d.wear.sigma_k_h,
    "hours_to_limit": lambda d: d.wear.hours,
}
PEAK: Final = "loss_probability_peak"
"""Largest since the row before of the same drive, at any tick."""


def schema(metadata: dict[str, str]) -> pa.Schema:
    """Columns of a log's table, with whatever is to be said about the log."""
    fields = [("t_ns", pa.int64()), ("drive", pa.int8())]
    fields += [(name, pa.dictionary(pa.int8(), pa.string())) for name in _WORDS]
    fields += [(name, pa.float64()) for name in (*_NUMBERS, PEAK)]
    return pa.schema(fields, metadata=metadata)


class Estimates:
    """Takes every tick's view; `finish` gives the file its name. Context manager.

    Left without `finish`, nothing remains. Raises OSError where the folder cannot be written.
    """

    def __init__(self, path: Path, nodes: Sequence[int]) -> None:
        """path: of the finished file; its folder must be there."""
        self.path = path
        self.rows = 0
        # Two processes may be at one log for a while: one that was taken for dead goes on.
        self._part = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}{PART}")
        self._writer = pq.ParquetWriter(self._part, schema({}), compression="zstd")
        self._next_ns: Nanos | None = None
        self._last: list[Flags | None] = [None] * len(nodes)
        self._peak: list[float | None] = [None] * len(nodes)
        self._empty()

    def _empty(self) -> None:
        names = ("t_ns", "drive", *_WORDS, *_NUMBERS, PEAK)
        self._columns: dict[str, list[float | int | None]] = {name: [] for name in names}

    def __enter__(self) -> Self:
        """Nothing to do."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Take away what is not finished."""
        self._writer.close()
        self._part.unlink(missing_ok=True)

    def add(self, view: GatewayView) -> None:
        """Take one tick."""
        due = self._next_ns is None or view.t_ns >= self._next_ns
        if due:
            before = view.t_ns if self._next_ns is None else self._next_ns
            self._next_ns = before + EVERY_NS * (1 + (view.t_ns - before) // EVERY_NS)
        for k, d in enumerate(view.drives):
            lost, peak = d.loss_probability, self._peak[k]
            if lost is not None and (peak is None or not lost <= peak):
                self._peak[k] = lost
            flags = (d.adhesion, d.thermal, d.sensor, d.comm, d.estimator)
            if due or flags != self._last[k]:
                self._last[k] = flags
                self._row(view.t_ns, d, self._peak[k])
                self._peak[k] = None
        if len(self._columns["t_ns"]) >= GROUP:
            self._flush()

    def _row(self, t_ns: Nanos, drive: DriveView, peak: float | None) -> None:
        columns = self._columns
        columns["t_ns"].append(t_ns)
        columns["drive"].append(drive.node)
        for name, (_, code) in _WORDS.items():
            columns[name].append(int(code(drive)))
        for name, number in _NUMBERS.items():
            columns[name].append(number(drive))
        columns[PEAK].append(peak)

    def _flush(self) -> None:
        columns = self._columns
        self.rows += len(columns["t_ns"])
        arrays = [pa.array(columns["t_ns"], pa.int64()), pa.array(columns["drive"], pa.int8())]
        for name, (words, _) in _WORDS.items():
            codes = pa.array(columns[name], pa.int8())
            arrays.append(pa.DictionaryArray.from_arrays(codes, pa.array(words)))
        # from_pandas: a NaN would be a diverged estimate, which is not known either.
        arrays += [
            pa.array(columns[name], pa.float64(), from_pandas=True) for name in (*_NUMBERS, PEAK)
        ]
        self._writer.write_table(pa.Table.from_arrays(arrays, schema=schema({})))
        self._empty()

    def finish(self, metadata: dict[str, str]) -> None:
        """Write what is left and what is said about the log, then rename. Raises OSError."""
        self._flush()
        self._writer.add_key_value_metadata(metadata)
        self._writer.close()
        self._part.replace(self.path)
