"""Ticks as messages for plotting programs: flags, estimates and events, and a layout for Foxglove.

`/flags/driveN` and `/estimates/driveN` have the columns of `flags.csv` and `estimates.csv`, codes
also by name; `/flags/train` has the flags of the train; `/events` a `foxglove.Log` per change.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final, Protocol

import numpy as np

from dbc.frame import SECOND, Nanos
from gateway.core.codes import Flag
from gateway.reports import record
from gateway.reports.ticks import Ticks

TRAIN: Final = ("sensor", "comm", "estimator", "overrun", "common_mode")
_LEVELS: Final = {
    record.ADHESION[Flag.BAD]: 4,
    record.FAULT[Flag.BAD]: 4,
    record.ADHESION[Flag.UNKNOWN]: 3,
}
"""Levels of `foxglove.Log`: 2 info, 3 warning, 4 error."""
_INFO: Final = 2
_WORDS: Final = record.by_code({flag: record.camel(flag.name) for flag in Flag})
_TIME: Final = {
    "type": "object", "title": "time",
    "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
}  # fmt: skip
_LOG: Final = {
    "timestamp": _TIME, "level": {"type": "integer"}, "message": {"type": "string"},
    "name": {"type": "string"}, "file": {"type": "string"}, "line": {"type": "integer"},
}  # fmt: skip
Row = Mapping[str, Any]


class Target(Protocol):
    """A file of messages."""

    def channel(self, topic: str, name: str, properties: Mapping[str, Any]) -> int:
        """Number of a topic. name, properties: name and properties of its JSON schema."""

    def put(self, messages: Iterable[tuple[Nanos, int, str]]) -> None:
        """Add messages: time, number of the topic, JSON."""

    def flush(self, until_ns: Nanos | None = None) -> None:
        """Write what is held: no message up to this time follows."""


class Topics:
    """Writes ticks to a file of messages."""

    def __init__(self, nodes: Sequence[int], file: Target) -> None:
        """nodes: in the order of the drives in the ticks."""
        self._nodes, self._file = nodes, file
        self._changes = record.Changes()

    def add_ticks(self, ticks: Ticks) -> None:
        """Write ticks. Raises OSError."""
        names = [f"drive{node}" for node in self._nodes]
        drives = [f"/flags/{name}" for name in names]
        self._put(ticks, "DriveFlags", drives, record.FLAGS_HEADER[2:], record.flag_columns(ticks))
        drives = [f"/estimates/{name}" for name in names]
        self._put(
            ticks, "Estimates", drives, record.ESTIMATES_HEADER[2:], record.estimate_columns(ticks)
        )
        train = [record.Coded(ticks.train[name], _WORDS) for name in TRAIN]
        self._put(ticks, "TrainFlags", ["/flags/train"], TRAIN, train)
        self._changes.add_ticks(ticks, self._nodes)
        events = self._file.channel("/events", "foxglove.Log", _LOG)
        for t_ns, node, flag, word in self._changes.changes:
            row = {
                "timestamp": {"sec": t_ns // SECOND, "nsec": t_ns % SECOND},
                "level": _LEVELS.get(word, _INFO), "message": f"drive {node}: {flag} {word}",
                "name": f"drive{node}", "file": "", "line": 0,
            }  # fmt: skip
            self._file.put([(t_ns, events, _json(row))])
        self._changes.changes.clear()
        self._file.flush(ticks.t_ns.item(-1))

    def _put(
        self, ticks: Ticks, name: str, topics: Sequence[str], header: Sequence[str],
        columns: Sequence[record.Coded | record.Column],
    ) -> None:  # fmt: skip
        """Write columns (K N,) to N topics."""
        properties = {}
        for key, column in zip(header, columns, strict=True):
            properties[key] = {"type": "number"}
            if isinstance(column, record.Coded):
                properties[f"{key}_name"] = {"type": "string"}
        numbers = [self._file.channel(topic, f"traction.{name}", properties) for topic in topics]
        times = np.repeat(ticks.t_ns, len(topics)).tolist()
        self._file.put(
            (t_ns, numbers[k % len(topics)], _json(row))
            for k, (t_ns, row) in enumerate(zip(times, _rows(header, columns), strict=True))
        )


def _rows(header: Sequence[str], columns: Sequence[record.Coded | record.Column]) -> Iterator[Row]:
    """Yield the rows, without values that are not known."""
    parts: dict[str, list[Any]] = {}
    for name, column in zip(header, columns, strict=True):
        if isinstance(column, record.Coded):
            parts[name] = column.code.tolist()
            parts[f"{name}_name"] = record.in_words(column).tolist()
        else:
            parts[name] = [float(f"{value:.9g}") for value in column.tolist()]
    for row in zip(*parts.values(), strict=True):
        yield {key: x for key, x in zip(parts, row, strict=True)
               if isinstance(x, str) or math.isfinite(x)}  # fmt: skip


def _json(row: Row) -> str:
    return json.dumps(row, separators=(",", ":"))


def layout(nodes: Sequence[int]) -> str:
    """A layout for Foxglove: flags, loads, probabilities, events and frames of these drives."""
    flags = [
        f"/flags/drive{node}.{flag}_name" for flag in ("adhesion", "thermal") for node in nodes
    ]
    panels: dict[str, Any] = {"StateTransitions!flags": {"isSynced": True, "paths": _paths(flags)}}
    for column in ("load_nm", "loss_probability", "speed_rad_s"):
        paths = _paths(f"/estimates/drive{node}.{column}" for node in nodes)
        panels[f"Plot!{column}"] = {
            "title": column, "isSynced": True, "xAxisVal": "timestamp", "showLegend": True,
            "legendDisplay": "floating", "paths": paths,
        }  # fmt: skip
    panels["Log!events"] = {"topicToRender": "/events"}
    panels["RawMessages!frames"] = {"topicPath": "/can/frames"}
    left, right = list(panels)[:4], list(panels)[4:]
    return json.dumps({
        "configById": panels, "globalVariables": {}, "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {"direction": "row", "first": _column(left), "second": _column(right),
                   "splitPercentage": 70},
    }, indent=1) + "\n"  # fmt: skip


def _paths(values: Iterable[str]) -> list[Row]:
    return [{"value": v, "enabled": True, "timestampMethod": "receiveTime"} for v in values]


def _column(names: Sequence[str]) -> Any:
    """Layout of panels of equal height, one above the other."""
    if len(names) == 1:
        return names[0]
    return {"direction": "column", "first": names[0], "second": _column(names[1:]),
            "splitPercentage": round(100 / len(names))}  # fmt: skip
