"""What a user would write with the libraries: `LogReader`, cantools, one filterpy EKF a drive.

`python -m bench.chain LOG DBC` is the whole of it. It predicts in the same steps of 125 us as ours:
in the 2 ms between two samples the rotor turns by up to a radian, which one Euler step cannot
follow. It checks no checksum and no counter, knows no loss and no drive that starts, runs no
detector and sends nothing.
"""

from __future__ import annotations

import itertools
import math
import sys
import time
from pathlib import Path
from typing import Final

import can
import cantools
import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from estimators.models import pmsm
from estimators.models.pmsm import SUB_STEP_S, Noise, Pmsm

SUB_STEPS: Final = 16
"""Predictions a sample: 2 ms."""
_SQRT3: Final = math.sqrt(3.0)


def motors_of(n: int) -> tuple[Pmsm, Noise]:
    par = pmsm.repeat(pmsm.BENCH_MOTOR, n)
    return par, pmsm.default_noise(par, pmsm.Rated(np.full(n, 25.0), np.full(n, 30.0)))


def state_of(n: int) -> tuple[np.ndarray, np.ndarray]:
    """x (n, 5) and P (n, 5, 5) of n motors in motion."""
    x = np.tile([1.0, -1.0, 100.0, 0.5, 1.0], (n, 1))
    return x, np.tile(np.diag([1.0, 1.0, 25.0, 0.04, 400.0]), (n, 1, 1))


class Motor(ExtendedKalmanFilter):  # type: ignore[misc]
    """The motor in filterpy as a user would write it: floats, and one array at the end."""

    def __init__(self) -> None:
        super().__init__(5, 2)
        _, noise = motors_of(1)
        x, P = state_of(1)
        self.x, self.P = x[0], P[0]
        self.Q, self.R = np.diag(noise.Q[0]), np.diag(noise.R[0])
        self.H = np.eye(2, 5)
        self.u = (10.0, 10.0)
        R_s, L_s, psi, p, J, B, k_p = (float(value[0]) for value in pmsm.BENCH_MOTOR)
        dt = SUB_STEP_S
        self.factors = (
            1 - R_s / L_s * dt, psi / L_s * dt, 1 - B / J * dt, k_p * p * p * psi / J * dt,
            p * dt / J, dt / L_s, dt,
        )  # fmt: skip

    def predict_x(self, _u: object = 0) -> None:
        i_a, i_b, w, theta, load = self.x.tolist()
        a, b, f, e, g, c, dt = self.factors
        sin, cos = math.sin(theta), math.cos(theta)
        self.x = np.array([
            a * i_a + b * w * sin + c * self.u[0],
            a * i_b - b * w * cos + c * self.u[1],
            f * w + e * (i_b * cos - i_a * sin) - g * load,
            theta + w * dt,
            load,
        ])  # fmt: skip

    def advance(self) -> None:
        """One prediction, over `SUB_STEP_S`."""
        i_a, i_b, w, theta, _ = self.x.tolist()
        a, b, f, e, g, _c, dt = self.factors
        sin, cos = math.sin(theta), math.cos(theta)
        self.F = np.array([
            [a, 0.0, b * sin, b * w * cos, 0.0],
            [0.0, a, -b * cos, b * w * sin, 0.0],
            [-e * sin, e * cos, f, -e * (i_b * sin + i_a * cos), -g],
            [0.0, 0.0, dt, 1.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, 1.0],
        ])  # fmt: skip
        self.predict()

    def step(self, y: np.ndarray) -> None:
        self.advance()
        self.correct(y)

    def correct(self, y: np.ndarray) -> None:
        """One update by two currents."""
        self.update(y, lambda _: self.H, lambda state: state[:2])


def chain(log: Path, dbc: Path, frames: int | None = None) -> tuple[float, int]:
    """s for the first `frames` frames, or all, and how many there were."""
    database = cantools.database.load_file(dbc)
    drives = {node: (Motor(), {}) for node in (1, 2, 3)}  # type: ignore[var-annotated]
    began, count = time.perf_counter(), 0
    for frame in itertools.islice(can.LogReader(log), frames):
        count += 1
        try:
            message = database.get_message_by_frame_id(frame.arbitration_id)
        except KeyError:
            continue
        drive, _, kind = message.name.partition("_")
        if kind not in ("PhaseCurrents", "StatorVoltages"):
            continue
        motor, halves = drives[int(drive.removeprefix("Drive"))]
        values = message.decode(frame.data)
        other = halves.pop(values["Counter"], None)
        if other is None:
            halves[values["Counter"]] = values
            continue
        currents, voltages = (values, other) if "Ia" in values else (other, values)
        a, b, c = (float(currents[name]) for name in ("Ia", "Ib", "Ic"))
        motor.u = float(voltages["Ualpha"]), float(voltages["Ubeta"])
        for _ in range(SUB_STEPS):
            motor.advance()
        motor.correct(np.array([(2.0 * a - b - c) / 3.0, (b - c) / _SQRT3]))
    return time.perf_counter() - began, count


if __name__ == "__main__":
    chain(Path(sys.argv[1]), Path(sys.argv[2]))
