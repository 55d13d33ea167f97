"""What goes wrong and when: the scenario's events as arrays for the plant, sensors and wire.

May know: scenarios. May not know: bits, buses, clocks.
"""

from __future__ import annotations

from bisect import insort
from typing import Final

import numpy as np

from dbc.arrays import Array, Flags
from sim.physics import sensors, thermal
from sim.physics.adhesion import Rail, rail
from sim.physics.plant import DT, Motor
from sim.scenario import Event, Scenario

_LOSS, _CORRUPT = 4, 5
"""Purposes of the random streams."""
BEARING_W: Final = 60.0
"""Friction heat of a bearing event with depth 1."""

NONE, OVERHEATING, COOLING_LOSS, BEARING, SENSOR_BIAS, SENSOR_STUCK, SENSOR_LOST = range(1, 8)
"""`FaultClass` of the contract."""
CLASSES: Final = {
    "overheating": OVERHEATING, "cooling_loss": COOLING_LOSS, "bearing": BEARING,
    "sensor_bias": SENSOR_BIAS, "sensor_stuck": SENSOR_STUCK, "sensor_lost": SENSOR_LOST,
}  # fmt: skip
EMERGENCY: Final = {
    OVERHEATING: (0x4310, 0x08), COOLING_LOSS: (0x4380, 0x08), BEARING: (0x7180, 0x20),
    SENSOR_LOST: (0x7380, 0x20),
}  # fmt: skip
"""EMCY code and bit of the error register of the faults that a drive detects itself. It cannot
detect a stuck or biased sensor: that is the gateway's task."""
POINTS: Final = {
    "stator": sensors.STATOR, "drive_end": sensors.DRIVE_END,
    "non_drive_end": sensors.NON_DRIVE_END, "ambient": sensors.AMBIENT,
}  # fmt: skip


