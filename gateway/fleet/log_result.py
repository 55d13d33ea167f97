"""One log of a fleet: its estimates as a Parquet file.

There is a row per drive every 100 ms, and one more in a tick in which a flag of that drive changes.
A missing value is null. The file gets its name only when it is complete.
"""

from __future__ import annotations

import uuid
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from dbc.arrays import Array
from dbc.frame import MS, Nanos
from gateway.core.codes import NEVER, FaultClass, FaultSensor, Health, Reason
from gateway.core.flags import FlagKind
from gateway.io.whole_file import PART
from gateway.reports.record import ADHESION, FAULT, camel

if TYPE_CHECKING:
    from gateway.core.gateway import Gateway

EVERY_NS: Final[Nanos] = 100 * MS
GROUP: Final = 30_000
"""Rows that are kept in memory before they are written."""


def _words(kind: Iterable[Any]) -> list[str]:
    return [camel(member.name) for member in kind]


_WORDS: Final[dict[str, list[str]]] = {
    "adhesion": list(ADHESION.values()),
    **{flag: list(FAULT.values()) for flag in ("thermal", "sensor", "comm", "estimator")},
    "reason": _words(Reason),
    "health": _words(Health),
    "fault_class": _words(FaultClass),
    "fault_sensor": _words(FaultSensor),
}
"""Column -> its words in the order of their codes. The first five columns are a drive's flags."""
_FLAGS: Final = 5
_ORDER: Final = [FlagKind[name.upper()] for name in tuple(_WORDS)[:_FLAGS]]
_NUMBERS: Final = (
    "speed_rad_s", "load_nm", "load_sigma_nm", "loss_probability", "nis", "mixed_c", "maisd_k",
    "degradation_k_h", "degradation_sigma_k_h", "hours_to_limit",
)  # fmt: skip
PEAK: Final = "loss_probability_peak"
"""Largest loss probability at any tick since the drive's previous row."""


def schema(metadata: dict[str, str]) -> pa.Schema:
    """Columns of a log's table, with metadata about the log."""
    fields = [("t_ns", pa.int64()), ("drive", pa.int8())]
    fields += [(name, pa.dictionary(pa.int8(), pa.string())) for name in _WORDS]
    fields += [(name, pa.float64()) for name in (*_NUMBERS, PEAK)]
    return pa.schema(fields, metadata=metadata)


