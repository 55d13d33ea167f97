"""Learn a thermal calibration from fault-free runs: first the centring, then the remaining spread.

The limits are the largest MAISD and deviation of the averaged, centred fault-free data times
a margin. The moving average makes neighbouring samples dependent, so a Gaussian quantile of
single samples would be wrong; the measured maximum is not.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from pydantic import ValidationError

from dbc.arrays import Array, Flags, Ints
from estimators import maisd
from estimators.thermal import model
from estimators.thermal.model_method import learn
from estimators.thermal.monitor import Coverage, Known, ThermalMonitor
from estimators.thermal.promise import Hours, hourly, hours_of
from estimators.thermal.record import Record, cut_out, of_driven_motors, split
from estimators.thermal.system_identification import SCALED_SIGMA, identify, scaled
from gateway.settings.calibration import (
    POINTS,
    Calibration,
    FleetHeat,
    MotorCalibration,
    MotorHeat,
    problems_of,
)
from gateway.settings.config import ConfigError
from gateway.settings.sections import FEWEST_COMPARED
from gateway.study.calibration_fit import Fit, fits
from gateway.study.temperature_reader import Cycles

FLOOR_K = (0.5, 1.0)
"""Smallest MAISD and deviation limits, K. A calibration run never varies as much as service:
a motor that was cut out for a second, or has another draught, differs by this much."""


FIT_SHARE = 0.7
FEWEST_SECONDS = 300
"""Fewest seconds of a run; a shorter one does not show how motors warm up."""
NEEDED = {
    "square": "the current (phase currents, or Irms in Status)",
    "speed": "the speed (Motion)",
    "ambient": "the ambient temperature (Temperatures)",
}
"""Quantities needed in each second, by their name in `Sample`."""
NO_HOUR = (
    "needs two logs or more; the last one is held back to set the limit and must last at least an "
    "hour"
)
VARIED, MINUTE = 0.1, 60
"""Least range of a motor's squared current over its largest, in means of so many samples."""
SPAN_K = 5.0
"""Least range of the fleet's mean over the logs with which a gain is learnt."""


class Sample(NamedTuple):
    """Means of a second: temperature (M, 3) degC, square (M,) A^2, speed, ambient; NaN: unknown."""

    temperature: Array
    square: Array
    speed: Array
    ambient: Array


