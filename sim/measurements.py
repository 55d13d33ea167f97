"""From the plant's state to the numbers in the drives' messages.

May know: names of messages and signals, sensors, heat. May not know: bits, buses, clocks.
"""

from __future__ import annotations

import math

import numpy as np

from dbc.arrays import Array
from sim.drive_spread import Variety
from sim.faults import Schedule
from sim.physics import plant as columns
from sim.physics import sensors, thermal
from sim.physics.thermal import ThermalTrain
from sim.scenario import Scenario

Values = dict[str, float | int | None]
VALID = 1
"""`Quality`."""
OPERATION = 2
"""`Status.State`."""
SAMPLES_PER_FRAME = 8
FULL_CIRCLE_DEG = 359.995
"""From here on the angle would be rounded to 360.00 degrees, which is 0."""
CURRENTS = ("Quality", "Ia", "Ib", "Ic")
VOLTAGES = ("Quality", "Ualpha", "Ubeta", "Udc")
SAMPLES = (
    "Quality", "SampleIndex", "Udc",
    *(f"{name}_{k}" for k in range(8) for name in ("Ia", "Ib", "Ualpha", "Ubeta")),
)  # fmt: skip
POINTS = ("Tstator", "Tde", "Tnde", "Tambient")


class Readings:
    """Sensors of all drives, with their memory between two messages."""

    def __init__(
        self, scenario: Scenario, schedule: Schedule, heat: ThermalTrain, variety: Variety
    ) -> None:
        """Everything random comes from the scenario's seed."""
        n = scenario.drives
        s, t = scenario.sensors, scenario.thermal
        self._schedule, self._heat, self._n = schedule, heat, n
        self._torque_scale = variety.torque_scale
        self._currents = sensors.CurrentSensors(
            scenario.seed, n, s.current_noise_var, variety.offset, variety.gain, s.current_range_a
        )
        self._temperatures = sensors.TemperatureSensors(
            scenario.seed, t.train_seed, n, s.temperature_noise_k, s.temperature_offset_k
        )
        self._held_current = sensors.Hold((n,))
        self._held_temperature = sensors.Hold((n, sensors.POINTS))

    def currents(self, rows: Array, instants_s: Array) -> Array:
        """(n, N, 10) plant rows at times (n,) -> (n, N, 3) phase readings, A.

        Lost readings are NaN, which the codec turns into the not-available code.
        """
        out = self._currents.read(rows[..., columns.I_ALPHA : columns.I_BETA + 1])
        if self._schedule.has_current_faults:
            for reading, t_s in zip(out, instants_s.tolist(), strict=True):
                bias, stuck, lost = self._schedule.current_faults(t_s)
                reading[:, 0] = self._held_current.apply(reading[:, 0] + bias, stuck)
                reading[lost] = math.nan
        return out

    @staticmethod
    def samples(first: int, amps: Array, volts: Array, u_dc: Array) -> Array:
        """(m, 35) values of m Samples frames of one drive, columns SAMPLES.

        `amps` (m, 8, 3), `volts` (m, 8, 2), `u_dc` (m,); `first`: index of the first sample.
        """
        m = len(u_dc)
        out = np.empty((m, len(SAMPLES)))
        out[:, 0] = VALID
        out[:, 1] = (first + SAMPLES_PER_FRAME * np.arange(m)) % 65536
        out[:, 2] = u_dc
        out[:, 3:] = np.concatenate([amps[..., :2], volts], axis=2).reshape(m, -1)
        return out

    def motion(self, row: Array) -> list[Values]:
        """Values of Motion, per drive, from the plant's row (N, 10).

        The torque is what the drive calculates from its current and the data sheet's flux.
        """
        rpm = row[:, columns.SPEED] * 30.0 / math.pi
        degrees = np.degrees(row[:, columns.ANGLE])
        degrees = np.where(degrees >= FULL_CIRCLE_DEG, 0.0, degrees)
        torque = row[:, columns.TORQUE] * self._torque_scale
        return [
            {"Quality": VALID, "Speed": w, "ElectricalAngle": a, "Torque": t}
            for w, a, t in zip(rpm.tolist(), degrees.tolist(), torque.tolist(), strict=True)
        ]

    @staticmethod
    def status(row: Array, mean_i_squared: Array, fault_codes: list[int]) -> list[Values]:
        """Values of Status, per drive; `mean_i_squared` (N,): mean |i|^2, for a phase's rms."""
        rms = np.sqrt(0.5 * mean_i_squared)
        command = row[:, columns.COMMAND]
        return [
            {"Quality": VALID, "Irms": i, "TorqueCommand": c, "State": OPERATION, "FaultCode": f}
            for i, c, f in zip(rms.tolist(), command.tolist(), fault_codes, strict=True)
        ]

    def temperatures(self, t_s: float) -> list[Values]:
        """Values of Temperatures, per drive, at this time."""
        readings = self._temperatures.read(self._points(self._heat.temperatures))
        bias, stuck, lost = self._schedule.temperature_faults(t_s)
        readings = self._held_temperature.apply(readings + bias, stuck)
        out: list[Values] = []
        for row, gone in zip(readings.tolist(), lost.tolist(), strict=True):
            points = zip(POINTS, row, gone, strict=True)
            known = {name: None if missing else value for name, value, missing in points}
            out.append({"Quality": VALID, **known})
        return out

    def fault_effect(self, t_s: float) -> Array:
        """(N,) K: see `Truth.true_effect_k`."""
        if not self._schedule.has_thermal_faults:
            return np.zeros(self._n)
        real = self._points(self._heat.temperatures)
        twin = self._points(self._heat.healthy)
        bias, stuck, lost = self._schedule.temperature_faults(t_s)
        held = self._held_temperature.held - self._temperatures.offset
        reading = np.where(stuck & ~np.isnan(held), held, real + bias)
        effect = np.where(lost, 0.0, reading - twin)
        largest = np.abs(effect).argmax(axis=1)
        out: Array = effect[np.arange(self._n), largest]
        return out

    def _points(self, temperatures: Array) -> Array:
        """(N, 4) what ideal sensors would read, degC, from the nodes' (N, 6)."""
        ambient = np.full((self._n, 1), self._heat.ambient)
        return np.concatenate([temperatures[:, list(thermal.MEASURED)], ambient], axis=1)