class Estimates(AbstractContextManager["Estimates"]):
    """Takes ticks as `replay.Samples`; `finish` gives the file its name. Context manager.

    Without `finish` no file remains. Raises OSError if the folder cannot be written.
    """

    def __init__(self, path: Path, nodes: Sequence[int]) -> None:
        """path: the unfinished file is made beside it; its folder must exist."""
        self.rows = 0
        self.next_ns: Nanos = NEVER
        """Every drive has a row in the first tick at or after this time."""
        self.last_ns: Nanos = NEVER
        """Time of the last tick."""
        # Two processes may work on one log for a while, if one that was given up still runs.
        self._part = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}{PART}")
        self._writer = pq.ParquetWriter(self._part, schema({}), compression="zstd")
        n = len(nodes)
        self._nodes = np.array(nodes, dtype=np.int8)
        self._flags = np.full((_FLAGS, n), -1, dtype=np.int64)
        self._peak = np.full(n, np.nan)
        # (T, columns, N) of T ticks, and which drives have a row in each.
        ticks = -(-GROUP // n)
        self._at, self._ticks = 0, np.zeros(ticks, dtype=np.int64)
        self._codes = np.zeros((ticks, len(_WORDS), n), dtype=np.int8)
        self._numbers = np.zeros((ticks, len(_NUMBERS) + 1, n))
        self._mine = np.zeros((ticks, n), dtype=np.bool_)

    def __exit__(self, *error: object) -> None:
        """Remove the file if it is unfinished."""
        self._writer.close()
        self._part.unlink(missing_ok=True)

    def took(self, now: Nanos, gateway: Gateway, peak: Array) -> None:
        """Take one tick or many, see `replay.Samples`."""
        first = self.last_ns == NEVER
        self.last_ns = now
        np.fmax(self._peak, peak, out=self._peak)
        due = first or now >= self.next_ns
        if due:
            before = now if first else self.next_ns
            self.next_ns = before + EVERY_NS * (1 + (now - before) // EVERY_NS)
        if due or gateway.changed:
            self._store(now, gateway, due=due)

    def _store(self, now: Nanos, gateway: Gateway, *, due: bool) -> None:
        """Store the rows of a tick: of every drive if due, else of those whose flags changed."""
        drives, at = gateway.status.drives, self._at
        flags = drives["flag"]["state"].T[_ORDER]
        mine = np.ones(len(self._nodes), np.bool_) if due else (flags != self._flags).any(axis=0)
        why, warm_why = drives["adhesion_reason"], drives["thermal_reason"]
        codes, numbers = self._codes[at], self._numbers[at]
        self._flags = codes[:_FLAGS] = flags
        codes[_FLAGS:] = (
            np.where(why, why, warm_why), drives["health"], drives["fault_class"],
            drives["fault_sensor"],
        )  # fmt: skip
        # As float64, None becomes NaN.
        wear = np.array([each[:3] for each in gateway.thermal.wear], dtype=np.float64)
        numbers[:-4] = (
            drives["speed_rad_s"], drives["load_nm"], drives["load_sigma_nm"],
            drives["loss_probability"], drives["nis"], drives["mixed_c"], drives["maisd_k"],
        )  # fmt: skip
        numbers[-4:-1], numbers[-1] = wear.T, self._peak
        self._peak[mine] = np.nan
        self._ticks[at], self._mine[at] = now, mine
        self._at += 1
        if self._at == len(self._ticks):
            self._flush()

    def _flush(self) -> None:
        tick, drive = np.nonzero(self._mine[: self._at])
        self._at = 0
        self.rows += len(tick)
        arrays = [_arrow(self._ticks[tick], pa.int64()), _arrow(self._nodes[drive], pa.int8())]
        for k, words in enumerate(_WORDS.values()):
            codes = _arrow(self._codes[tick, k, drive], pa.int8())
            arrays.append(pa.DictionaryArray.from_arrays(codes, _text(words)))
        arrays += [
            _arrow(self._numbers[tick, k, drive], pa.float64()) for k in range(len(_NUMBERS) + 1)
        ]
        self._writer.write_table(pa.Table.from_arrays(arrays, schema=schema({})))

    def finish(self, path: Path, metadata: dict[str, str]) -> None:
        """Write the remaining rows and the metadata, then rename the file. Raises OSError."""
        self._flush()
        self._writer.add_key_value_metadata(metadata)
        self._writer.close()
        path.parent.mkdir(parents=True, exist_ok=True)
        self._part.replace(path)


def _arrow(values: NDArray[Any], kind: pa.DataType) -> pa.Array:
    """(R,) numbers as an Arrow array; NaN (not known, or of a diverged estimate) becomes null.

    Built from buffers, because `pyarrow.array` imports pandas: half a second per worker start.
    """
    known = values == values  # noqa: PLR0124 NaN alone is unlike itself
    bits = None if known.all() else pa.py_buffer(np.packbits(known, bitorder="little"))
    return pa.Array.from_buffers(kind, len(values), [bits, pa.py_buffer(values)])


def _text(words: Sequence[str]) -> pa.Array:
    """Words as an Arrow array, see `_arrow`."""
    data = [word.encode() for word in words]
    ends = np.cumsum([0, *map(len, data)], dtype=np.int32)
    return pa.Array.from_buffers(
        pa.string(), len(data), [None, pa.py_buffer(ends), pa.py_buffer(b"".join(data))]
    )
