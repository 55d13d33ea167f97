"""Intervals of constant state of each flag, with the reasons: the rows of a report's table."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.core.codes import SENSOR_FAULTS, FaultClass, FaultSensor, Flag, Reason
from gateway.core.flags import FlagKind
from gateway.reports.known import FLAGS
from gateway.reports.record import ADHESION, COMMON, FAULT, NEITHER, camel

if TYPE_CHECKING:
    from gateway.reports.ticks import Ticks

KEPT: Final = 5000
"""Intervals of each kind (flag and state) that are kept; further ones are only counted."""
BAD: Final = frozenset({"AdhesionLost", "Fault", "AllDrives"})
_WORDS: Final = ("adhesion_reason", "thermal_reason", "fault_class", "fault_sensor")
_DRIVE: Final = {
    "adhesion": ADHESION, "thermal": FAULT, "sensor": FAULT, "comm": FAULT, "estimator": FAULT,
}  # fmt: skip
"""Flags of a drive, and the words of their states."""
_TRAIN: Final = ("common_mode", "overrun")
OTHERS: Final = ("sensor", "comm", "estimator", "common mode", "overrun")


class Interval(NamedTuple):
    """Interval from start to end in which a flag (node 0: of the train) was `state`.

    causes: in the order of their first occurrence. The last interval ends with the last tick.
    """

    node: int
    flag: str
    state: str
    start_ns: int
    end_ns: int
    causes: tuple[str, ...]

    @property
    def bad(self) -> bool:
        """Whether the state is one that the gateway exists to report."""
        return self.state in BAD


class _Running:
    """The interval of a flag that has not ended yet."""

    __slots__ = ("causes", "start_ns", "state")

    def __init__(self, state: str, start_ns: int) -> None:
        self.state = state
        self.start_ns = start_ns
        self.causes: dict[str, None] = {}


class Intervals:
    """Collects the intervals tick by tick; `close` ends the last ones."""

    def __init__(self, nodes: Sequence[int]) -> None:
        """nodes: in the order of the drives in the ticks."""
        self.nodes = nodes
        self.kept: list[Interval] = []
        self.count: Counter[tuple[int, str, str]] = Counter()
        """Number of intervals by node, flag and state."""
        self.seconds: defaultdict[tuple[int, str, str], float] = defaultdict(float)
        self._kinds: Counter[tuple[str, str]] = Counter()
        self._running: dict[tuple[int, str], _Running] = {}
        self._before: tuple[NDArray[np.int64], NDArray[np.int64]] | None = None
        """Flags of the drives and of the train one tick ago; mostly they have not changed."""
        self._last_ns = 0

    def add_ticks(self, ticks: Ticks) -> None:
        """Process ticks."""
        self._last_ns = ticks.t_ns.item(-1)
        drives, train = ticks.drives, ticks.train
        own = np.concatenate(
            [drives["flag"]["state"], *(drives[name][:, :, None] for name in _WORDS)], axis=2
        ).astype(np.int64)
        common = np.stack([train[name] for name in _TRAIN], axis=1).astype(np.int64)
        if self._before is None:
            self._before = np.full_like(own[:1], NEITHER), np.full_like(common[:1], NEITHER)
        changed = (own != np.concatenate([self._before[0], own[:-1]])).any(axis=2)
        all_changed = (common != np.concatenate([self._before[1], common[:-1]])).any(axis=1)
        self._before = own[-1:], common[-1:]
        for k in np.flatnonzero(changed.any(axis=1) | all_changed).tolist():
            now = ticks.t_ns.item(k)
            for j in np.flatnonzero(changed[k]).tolist():
                self._add_drive(self.nodes[j], own[k, j].tolist(), now)
            together, overrun = common[k].tolist()
            self._note(0, "common mode", COMMON[Flag(together)], now)
            self._note(0, "overrun", FAULT[Flag(overrun)], now)

    def _add_drive(self, node: int, status: Sequence[int], now: int) -> None:
        """status: the flags by `FlagKind`, then `_WORDS`."""
        flags = [Flag(state) for state in status[: len(FlagKind)]]
        why, why_thermal, kind, whose = status[len(FlagKind) :]
        fault = _fault(FaultClass(kind), FaultSensor(whose))
        adhesion, thermal, sensor, *_ = (
            self._note(node, name, words[flags[FlagKind[name.upper()]]], now)
            for name, words in _DRIVE.items()
        )
        _because(adhesion, Reason(why))
        if flags[FlagKind.THERMAL] is not Flag.BAD:
            _because(thermal, Reason(why_thermal))
        elif kind > FaultClass.NONE:
            thermal.causes[fault] = None
        if flags[FlagKind.SENSOR] is Flag.BAD and kind in SENSOR_FAULTS:
            sensor.causes[fault] = None

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
        """End the open intervals with the last tick, and sort all by start, drive and flag."""
        for (node, flag), running in self._running.items():
            self._end(node, flag, running, self._last_ns)
        self._running.clear()
        self.kept.sort(key=lambda i: (i.start_ns, i.node, i.flag))

    def of_drives(self) -> Iterator[Interval]:
        """Intervals of the flags in `flags.csv`."""
        return (i for i in self.kept if i.flag in FLAGS)

    def other_bad(self) -> Iterator[Interval]:
        """Intervals in which any other flag was bad."""
        return (i for i in self.kept if i.flag in OTHERS and i.bad)

    def left_out(self) -> dict[tuple[str, str], int]:
        """Number of intervals counted but not kept, by flag and state, if there are any."""
        return {kind: n - KEPT for kind, n in sorted(self._kinds.items()) if n > KEPT}


def _because(running: _Running, reason: Reason) -> None:
    if reason is not Reason.NONE:
        running.causes[camel(reason.name)] = None


def _fault(kind: FaultClass, sensor: FaultSensor) -> str:
    """Class of a fault and, if it is one of a sensor, which: a hot motor may have one beside."""
    named = kind in SENSOR_FAULTS and sensor is not FaultSensor.NONE
    return camel(kind.name) + (f" ({camel(sensor.name)})" if named else "")
