"""The motors' temperatures: their records, and the thermal status of one motor.

The rules are in `gateway/core/thermal.c` (readings, seconds, window averages), `thermal_evidence.c`
(evidence from them), `temperature.c` (validity of sensors) and `estimators/thermal`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from _traction_core import ffi, lib
from numpy.typing import NDArray

from dbc.arrays import Array
from dbc.frame import SECOND, Nanos
from dbc.records import (
    MOTOR_CURRENT,
    MOTOR_TEMPERATURES,
    TEMPERATURE_MONITOR,
    THERMAL_INPUT,
    Addressed,
)
from estimators import maisd
from estimators.thermal import trend
from estimators.thermal.hypotheses import NAMED
from estimators.thermal.monitor import ThermalMonitor, set_cut_out
from gateway.core.inputs import NONE, Places
from gateway.core.temperature import SensorMonitor
from gateway.core.view import Wear
from gateway.settings.calibration import POINTS, Calibration
from gateway.settings.config import ConfigError

AMBIENT: Final = len(POINTS)
"""Index of the ambient temperature in a reading."""
SAMPLE_NS: Final = SECOND
"""Readings that come faster are averaged over this time."""
DRIVEN_SHARE: Final = 0.03
"""Share of the rated current from which motors without a thermal model are driven."""
NO_MODEL: Final = (
    "no thermal model of every configured motor: calibrate with logs that have Status and Motion "
    'and a changing duty, or set [thermal] method = "maisd"'
)


class Window(NamedTuple):
    """(N, P) of `struct temperature_window`: last values and window averages, degC; deviation K.

    valid: the last value is valid now; known: the average is; compared: its motor is compared with
    the others; uniform: workspace.
    """

    gain: Array
    offset_k: Array
    value: Array
    valid: NDArray[np.bool_]
    mean: Array
    known: NDArray[np.bool_]
    compared: NDArray[np.bool_]
    centred: Array
    deviation: Array
    uniform: Array
    number: NDArray[np.int64]


class TemperatureMonitor(Addressed):
    """All motors' temperatures (`struct temperature_monitor`)."""

    def __init__(
        self,
        motors: int,
        period_ns: Nanos,
        window_s: float,
        calibration: Calibration | None,
        nodes: tuple[int, ...],
        sensors: Sequence[Sequence[str]] | None = None,
        *,
        model: bool = False,
        limit_k: float = 10.0,
    ) -> None:
        """period_ns: the temperatures' cycle; the window is `window_s` long.

        sensors: names of the points each drive has; None: all have all. model: judge by the thermal
        model; limit_k: K that a motor may grow warmer than the others. Raises ConfigError where
        the calibration has no model.
        """
        self.limit_k = limit_k
        by_node = {m.node: m for m in calibration.motor} if calibration else {}
        cells = [by_node.get(n) for n in nodes]
        self.sensors = SensorMonitor(motors, period_ns, cells, sensors)
        every = max(round(SAMPLE_NS / period_ns), 1)
        self.dt_s = every * period_ns / SECOND
        """Time from one averaged reading to the next, s."""
        self.model: ThermalMonitor | None = None
        method = lib.THERMAL_UNCALIBRATED if calibration is None else lib.THERMAL_MAISD
        if model and calibration is not None:
            known = calibration.known(nodes)
            if known is None:
                raise ConfigError("calibration", [NO_MODEL])
            self.model = ThermalMonitor(known, self.dt_s)
            method = lib.THERMAL_MODEL
        self.motors = np.zeros(motors, MOTOR_TEMPERATURES)
        """(N,) of `struct motor_temperatures`."""
        self.motors["status"] = self.motors["motion"] = NONE
        self.record = np.zeros(1, TEMPERATURE_MONITOR)
        self.record["period_ns"], self.record["cycles_per_second"] = period_ns, every
        self.record["drive_count"], self.record["method"] = motors, method
        self.record["named"] = NAMED
        self.currents = (
            np.zeros(motors, MOTOR_CURRENT) if self.model is None else self.model.currents
        )
        """(N,) of `struct motor_current`."""
        self._ring = maisd.window(max(1, round(window_s * SECOND / period_ns)), motors, len(POINTS))
        self.window = _window(motors, calibration, nodes)
        self._windows = self.record["window"]
        self._windows["samples"], self._windows["spread"] = len(self._ring), np.nan
        self._windows["limit_k"] = calibration.maisd_limit_k if calibration else np.inf
        self._windows["apart_k"] = calibration.deviation_limit_k if calibration else np.inf
        self._ranked = np.zeros(motors)
        self._reading, self._input = np.zeros((motors, AMBIENT)), np.zeros(motors, THERMAL_INPUT)
        self.link()
        lib.temperatures_reset(self.pointer)

    def link(self) -> None:
        """See `Addressed`."""
        self.record["sensors"] = self.sensors.drives.ctypes.data
        self.record["motors"] = self.motors.ctypes.data
        self.record["model"] = 0 if self.model is None else self.model.record.ctypes.data
        self.record["reading"] = self._reading.ctypes.data
        self.record["input"] = self._input.ctypes.data
        self.record["currents"] = self.currents.ctypes.data
        self._windows = self.record["window"]
        self._windows["ring"], self._windows["ranked"] = (
            self._ring.ctypes.data, self._ranked.ctypes.data,
        )  # fmt: skip
        for name, array in self.window._asdict().items():
            self._windows[name] = array.ctypes.data
        self.pointer = ffi.from_buffer("struct temperature_monitor *", self.record)

    def wire(self, places: Places, limit_ns: Sequence[Nanos], rated_a: Sequence[float]) -> None:
        """Note the channels of currents and speeds, and the age limit of each drive's readings.

        rated_a: rated current of each motor, amplitude.
        """
        self.motors["status"], self.motors["motion"] = places.status, places.motion
        self.motors["age_limit_ns"] = limit_ns
        driven_square = (DRIVEN_SHARE * float(np.median(rated_a))) ** 2
        set_cut_out(self.record["cut_out"], driven_square, self.dt_s)

    @property
    def spread(self) -> Array:
        """(P,) MAISD, K; NaN where there is none."""
        return np.asarray(self._windows["spread"][0])

    @property
    def wear(self) -> list[Wear]:
        """What is known of each motor's degradation, while its temperatures are fresh."""
        fresh = self.motors["fresh"].tolist()
        return [
            self._wear(k) if self.model is not None and current else Wear()
            for k, current in enumerate(fresh)
        ]

    def _wear(self, k: int) -> Wear:
        own = self.motors["trend"][k : k + 1].copy()
        rate, sigma = trend.rate_of(own) or (None, None)
        return Wear(rate, sigma, trend.time_to(own, self.limit_k), int(self.motors["jumps"][k]))


def _window(motors: int, calibration: Calibration | None, nodes: tuple[int, ...]) -> Window:
    """Empty window, with the gains and offsets by which a calibration centres its values."""
    shape = (motors, len(POINTS))
    gain, offset = np.ones(shape), np.zeros(shape)
    if calibration is not None:
        gain, offset = (
            np.ascontiguousarray(part, dtype=np.float64) for part in calibration.centring(nodes)
        )
    value, mean, centred, uniform = np.zeros((4, *shape))
    valid, known, compared = np.zeros((3, *shape), dtype=np.bool_)
    number = np.zeros(shape, dtype=np.int64)
    return Window(
        gain, offset, value, valid, mean, known, compared, centred, np.full(shape, np.nan),
        uniform, number,
    )  # fmt: skip