class Learner:
    """Collector of window averages and sensor behaviour, cycle by cycle."""

    def __init__(self, nodes: tuple[int, ...], window_s: float, *, promises: bool = False) -> None:
        """Prepare for these motors and this window.

        promises: a rate of false alarms is stated, so no model is learnt from the last log.
        """
        self.nodes, self.promises = nodes, promises
        self.hours: Hours | None = None
        """Hours of the last log, if a rate is stated."""
        self.window_s = window_s
        self.means: list[list[np.ndarray]] = []
        shape = (len(nodes), len(POINTS))
        self.hold_ns = np.zeros(shape)
        self.step_k = np.zeros(shape)
        self.samples = 0
        self.fitted = np.ones(shape, dtype=np.bool_)
        """(N, P): which motor has which sensor, from the last cycles."""
        self.seconds: list[list[Sample]] = []
        """Samples of every log, second by second."""
        self.dt_s = 1.0
        self.fits: list[Fit] = []
        self.coverage: Coverage | None = None
        """Coverage of every motor, once a model has been learnt."""
        self.notes: list[str] = []
        """What was left out for the models."""
        self._last: np.ndarray | None = None

    def begin(self) -> None:
        """Start a new log: nothing is compared across the cut."""
        self._last = None
        self.means.append([])
        self.seconds.append([])

    def learn(self, cycles: Cycles, fitted: Flags, dt_s: float) -> None:
        """Add the next temperature cycles of the log.

        fitted: (M, P) which sensors exist; dt_s: time from one `Sample` to the next.
        """
        self.dt_s = dt_s
        for mean in cycles.second[cycles.second_complete]:
            square, speed, ambient = mean[:, len(POINTS) :].T
            self.seconds[-1].append(Sample(mean[:, : len(POINTS)], square, speed, ambient))
        known = cycles.known[:, fitted].all(axis=1)
        if not known.any():
            return
        self.fitted = fitted
        self.means[-1].append(cycles.mean_c[known])
        self.samples += int(known.sum())
        held = np.where(fitted, cycles.held_ns[known].max(axis=0), 0)
        self.hold_ns = np.maximum(self.hold_ns, held)
        before = [] if self._last is None else [self._last[None]]
        values = np.concatenate([*before, cycles.value_c[known]])
        if len(values) > 1:
            self.step_k = np.maximum(self.step_k, np.abs(np.diff(values, axis=0)).max(axis=0))
        self._last = values[-1]

    def too_little(self) -> list[str]:
        """A line if the logs are too short to show how far healthy motors differ."""
        found, fewest = sum(map(len, self.seconds)) * self.dt_s, FEWEST_SECONDS * self.dt_s
        if found >= fewest:
            return []
        return [
            f"the limits come from {found:g} s of temperatures, {fewest:g} s needed: beyond such "
            "limits a healthy motor may raise a flag; record a longer fault-free run"
        ]

    def lacks(self) -> list[str]:
        """Why there is no thermal model: a line for each motor and signal, or for the duty."""
        seconds = [second for log in self.seconds for second in log]
        if not seconds:
            return ["no second with temperatures"]
        never = [
            f"drive {node}: {what} was never known"
            for name, what in NEEDED.items()
            for j, node in enumerate(self.nodes)
            if not np.isfinite([getattr(second, name)[j] for second in seconds]).any()
        ]
        runs = [record for log in self.seconds if (record := self._record(log)) is not None]
        if never or not runs:
            return never or ["no second in which current, speed and ambient of all were known"]
        if len(runs) == 1:
            runs = list(split(runs[0], round(FIT_SHARE * len(runs[0].at))))
        never_driven = [
            f"drive {node}: it turned without current in every log that models are fitted to: all "
            f"but the last, or the first {FIT_SHARE:.0%} of a single one"
            for node, n in zip(self.nodes, _times_cut_out(runs[:-1]).tolist(), strict=True)
            if n == len(runs) - 1
        ]
        if never_driven:
            return never_driven
        shortest = round(min(len(run.at) for run in runs) * self.dt_s)
        if shortest < FEWEST_SECONDS * self.dt_s:
            return [
                f"all values are known for {shortest} s of the shortest run, at least "
                f"{FEWEST_SECONDS * self.dt_s:g} s are needed (of a single log, {FIT_SHARE:.0%} "
                "are used for the fit)"
            ]
        steady = np.array(self.nodes)[~_varied(runs)]
        names = ", ".join(map(str, steady.tolist()))
        return [f"drive {names}: the current never varied beyond noise: record a changing duty"]

    def finish(self, margin: float) -> Calibration:
        """The calibration. Raises ConfigError when the logs cannot give one."""
        if len(self.nodes) < FEWEST_COMPARED:
            raise ConfigError("calibrate", ["MAISD compares motors: at least two are needed"])
        if self.samples < 10:
            problem = "fewer than 10 samples in which all sensors of all motors had values"
            cure = "record a longer fault-free run, or name the drives of the log in --config"
            raise ConfigError("calibrate", [f"{problem}: {cure}"])
        means = np.concatenate([mean for log in self._comparable() for mean in log])
        gain, offset = _against_fleet(means, self.fitted)
        centred = (means - offset) / gain
        compared = [maisd.compare(m, self.fitted) for m in centred]
        spreads, apart = (np.array(part) for part in zip(*compared, strict=True))
        # NaN: a sensor that does not exist, or that no other motor has. The floors apply then.
        spread = np.nan_to_num(spreads).max(axis=0)
        limit = np.nan_to_num(np.abs(apart)).max(axis=(0, 1))
        try:
            return self._calibration(gain, offset, margin * spread, margin * limit)
        except ValidationError as error:
            raise ConfigError("calibrate", problems_of(error)) from None

    def _calibration(
        self, gain: np.ndarray, offset: np.ndarray, spread: np.ndarray, limit: np.ndarray
    ) -> Calibration:
        """Make the calibration. Raises ValidationError if a learnt value is out of bounds."""
        known = self._known()
        fleet = known and FleetHeat(
            scale=known.scale, duty=tuple(known.duty.tolist()), own_k=known.own_k,
            held_back_h=self.hours and self.hours.number,
            largest_log_odds=self.hours and self.hours.largest,
        )  # fmt: skip
        return Calibration(
            heat=fleet,
            window_s=self.window_s,
            maisd_limit_k=_three(np.maximum(spread, FLOOR_K[0])),
            deviation_limit_k=_three(np.maximum(limit, FLOOR_K[1])),
            motor=tuple(
                MotorCalibration(
                    node=node,
                    gain=_three(gain[j]),
                    offset_k=_three(offset[j]),
                    longest_hold_s=_three(self.hold_ns[j] / 1e9),
                    largest_step_k=_three(self.step_k[j]),
                    heat=known and _motor_heat(known, j),
                )
                for j, node in enumerate(self.nodes)
            ),
        )

    def _known(self) -> Known | None:
        """Learn the thermal model of every motor; None if the logs do not contain enough.

        Parameters come from all logs but the last (of one log: its first 70 %), the spread from
        the last one. With a stated rate, the last of several logs is first set aside for the hours.
        """
        runs = [record for log in self.seconds if (record := self._record(log)) is not None]
        own = runs.pop() if self.promises and len(runs) > 1 else None
        if len(runs) == 1:
            runs = list(split(runs[0], round(FIT_SHARE * len(runs[0].at))))
        if not runs or min(len(run.at) for run in runs) < FEWEST_SECONDS:
            return None
        if not _varied(runs).all() or (_times_cut_out(runs[:-1]) == len(runs) - 1).any():
            return None
        self.notes = [
            f"drive {node} turned without current in {n} of {len(runs)} runs; its readings in them "
            "are not used for its model"
            for node, n in zip(self.nodes, _times_cut_out(runs).tolist(), strict=True)
            if n
        ]
        runs = [of_driven_motors(run) for run in runs]
        known = learn(identify(runs[:-1], scaled(runs[:-1]), SCALED_SIGMA), runs)
        self.fits, self.coverage = fits(known, runs[-1], self.nodes), known.coverage
        if self.promises:
            peaks = np.zeros(0) if own is None else hourly(ThermalMonitor(known, self.dt_s), own)
            if not len(peaks):
                raise ConfigError("thermal.false_alarms_per_1000_h", [NO_HOUR])
            self.hours = hours_of(peaks)
        return known

    def _comparable(self) -> list[list[np.ndarray]]:
        """Means of the logs in which all motors were driven; of all logs if there is none."""
        records = [self._record(log) for log in self.seconds]
        driven = [
            means
            for means, record in zip(self.means, records, strict=True)
            if means and (record is None or not cut_out(record).any())
        ]
        return driven or self.means

    def _record(self, log: list[Sample]) -> Record | None:
        """A log's seconds from the first one with everything known; None if there is none.

        A second without current, speed or ambient gets the values of the second before.
        """
        if not log:
            return None
        square, speed, ambient = (
            _held(np.array([getattr(second, name) for second in log]))
            for name in ("square", "speed", "ambient")
        )
        known = np.isfinite(square + speed + ambient).all(axis=1)
        if not known.any():
            return None
        first = int(np.argmax(known))
        temperature = np.array([second.temperature for second in log])[first:]
        return Record(
            temperature, np.arange(len(temperature)), square[first:], speed[first:].mean(axis=1),
            ambient[first:].mean(axis=1), self.dt_s,
        )  # fmt: skip


