"""Recordings made by others, read and judged: what `real_temperatures` and `real_pictures` tell.

Recorded temperatures become the readings that our inbox would make of them: what a recording's
own codes or status call no measurement is not available, and beyond the wire's -60 to 300 degC
nothing is a temperature. Sources and licences: tests/data/README.md.
"""

from __future__ import annotations

import csv
import gzip
import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from dbc.candump.reader import Reader
from dbc.frame import MS, SECOND, Frame, Nanos
from gateway.core.flags import Timing
from gateway.core.gateway import SENSOR
from gateway.settings.calibration import POINTS, Calibration, MotorCalibration
from gateway.settings.sections import Thermal
from gateway.study.calibrating import Learner
from gateway.study.temperature_reader import CycleLog
from tests.stations import TemperatureMonitor, Temperatures, debounce, flag

DATA: Final = Path(__file__).parents[1] / "tests" / "data" / "temperatures"
TICK_NS: Final = 10 * MS
CYCLE_NS: Final = 100 * MS
STALE_NS: Final = 310 * MS
"""Three cycles and a tick, as for our own `Temperatures`."""
LEAST_C, MOST_C = -60.0, 300.0
MARGIN: Final = 1.5
"""That of `traction-gateway calibrate`."""

POWER_UP_S: Final = 1955.7
"""Stamp in the Kona's log from which it starts anew."""
JOINTS: Final = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
ICUB_CODES: Final = (-30.0, -50.0, -70.0)
"""Not configured, lost configuration, no measurement for 10 s; -90, no answer, is out of range."""
BRIDGES: Final = ("HB1", "HB2", "HB3")
LABELS: Final = ("F0", "F1", "F2", "F3", "F5", "F6", "F8")
LEARNT_S: Final = 200.0
"""Of F0, the recording without a fault; the rest of it is judged."""
ACCURACY_K: Final = 3.0
"""What the conversion of the half-bridges' ADC may be off by: one B for an NTC nobody measured."""
ONE: Final = ("stator",)
LEG: Final = (ONE,) * len(JOINTS)
HALF_BRIDGES: Final = (ONE,) * len(BRIDGES)
KONA_ID: Final = 0x523
KONA_NOT_AVAILABLE: Final = 0xFF


def reading(drive: int, t_ns: Nanos, celsius: Sequence[float | None]) -> Temperatures:
    """As the inbox: NaN and not valid where there is no value (None), or one out of range."""
    values = [*celsius, *[None] * (len(POINTS) + 1 - len(celsius))]
    kept = [math.nan if v is None or not LEAST_C <= v <= MOST_C else v for v in values]
    valid = tuple(math.isfinite(v) for v in kept)
    # A tenth is the wire's resolution, and what "holds a value" means.
    raw = tuple(round(v * 10.0) if ok else -1 for v, ok in zip(kept, valid, strict=True))
    return Temperatures(drive, t_ns, tuple(kept), valid, raw)


def _rows(name: str) -> Iterator[dict[str, str]]:
    with gzip.open(DATA / name, "rt", encoding="utf-8", newline="") as file:
        yield from csv.DictReader(file)


def icub(codes: Sequence[float] = ICUB_CODES) -> list[Temperatures]:
    """Six joints' motors, a sensor each, at about 80 Hz; `codes`: exact values that are none."""
    made = []
    for row in _rows("icub_leg.csv.gz"):
        t_ns = round(float(row["t_s"]) * SECOND)
        for k, joint in enumerate(JOINTS):
            value = float(row[f"{joint}_degC"])
            made.append(reading(k, t_ns, [None if value in codes else value]))
    return made


def inverter(label: str) -> list[Temperatures]:
    """Three half-bridges as three motors of one sensor; `label` of `LABELS`."""
    return [
        reading(k, round(float(row["t_s"]) * SECOND), [float(row[f"t{k + 1}_degC_beta3950"])])
        for row in _rows("inverter_faults.csv.gz")
        if row["label"] == label
        for k in range(len(BRIDGES))
    ]


def kona_frames() -> list[Frame]:
    return [f for f in Reader(DATA / "kona_523.log.gz") if f.can_id == KONA_ID]


def kona(frames: Iterable[Frame], status: bool = True) -> list[Temperatures]:
    """Inlet and two fast sensors of an inverter, one motor of three sensors.

    status: byte 0 says whether there are measurements (bit 3), as `Quality` does with us. It is
    0 for 170 ms after power-up: default 0x28 first (0 degC), then filters that rise from it.
    """
    made = []
    for frame in frames:
        up = bool(frame.data[0] & 0x08) or not status
        codes = frame.data[2:5]
        good = [up and code != KONA_NOT_AVAILABLE for code in codes]
        values = [code - 40.0 if ok else None for code, ok in zip(codes, good, strict=True)]
        made.append(reading(0, frame.t_ns, values))
    return made


class Said(NamedTuple):
    """What was said in every cycle, arrays (T,) and (T, N) unless said otherwise."""

    t_s: np.ndarray
    celsius: np.ndarray
    """Newest value of each motor's first sensor, NaN where it is not valid."""
    thermal: np.ndarray
    sensor: np.ndarray
    kind: np.ndarray
    which: np.ndarray
    reason: np.ndarray
    deviation_k: np.ndarray
    maisd_k: np.ndarray
    """(T,): of the first point."""