class Schedule:
    """The events of a scenario, asked by time. Drives are counted from 0 here."""

    def __init__(self, scenario: Scenario, motor: Motor) -> None:
        """Later events of a kind win over earlier ones on the same drive."""
        self._scenario = scenario
        self._n = scenario.drives
        self._disturbances = [(scenario.nodes.index(d.drive), d) for d in scenario.load.disturbance]
        self._start_rail = rail(scenario.load.rail)
        self._rated_copper_w = 1.5 * motor.R_s * motor.I_rated**2
        self._scale = motor.T_rated / 30.0
        self._rated_nm = motor.T_rated
        self._by_kind: dict[str, list[tuple[Event, list[int]]]] = {}
        for event in scenario.event:
            self.insert(event)

    def insert(self, event: Event) -> None:
        """Add an event, in order of time. Raises ValueError for a drive that does not exist."""
        nodes = self._scenario.nodes
        if isinstance(event.drive, int) and event.drive not in nodes:
            raise ValueError(f"drive: {self._scenario.no_node(event.drive)}")
        who = [nodes.index(d) for d in self._scenario.drives_of(event.drive)]
        insort(
            self._by_kind.setdefault(event.kind, []), (event, who), key=lambda item: item[0].at_s
        )

    def _active(self, kind: str, t_s: float) -> list[tuple[Event, list[int]]]:
        return [(e, d) for e, d in self._by_kind.get(kind, ()) if e.at_s <= t_s < e.end_s]

    def _drives(self, kind: str, t_s: float, sensor: str | None = None) -> Flags:
        """(N,) drives with such an event now."""
        out = np.zeros(self._n, np.bool_)
        for event, who in self._active(kind, t_s):
            out[who] |= event.sensor == sensor
        return out

    def carry(self, t_s: Array, healthy_nm: Array) -> Array:
        """(n, N) share of the train's demand that the rail carries at times `t_s` (n,).

        `healthy_nm` (n,) is the preset load, which `disturbance` entries are relative to.
        """
        out = np.ones((len(t_s), self._n))
        first, last = t_s[0], t_s[-1]
        for event, who in self._by_kind.get("adhesion_loss", ()):
            if event.at_s <= last and event.end_s > first:
                left = 1.0 - _depth(event, t_s)
                out[:, who] = np.minimum(out[:, who], left[:, None])
        for k, item in self._disturbances:
            x = (t_s - item.at_s) / item.for_s
            inside = (x >= 0.0) & (x < 1.0) & (healthy_nm != 0.0)
            if inside.any():
                pull = item.amplitude_nm * np.sin(np.pi * x[inside])
                out[inside, k] *= 1.0 - pull / healthy_nm[inside]
        return out

    def losing(self, t_s: float) -> Flags:
        """(N,) drives whose load an adhesion loss or disturbance changes now."""
        out = np.zeros(self._n, np.bool_)
        at = np.array([t_s])
        for event, who in self._active("adhesion_loss", t_s):
            out[who] |= bool(_depth(event, at)[0] > 0.0)
        for k, item in self._disturbances:
            if item.at_s <= t_s < item.at_s + item.for_s and item.amplitude_nm:
                out[k] = True
        return out

    def rails(self, t_s: float) -> list[Rail]:
        """Rail under each drive."""
        out = [self._start_rail] * self._n
        for event, who in self._active("rail", t_s):
            assert event.value is not None
            for d in who:
                out[d] = rail(event.value)
        return out

    def open_phase(self, t_s: float) -> Flags:
        """(N,) drives whose phase a is open."""
        return self._drives("phase_open", t_s)

    def brake(self, t_s: float) -> Array:
        """(N,) torque of the friction brakes, Nm at the motor's shaft."""
        out = np.zeros(self._n)
        at = np.array([t_s])
        for event, who in self._by_kind.get("friction_brake", ()):
            full_nm = event.number or self._rated_nm * (event.depth or 0.0)
            out[who] = np.maximum(out[who], full_nm * _shape(event, at))
        return out

    def heat(self, t_s: float) -> tuple[Array, Array]:
        """Fault heat (N, 6) W and share of cooling lost (N,)."""
        extra = np.zeros((self._n, thermal.NODES))
        lost = np.zeros(self._n)
        for event, who in self._active("overheating", t_s):
            share = self._rated_copper_w * (event.depth or 0.0)
            extra[who, thermal.WINDING] += event.number or share
        for event, who in self._active("bearing", t_s):
            rear = event.sensor == "non_drive_end"
            node = thermal.BEARING_NDE if rear else thermal.BEARING_DE
            extra[who, node] += event.number or self._scale * BEARING_W * (event.depth or 0.0)
        for event, who in self._active("cooling_loss", t_s):
            lost[who] = np.maximum(lost[who], event.depth or 0.0)
        return extra, lost

    def _points(self, kind: str, t_s: float) -> list[tuple[Event, list[int], int]]:
        return [
            (e, who, POINTS[e.sensor or "stator"])
            for e, who in self._active(kind, t_s)
            if e.sensor != "current"
        ]

    def temperature_faults(self, t_s: float) -> tuple[Array, Flags, Flags]:
        """(N, 4) bias K, stuck, lost of the temperature sensors."""
        bias, flags = np.zeros((self._n, sensors.POINTS)), {}
        for event, who, point in self._points("sensor_bias", t_s):
            bias[who, point] += event.number
        for kind in ("sensor_stuck", "sensor_lost"):
            flags[kind] = np.zeros(bias.shape, np.bool_)
            for _, who, point in self._points(kind, t_s):
                flags[kind][who, point] = True
        return bias, flags["sensor_stuck"], flags["sensor_lost"]

    def current_faults(self, t_s: float) -> tuple[Array, Flags, Flags]:
        """(N,) bias A and stuck of phase a, and lost (all phases)."""
        bias = np.zeros(self._n)
        for event, who in self._active("sensor_bias", t_s):
            if event.sensor == "current":
                bias[who] += event.number
        stuck, lost = (self._drives(k, t_s, "current") for k in ("sensor_stuck", "sensor_lost"))
        return bias, stuck, lost

    @property
    def has_current_faults(self) -> bool:
        """Whether any event is a fault of a current sensor."""
        return any(e.sensor == "current" for events in self._by_kind.values() for e, _ in events)

    @property
    def has_thermal_faults(self) -> bool:
        """Whether any event affects a temperature or its reading."""
        return any(kind in CLASSES for kind in self._by_kind)

    def classes(self, t_s: float) -> list[int]:
        """`FaultClass` of each drive: 1 None, else the class of the event that began last."""
        out = [NONE] * self._n
        begun = [-1.0] * self._n
        for kind, number in CLASSES.items():
            for event, who in self._active(kind, t_s):
                for d in who:
                    if event.at_s >= begun[d]:
                        out[d], begun[d] = number, event.at_s
        return out

    def touches_wire(self, drive: int) -> bool:
        """Whether any event affects this drive's frames."""
        kinds = ("silent", "frame_loss", "corrupt")
        return any(drive in who for kind in kinds for _, who in self._by_kind.get(kind, ()))

    def silent(self, drive: int, t_s: float) -> bool:
        """True while this drive is off the bus."""
        return any(drive in who for _, who in self._active("silent", t_s))

    def chance(self, kind: str, drive: int, t_s: float) -> float:
        """Probability of `frame_loss` or `corrupt` for a frame of this drive."""
        depths = [e.depth or 0.0 for e, who in self._active(kind, t_s) if drive in who]
        return max(depths, default=0.0)