def _times_cut_out(runs: Sequence[Record]) -> Ints:
    """(M,) number of runs in which each motor turned without current."""
    return np.asarray(np.sum([cut_out(run) for run in runs], axis=0, dtype=np.int64))


def _varied(runs: Sequence[Record]) -> Flags:
    """(M,) whether the heat of each motor's current changed: one duty tells no time constants."""
    cut = ((run.current_square, len(run.at) // MINUTE * MINUTE) for run in runs)
    minutes = [x[:n].reshape(-1, MINUTE, x.shape[1]).mean(axis=1) for x, n in cut]
    means = np.concatenate(minutes)
    return np.asarray(np.ptp(means, axis=0) > VARIED * means.max(axis=0))


def _held(values: Array) -> Array:
    """Values (L, M) with gaps filled by the last number; NaN before the first number."""
    rows = np.arange(len(values))[:, None]
    last = np.maximum.accumulate(np.where(np.isfinite(values), rows, 0), axis=0)
    return np.take_along_axis(values, last, axis=0)


def _three(values: Array) -> tuple[float, float, float]:
    """Values of the three points as a tuple of floats, as in the calibration."""
    return (float(values[0]), float(values[1]), float(values[2]))


def _motor_heat(known: Known, j: int) -> MotorHeat:
    """Part of the learnt model for motor j."""
    found = known.coverage
    measured = found is not None and bool(np.isfinite(found.covered[j]).all())
    return MotorHeat(
        rates=tuple(known.parameters[j, : model.RATES].tolist()),
        offset_k=_three(known.parameters[j, model.OFFSETS]),
        centre_k=_three(known.centre[j]),
        noise_k=_three(known.noise[j]),
        inflation=float(found.inflation[j]) if found and measured else None,
        covered=tuple(found.covered[j].tolist()) if found and measured else None,
        lag_one=float(found.lag_one[j]) if found and measured else None,
        false_share=float(found.false_share[j]) if found else None,
    )


def _against_fleet(means: np.ndarray, fitted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least-squares gain and offset (M, P) of every motor's points on the fleet's mean.

    means: (T, M, P) window averages; fitted: (M, P) which sensors exist; a missing one has gain 1
    and offset 0 and is in no mean. One duty alone does not separate gain from offset: gain 1.
    """
    fleet = (means * fitted).sum(axis=1, keepdims=True) / np.maximum(fitted.sum(axis=0), 1)
    centre = fleet.mean(axis=0)
    moved = fleet - centre
    apart = means - means.mean(axis=0)
    power = (moved**2).sum(axis=0)
    observable = fitted & (np.ptp(fleet, axis=0) > SPAN_K)
    both = (apart * moved).sum(axis=0)
    gain = np.divide(both, power, out=np.ones(means.shape[1:]), where=observable)
    return gain, np.where(fitted, means.mean(axis=0) - gain * centre, 0.0)
