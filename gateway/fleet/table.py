"""The table of a fleet, one row per log: `fleet.parquet`, and `fleet.csv` for people."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from gateway.core.codes import REJECTED
from gateway.io.whole_file import whole
from gateway.reports.dropped import warning
from gateway.reports.known import spans

TABLE, TEXT = "fleet.parquet", "fleet.csv"
DONE, BAD = "done", "bad"
STATES: Final = {
    ("adhesion", "Unknown"): "adhesion_unknown_s",
    ("adhesion", "Adhering"): "adhering_s",
    ("adhesion", "AdhesionLost"): "adhesion_lost_s",
    ("thermal", "Unknown"): "thermal_unknown_s",
    ("thermal", "NoFault"): "no_fault_s",
    ("thermal", "Fault"): "thermal_fault_s",
}
RAISED: Final = {
    ("adhesion", "AdhesionLost"): "adhesion_losses",
    ("thermal", "Fault"): "thermal_faults",
}
CAUSES: Final = tuple(f"rejected_{cause}" for cause in REJECTED)
_SUMS: Final = (*STATES.values(), *RAISED.values())


class Row(NamedTuple):
    """Results of one log. None: not known, which for a bad log holds for nearly every field.

    file: path of the estimates, relative to the table; warning: faults of a log that was done all
    the same; took_s: time of its replay; counts: `received`, `lost` and frames not used by cause,
    as `replay` prints them; drives: per drive, seconds in each state of its flags and the number of
    times each was raised.
    """

    path: str
    status: str = DONE
    error: str | None = None
    warning: str | None = None
    file: str | None = None
    size_bytes: int | None = None
    channel: str | None = None
    first_ns: int | None = None
    last_ns: int | None = None
    frames: int | None = None
    faulty_lines: int | None = None
    took_s: float | None = None
    counts: Mapping[str, int] | None = None
    drives: Sequence[Mapping[str, float | int]] = ()

    def to_json(self) -> str:
        """One line of JSON, which `of_json` reads."""
        return json.dumps(self._asdict())

    @classmethod
    def of_json(cls, text: str) -> Row:
        """Read a row. Raises ValueError or TypeError for text that `to_json` has not written."""
        return cls(**json.loads(text))

    @property
    def duration_s(self) -> float | None:
        """Time from first to last frame, s."""
        if self.first_ns is None or self.last_ns is None:
            return None
        return (self.last_ns - self.first_ns) / 1e9

    @property
    def dropped(self) -> str:
        """A warning if more of the log was dropped than `dropped.MOST`, else empty."""
        back = (self.counts or {}).get("time_back", 0)
        dropped = {"time_back": back, "faulty_lines": self.faulty_lines or 0}
        return warning(dropped, (self.frames or 0) - back)

    def total(self, name: str) -> float | int:
        """Sum of one of the drives' numbers over all drives."""
        return sum(drive[name] for drive in self.drives)


def per_drive(
    changes: Iterable[tuple[int, int, str, str]], nodes: Sequence[int], end_ns: int
) -> list[dict[str, float | int]]:
    """Seconds in each state and number of times raised, per drive, from `Changes.changes`.

    end_ns: time of the last tick; a state holds until the next change or until then.
    """
    spent = {node: dict.fromkeys(STATES.values(), 0) for node in nodes}
    raised = {node: dict.fromkeys(RAISED.values(), 0) for node in nodes}
    for node, what, word, ns in spans(changes, end_ns):
        spent[node][STATES[what, word]] += ns
        if (what, word) in RAISED:
            raised[node][RAISED[what, word]] += 1
    return [
        {"drive": n, **{name: ns / 1e9 for name, ns in spent[n].items()}, **raised[n]}
        for n in nodes
    ]


def flat(row: Row) -> dict[str, Any]:
    """A row as columns of the tables, with sums over the drives in place of `drives`."""
    counts = row.counts
    causes = {name: _count(counts, name.removeprefix("rejected_")) for name in CAUSES}
    done = row.status == DONE
    return {
        "path": row.path, "status": row.status, "error": row.error, "warning": row.warning,
        "file": row.file, "size_bytes": row.size_bytes, "channel": row.channel,
        "first_ns": row.first_ns, "last_ns": row.last_ns, "duration_s": row.duration_s,
        "frames": row.frames, "faulty_lines": row.faulty_lines,
        "rejected": None if counts is None else sum(v or 0 for v in causes.values()),
        **causes,
        "lost": _count(counts, "lost"), "unknown_id": _count(counts, "unknown_id"),
        **{name: round(row.total(name), 9) if done else None for name in _SUMS},
        "took_s": row.took_s,
    }  # fmt: skip


def _count(counts: Mapping[str, int] | None, name: str) -> int | None:
    return None if counts is None else counts.get(name, 0)


def _type(name: str) -> Any:
    import pyarrow as pa

    if name in ("path", "status", "error", "warning", "file", "channel"):
        return pa.string()
    return pa.float64() if name.endswith("_s") else pa.int64()


def write_table(folder: Path, rows: Sequence[Row], metadata: dict[str, str]) -> list[Path]:
    """Write both tables; each gets its name when it is complete. Raises OSError."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = [flat(row) for row in rows]
    names = list(flat(Row("")))
    drive = pa.struct([("drive", pa.int64()), *((name, _type(name)) for name in _SUMS)])
    fields = [(name, _type(name)) for name in names] + [("drives", pa.list_(drive))]
    columns = {name: [line[name] for line in table] for name in names}
    columns["drives"] = [list(row.drives) if row.status == DONE else None for row in rows]
    arrow = pa.table(columns, schema=pa.schema(fields, metadata=metadata))
    paths = [folder / TABLE, folder / TEXT]
    with whole(paths[0]) as columns_part, whole(paths[1]) as text_part:
        pq.write_table(arrow, columns_part, compression="zstd")
        with text_part.open("w", newline="", encoding="utf-8") as file:
            lines = csv.DictWriter(file, names, lineterminator="\n")
            lines.writeheader()
            lines.writerows(table)
    return paths


def metadata_of(path: Path) -> dict[str, str]:
    """Metadata in a log's result file; empty if there is no file or it cannot be read."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with path.open("rb") as file:
            found = pq.read_metadata(file).metadata or {}
    except (OSError, pa.ArrowException):
        return {}
    return {k.decode(): v.decode() for k, v in found.items()}
