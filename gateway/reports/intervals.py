"""From when to when each flag said what, and why: the rows of a report's table."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator
from typing import Final, NamedTuple

from gateway.core.codes import SENSOR_FAULTS, FaultClass, FaultSensor, Flag, Reason
from gateway.core.view import DriveView, GatewayView
from gateway.reports.record import ADHESION, FAULT, camel

KEPT: Final = 5000
"""Intervals of each kind (flag and state) that are kept; further ones are only counted."""
COMMON: Final = {Flag.UNKNOWN: "Unknown", Flag.GOOD: "NotDetected", Flag.BAD: "AllDrives"}
BAD: Final = frozenset({"AdhesionLost", "Fault", "AllDrives"})
OF_DRIVE: Final = ("adhesion", "thermal")
"""Those in `flags.csv`."""
OTHERS: Final = ("sensor", "comm", "estimator", "common mode", "overrun")


class Interval(NamedTuple):
    """One flag (node 0: the train's) that said `state` from start until end.

    causes: in the order in which they were first said. The last interval ends with the last tick.
    """

    node: int
    flag: str
    state: str
    start_ns: int
    end_ns: int
    causes: tuple[str, ...]

    @property
    def bad(self) -> bool:
        """Whether this is what the gateway is there to tell."""
        return self.state in BAD


class _Running:
    """The interval that a flag is in."""

    __slots__ = ("causes", "start_ns", "state")

    def __init__(self, state: str, start_ns: int) -> None:
        self.state = state
        self.start_ns = start_ns
        self.causes: dict[str, None] = {}


class Intervals:
    """Collects them tick by tick; `close` ends the last ones."""

    def __init__(self) -> None:
        """Empty."""
        self.kept: list[Interval] = []
        self.count: Counter[tuple[int, str, str]] = Counter()
        """How many there were, by node, flag and state."""
        self.seconds: defaultdict[tuple[int, str, str], float] = defaultdict(float)
        self._kinds: Counter[tuple[str, str]] = Counter()
        self._running: dict[tuple[int, str], _Running] = {}
        self._before: dict[int, tuple[object, ...]] = {}
        """What each drive said a tick ago: mostly the same."""
        self._last_ns = 0

    def add(self, view: GatewayView) -> None:
        """Take one tick."""
        now = self._last_ns = view.t_ns
        for d in view.drives:
            status = (
                d.adhesion, d.adhesion_reason, d.thermal, d.thermal_reason, d.sensor, d.comm,
                d.estimator, d.fault_class, d.fault_sensor,
            )  # fmt: skip
            if self._before.get(d.node) == status:
                continue
            self._before[d.node] = status
            adhesion = self._note(d.node, "adhesion", ADHESION[d.adhesion], now)
            _because(adhesion, d.adhesion_reason)
            thermal = self._note(d.node, "thermal", FAULT[d.thermal], now)
            _ill(thermal, d)
            sensor = self._note(d.node, "sensor", FAULT[d.sensor], now)
            if d.sensor is Flag.BAD and d.fault_class in SENSOR_FAULTS:
                sensor.causes[_fault(d)] = None
            self._note(d.node, "comm", FAULT[d.comm], now)
            self._note(d.node, "estimator", FAULT[d.estimator], now)
        self._note(0, "common mode", COMMON[view.common_mode], now)
        self._note(0, "overrun", FAULT[view.overrun], now)

    def _note(self, node: int, flag: str, state: str, now: int) -> _Running:
        running = self._running.get((node, flag))
        if running is None or running.state != state:
            if running is not None:
                self._end(node, flag, running, now)
            running = self._running[node, flag] = _Running(state, now)
        return running

    def _end(self, node: int, flag: str, running: _Running, now: int) -> None:
        key = node, flag, running.state
        self.count[key] += 1
        self.seconds[key] += (now - running.start_ns) / 1e9
        self._kinds[flag, running.state] += 1
        if self._kinds[flag, running.state] <= KEPT:
            causes = tuple(running.causes)
            self.kept.append(Interval(*key, running.start_ns, now, causes))

    def close(self) -> None:
        """The run is over: what still holds ends with the last tick. In order of begin, drive."""
        for (node, flag), running in self._running.items():
            self._end(node, flag, running, self._last_ns)
        self._running.clear()
        self.kept.sort(key=lambda i: (i.start_ns, i.node, i.flag))

    def of_drives(self) -> Iterator[Interval]:
        """Of the flags in `flags.csv`."""
        return (i for i in self.kept if i.flag in OF_DRIVE)

    def other_bad(self) -> Iterator[Interval]:
        """When anything else was bad."""
        return (i for i in self.kept if i.flag in OTHERS and i.bad)

    def left_out(self) -> dict[tuple[str, str], int]:
        """By flag and state, how many were counted but not kept, if any."""
        return {kind: n - KEPT for kind, n in sorted(self._kinds.items()) if n > KEPT}


def _because(running: _Running, reason: Reason) -> None:
    if reason is not Reason.NONE:
        running.causes[camel(Reason(reason).name)] = None


def _ill(running: _Running, drive: DriveView) -> None:
    """Why a thermal flag is unknown; class and sensor of a fault."""
    if drive.thermal is not Flag.BAD:
        _because(running, drive.thermal_reason)
    elif drive.fault_class not in (FaultClass.UNKNOWN, FaultClass.NONE):
        running.causes[_fault(drive)] = None


def _fault(drive: DriveView) -> str:
    """Class and, if there is one, sensor."""
    name = camel(FaultClass(drive.fault_class).name)
    if drive.fault_sensor is not FaultSensor.NONE:
        name += f" ({camel(FaultSensor(drive.fault_sensor).name)})"
    return name