def judge(
    readings: Sequence[Temperatures],
    fitted: Sequence[Sequence[str]],
    calibration: Calibration | None = None,
    learner: Learner | None = None,
) -> Said:
    """Every tick through the thermal side and the flags' table, as in `gateway/core/gateway.py`."""
    drives, settings = len(fitted), Thermal()
    nodes = tuple(range(1, drives + 1))
    side = TemperatureMonitor(drives, CYCLE_NS, settings.window_s, calibration, nodes, fitted)
    heat = Timing(0, round(settings.raise_s * SECOND), round(settings.clear_s * SECOND))
    start = readings[0].t_ns
    thermal, sensor = ([flag(start) for _ in nodes] for _ in range(2))
    newest = np.full(drives, np.nan)
    rows: list[tuple[object, ...]] = []
    log = CycleLog(drives)
    at = 0
    for tick in range((readings[-1].t_ns - start) // TICK_NS + 1):
        now = start + tick * TICK_NS
        first = at
        while at < len(readings) and readings[at].t_ns <= now:
            newest[readings[at].drive] = readings[at].celsius[0]
            at += 1
        side.add_readings(readings[first:at], now)
        if learner is not None:
            log.note(side, now)
            if log.full:
                learner.learn(log.drain(), side.sensors.configured, side.dt_s)
        reports = [side.report(k, now, STALE_NS) for k in range(drives)]
        for k, report in enumerate(reports):
            debounce(thermal[k], report.thermal, heat, TICK_NS, now)
            debounce(sensor[k], report.sensor, SENSOR, TICK_NS, now)
        if tick % (CYCLE_NS // TICK_NS) == 0:
            rows.append((
                (now - start) / SECOND, newest.copy(), [f["state"].item() for f in thermal],
                [f["state"].item() for f in sensor], [r.fault_class for r in reports],
                [r.fault_sensor for r in reports], [r.reason for r in reports],
                side.window.deviation[:, 0].copy(), side.spread[0],
            ))  # fmt: skip
    if learner is not None:
        learner.learn(log.drain(), side.sensors.configured, side.dt_s)
    return Said(*(np.array(column) for column in zip(*rows, strict=True)))


def before(readings: Iterable[Temperatures], t_s: float) -> list[Temperatures]:
    """Those before `t_s` of the recording."""
    return [r for r in readings if r.t_ns < t_s * SECOND]


def after(readings: Iterable[Temperatures], t_s: float) -> list[Temperatures]:
    """Those from `t_s` of the recording on."""
    return [r for r in readings if r.t_ns >= t_s * SECOND]


def learn(readings: Sequence[Temperatures], fitted: Sequence[Sequence[str]]) -> Calibration:
    """A calibration as `traction-gateway calibrate` makes it. Raises ConfigError."""
    learner = Learner(tuple(range(1, len(fitted) + 1)), Thermal().window_s)
    learner.begin()
    judge(readings, fitted, learner=learner)
    return learner.finish(MARGIN)


def learn_inverter(t_s: float = LEARNT_S) -> Calibration:
    """From the first `t_s` of F0, and nothing else."""
    return learn(before(inverter("F0"), t_s), HALF_BRIDGES)


def to_accuracy(calibration: Calibration) -> Calibration:
    """Deviation limits not below what the sensors are good for."""
    limits = tuple(max(limit, ACCURACY_K) for limit in calibration.deviation_limit_k)
    return calibration.model_copy(update={"deviation_limit_k": limits})


def learn_icub(t_s: float = 60.0) -> Calibration:
    """From the first `t_s`; of ankle_roll, which never gave a value, there is nothing to learn."""
    dead = len(JOINTS) - 1
    found = learn([r for r in before(icub(), t_s) if r.drive != dead], LEG[:dead])
    none = (0.0,) * len(POINTS)
    neutral = MotorCalibration(
        node=dead + 1, gain=(1.0,) * len(POINTS), offset_k=none, longest_hold_s=none,
        largest_step_k=none,
    )  # fmt: skip
    return found.model_copy(update={"motor": (*found.motor, neutral)})


def holding_rule(calibration: Calibration) -> Calibration:
    """As if the sensors were noisy: then four times the longest hold in health is the limit."""
    noisy = {"largest_step_k": (1.0,) * len(POINTS)}
    motors = tuple(motor.model_copy(update=noisy) for motor in calibration.motor)
    return calibration.model_copy(update={"motor": motors})


def judged(cells: Calibration, learnt_s: float = LEARNT_S) -> dict[str, Said]:
    """Every recording by its label; of F0 only what was not learnt from."""
    return {
        label: judge(
            after(inverter(label), learnt_s) if label == "F0" else inverter(label),
            HALF_BRIDGES,
            cells,
        )
        for label in LABELS
    }


def kona_runs() -> dict[str, Said]:
    """The log whole and from power-up, with the status byte and without."""
    frames = kona_frames()
    cut = [f for f in frames if f.t_ns >= POWER_UP_S * SECOND]
    return {
        f"{name}, status byte {'used' if status else 'not used'}": judge(
            kona(chosen, status), [POINTS]
        )
        for name, chosen in (("whole log", frames), ("from power-up", cut))
        for status in (True, False)
    }
