"""Ground truth, if it is known: for pictures, and to score flags (`scoring`).

The rows are those that `sim --truth` writes. They are merged as they come, so that an hour of rows
takes no more memory than a second.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple, Protocol

import numpy as np

from gateway.core.codes import SENSOR_FAULTS, FaultClass
from gateway.reports.record import camel
from gateway.reports.trace import CHUNK, Curve, Envelope
from gateway.settings.config import ConfigError

HEADER: Final = (
    "t_s", "drive", "speed_rad_s", "angle_rad", "load_nm", "lost", "fault_class", "true_effect_k",
)  # fmt: skip
MORE: Final = ("cut", "creep", "train_speed_m_s")
"""Columns that older files do not have."""
_CLASSES: Final = {str(ill.value): ill.value for ill in FaultClass}
SLIDES: Final = 0.06
"""Creep above which a wheel slides: more than the 5 % that a fast slip limiter allows."""
_LONGEST: Final = 1000
"""Most bytes of a row."""


class Row(Protocol):
    """The fields of the simulator's truth that are used here."""

    @property
    def t_s(self) -> float:
        """Seconds from the start."""

    @property
    def drive(self) -> int:
        """Node number."""

    @property
    def speed_rad_s(self) -> float:
        """Speed of the rotor."""

    @property
    def load_nm(self) -> float:
        """Torque on the rail, at the rotor."""

    @property
    def lost(self) -> int:
        """1 while adhesion is lost."""

    @property
    def fault_class(self) -> int:
        """Number of the fault class in the contract, 1 for no fault."""


class Event(NamedTuple):
    """A true loss or fault of a drive from start to end; `flag`: the flag that must report it.

    cut: a loss in which the drive cut its own torque and its wheel never slid.
    """

    node: int
    flag: str
    kind: str
    start_s: float
    end_s: float
    cut: bool = False


class _Drive:
    """The rows of one drive so far."""

    def __init__(self) -> None:
        self.envelope = Envelope(2)
        self.rows: list[tuple[float, float, float]] = []
        """Rows that are not in the envelope yet."""
        self.last_s = 0.0
        self.before: tuple[int, int] | None = None
        """`lost` and `fault_class` of the last row; mostly the next row has the same."""
        self.running: dict[str, tuple[str, float]] = {}
        self.cut = self.slid = False
        """State in the present loss: whether the drive cut its torque, and whether it slid."""

    def put(self) -> None:
        """Move all rows into the envelope."""
        if self.rows:
            self.envelope.add_rows(np.array(self.rows))
            self.rows.clear()


class Truth:
    """Loads, speeds and events of every drive with rows."""

    def __init__(self, offset_s: float = 0.0) -> None:
        """offset_s: added to the time of every row, to convert it to that of the report."""
        self.events: list[Event] = []
        self.offset_s = offset_s
        self._drives: dict[int, _Drive] = {}

    def add_rows(self, rows: Iterable[Row]) -> None:
        """Add rows, ascending in time for each drive."""
        for row in rows:
            drive = self._drives.get(row.drive)
            if drive is None:
                drive = self._drives[row.drive] = _Drive()
            t_s = drive.last_s = row.t_s + self.offset_s
            drive.rows.append((t_s, row.load_nm, row.speed_rad_s))
            if len(drive.rows) == CHUNK:
                drive.put()
            if row.lost:
                drive.cut |= bool(getattr(row, "cut", 0))
                drive.slid |= not abs(getattr(row, "creep", math.nan)) <= SLIDES
            if drive.before == (row.lost, row.fault_class):
                continue
            drive.before = row.lost, row.fault_class
            self._follow(row.drive, drive, "adhesion", "loss" if row.lost else "", t_s)
            ill = row.fault_class > FaultClass.NONE
            kind = camel(FaultClass(row.fault_class).name) if ill else ""
            flag = "sensor" if row.fault_class in SENSOR_FAULTS else "thermal"
            for name in ("thermal", "sensor"):
                self._follow(row.drive, drive, name, kind if name == flag else "", t_s)

    def _follow(self, node: int, drive: _Drive, flag: str, kind: str, t_s: float) -> None:
        before, since = drive.running.get(flag, ("", t_s))
        if kind != before:
            if before:
                cut = flag == "adhesion" and drive.cut and not drive.slid
                self.events.append(Event(node, flag, before, since, t_s, cut))
                if flag == "adhesion":
                    drive.cut = drive.slid = False
            drive.running[flag] = kind, t_s

    def close(self) -> None:
        """End the open events with the last row, and sort all events by start and drive."""
        for node, drive in self._drives.items():
            for flag in list(drive.running):
                self._follow(node, drive, flag, "", drive.last_s)
        self.events.sort()
        self.events.sort(key=lambda event: (event.start_s, event.node))

    @property
    def nodes(self) -> frozenset[int]:
        """Drives with rows."""
        return frozenset(self._drives)

    def load(self, node: int) -> Curve | None:
        """Load torque, Nm; None for a drive without rows."""
        return self._curve(node, 0)

    def speed(self, node: int) -> Curve | None:
        """Rotor speed, rad/s; None for a drive without rows."""
        return self._curve(node, 1)

    def _curve(self, node: int, column: int) -> Curve | None:
        drive = self._drives.get(node)
        if drive is None:
            return None
        drive.put()
        return drive.envelope.curve(column)