def _depth(event: Event, t_s: Array) -> Array:
    """Depth over time, (n,)."""
    return (event.depth or 0.0) * _shape(event, t_s)


def _shape(event: Event, t_s: Array) -> Array:
    """How far the event is in force, 0..1 (n,), with the linear edges inside it."""
    # Half a period of tolerance: `t_s` are multiples of a period, event times are decimals.
    grace = 0.5 * DT
    inside = (t_s >= event.at_s - grace) & (t_s < event.end_s - grace)
    shape = np.ones_like(t_s)
    if event.ramp_s > 0.0:
        shape = np.minimum((t_s - event.at_s), (event.end_s - t_s)) / event.ramp_s
    return np.where(inside, np.clip(shape, 0.0, 1.0), 0.0)


class WireFaults:
    """Loss and corruption of a drive's frames.

    Each identifier and purpose has its own random stream, so what happens to one message depends
    neither on the others nor on how time is cut into steps.
    """

    def __init__(self, schedule: Schedule, seed: int, drive: int) -> None:
        """`drive` counts from 0."""
        self._schedule, self._seed, self._drive = schedule, seed, drive
        self._rngs: dict[tuple[int, int], np.random.Generator] = {}
        self.look_again()

    def look_again(self) -> None:
        """Check again whether any event affects this drive's frames."""
        self._quiet = not self._schedule.touches_wire(self._drive)

    def _rng(self, purpose: int, can_id: int) -> np.random.Generator:
        key = (purpose, can_id)
        if key not in self._rngs:
            self._rngs[key] = np.random.default_rng([self._seed, purpose, self._drive, can_id])
        return self._rngs[key]

    def apply(self, t_s: float, can_id: int, data: bytes) -> bytes | None:
        """The frame's data as they reach the bus, or None when they do not."""
        if self._quiet:
            return data
        schedule, drive = self._schedule, self._drive
        if schedule.silent(drive, t_s):
            return None
        chance = schedule.chance("frame_loss", drive, t_s)
        if chance and self._rng(_LOSS, can_id).random() < chance:
            return None
        chance = schedule.chance("corrupt", drive, t_s)
        if chance and self._rng(_CORRUPT, can_id).random() < chance:
            return _flip(data, self._rng(_CORRUPT, can_id))
        return data


def _flip(data: bytes, rng: np.random.Generator) -> bytes:
    """Flip 1 to 3 different bits."""
    damaged = bytearray(data)
    count = min(int(rng.integers(1, 4)), 8 * len(data))
    for bit in rng.choice(8 * len(data), size=count, replace=False).tolist():
        damaged[bit >> 3] ^= 1 << (bit & 7)
    return bytes(damaged)