class _Text(NamedTuple):
    """One row of the file."""

    t_s: float
    drive: int
    speed_rad_s: float
    load_nm: float
    lost: int
    fault_class: int
    cut: int
    creep: float


def check(path: Path) -> None:
    """Check early, by its head, that a file is a truth file. Raises ConfigError, OSError."""
    next(rows(path), None)


def read(path: Path, first_s: float, last_s: float) -> tuple[Truth, bool]:
    """A truth file, with the times of the report, and whether it was on the log's clock.

    first_s, last_s: first and last time of the log, on its own clock. A file that does not overlap
    with the log was recorded on another clock; its time 0 is then taken to be the log's first
    frame. Raises OSError, and ConfigError with the line that is not a row.
    """
    begin, end = _range(path)
    same = begin <= last_s and first_s <= end
    truth = Truth(-first_s if same else 0.0)
    truth.add_rows(rows(path))
    truth.close()
    return truth, same


def _range(path: Path) -> tuple[float, float]:
    """Times of the first and last row, which are the least and greatest, because rows ascend."""
    first = next(rows(path), None)
    if first is None:
        raise ConfigError(str(path), ["no row of truth: was it written by `sim --truth`?"])
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - _LONGEST))
        last = file.read().decode("utf-8", "replace").splitlines()[-1]
    try:
        return first.t_s, _row(last.split(",")).t_s
    except (ValueError, KeyError):
        raise ConfigError(str(path), ["its last line is not a row of truth"]) from None


def rows(path: Path) -> Iterator[Row]:
    """Yield the rows of a file. Raises OSError, and ConfigError with the line of a faulty row."""
    with path.open(newline="", encoding="utf-8", errors="replace") as file:
        lines = csv.reader(file)
        head = tuple(next(lines, ()))
        if head not in (HEADER, HEADER + MORE):
            raise ConfigError(str(path), [f"its first line must be {','.join(HEADER + MORE)}"])
        try:
            for cells in lines:
                yield _row(cells)
        except (ValueError, KeyError, csv.Error):
            raise ConfigError(str(path), [f"line {lines.line_num} is not a row of truth"]) from None


def _row(cells: Sequence[str]) -> _Text:
    text, drive, speed, _, load, lost, ill, _, *more = cells
    t_s, speed_rad_s, load_nm = float(text), float(speed), float(load)
    if not (math.isfinite(t_s) and math.isfinite(speed_rad_s) and math.isfinite(load_nm)):
        raise ValueError("not finite")
    cut, creep, _ = more or ("0", "", "")
    slip = float(creep) if creep else math.nan
    return _Text(t_s, int(drive), speed_rad_s, load_nm, int(lost), _CLASSES[ill], int(cut), slip)
