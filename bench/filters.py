"""What a step of the filters costs: one drive to 1,024, against what a user would write.

A step is a prediction over one sub-step and an update by two currents. References, in the same
run: filterpy (one filter a drive), NumPy over all drives at once (`tests/reference/ekf.py`), and
the paper's block-diagonal matrices of 5N x 5N taken literally.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

import numpy as np
from _traction_core import lib

from bench.chain import Motor, motors_of, state_of
from dbc.records import pointer
from estimators import filters
from estimators.models import pmsm
from estimators.models.pmsm import SUB_STEP_S
from tests.reference import ekf, motor_model

HEADER = ("filter", "drives", "per call", "per drive and step", "reference in the same run")
FLEETS: Final = (1, 3, 16, 64, 256, 1024)
DENSE: Final = (3, 16)
BLOCK: Final = 16
"""Steps of a block of samples."""
SPENT_S: Final = 0.25
"""Of measuring, each."""


def best(task: Callable[[], object]) -> float:
    """Shortest of many runs, s."""
    task()
    until, least = time.perf_counter() + SPENT_S, float("inf")
    while time.perf_counter() < until:
        began = time.perf_counter()
        task()
        least = min(least, time.perf_counter() - began)
    return least


def call_of(kind: str, n: int, steps: int, *, sub_steps: int = 1) -> Callable[[], None]:
    """One call with `steps` samples of each of n drives; kind: "ekf" or "ukf"."""
    par, noise = motors_of(n)
    drives = filters.unstarted(n)
    drives.x, drives.P = state_of(n)
    rng, rows = np.random.default_rng(0), n * steps
    drive = np.tile(np.arange(n, dtype=np.int32), steps)
    u, y = rng.normal(0.0, 10.0, (rows, 2)), rng.normal(0.0, 1.0, (rows, 2))
    n_sub, none = np.full(rows, sub_steps), np.zeros(rows, dtype=np.int64)
    samples = filters.sample_records(drive, u, y, n_sub, none)
    kept = (pmsm.table(par), filters.noise_records(noise), filters.settings(SUB_STEP_S, kind))
    motors, noises, settings = kept
    given = (
        pointer("struct filter_sample", samples), rows, pointer("struct pmsm", motors),
        pointer("struct filter_noise", noises), pointer("struct filter", drives), n,
        pointer("struct filter_settings", settings),
    )  # fmt: skip

    def call(_kept: object = (samples, drives, *kept)) -> None:
        lib.filter_run(*given)

    return call


def compiled(kind: str, n: int, steps: int, *, sub_steps: int = 1) -> float:
    return best(call_of(kind, n, steps, sub_steps=sub_steps))


def stacked(n: int) -> float:
    par, noise = motors_of(n)
    x, P = state_of(n)
    u, y = np.full((n, 2), 10.0), np.zeros((n, 2))

    def call() -> None:
        ekf.update(noise, *ekf.predict(par, noise, x, P, u, 1, SUB_STEP_S), y)

    return best(call)


def dense(n: int) -> float:
    """Paper `adhesion`, eq. (16)-(17), as written: one filter of 5N states."""
    par, noise = motors_of(n)
    x, P = state_of(n)
    u, y = np.full((n, 2), 10.0), np.zeros(2 * n)
    H = np.kron(np.eye(n), np.eye(2, 5))
    Q, R = np.diag(noise.Q.ravel()), np.diag(noise.R.ravel())

    def all_of(blocks: np.ndarray) -> np.ndarray:
        out = np.zeros((5 * n, 5 * n))
        for k, block in enumerate(blocks):
            out[5 * k : 5 * k + 5, 5 * k : 5 * k + 5] = block
        return out

    whole = all_of(P)

    def call() -> None:
        F = all_of(motor_model.jacobian(par, x, SUB_STEP_S))
        prior = motor_model.step(par, x, u, SUB_STEP_S).ravel()
        cov = F @ whole @ F.T + Q
        gain = np.linalg.solve(H @ cov @ H.T + R, H @ cov).T
        rest = np.eye(5 * n) - gain @ H
        prior + gain @ (y - H @ prior), rest @ cov @ rest.T + gain @ R @ gain.T

    return best(call)


def library() -> float:
    motor, y = Motor(), np.zeros(2)
    return best(lambda: motor.step(y))


def rows() -> list[tuple[str, ...]]:
    filterpy_s = library()
    out = [("filterpy EKF", "1", us(filterpy_s), us(filterpy_s), "")]
    for name in ("EKF", "UKF"):
        kind = name.lower()
        for n in FLEETS:
            tick, block = compiled(kind, n, 1), compiled(kind, n, BLOCK)
            step_s = block / n / BLOCK
            out.append((
                f"{name}, one step a call", str(n), us(tick), ns(tick / n),
                f"filterpy {filterpy_s * n / tick:.0f} x",
            ))  # fmt: skip
            out.append((
                f"{name}, {BLOCK} steps a call", str(n), us(block), ns(step_s),
                f"filterpy {filterpy_s / step_s:.0f} x",
            ))  # fmt: skip
    for n in FLEETS:
        numpy_s = stacked(n)
        out.append(("EKF, NumPy over all drives", str(n), us(numpy_s), ns(numpy_s / n), ""))
    for n in DENSE:
        dense_s = dense(n)
        out.append(("EKF of 5N states, NumPy", str(n), us(dense_s), ns(dense_s / n), ""))
    return out


def us(seconds: float, digits: int = 2) -> str:
    return f"{1e6 * seconds:.{digits}f} us"


def ns(seconds: float, digits: int = 1) -> str:
    return f"{1e9 * seconds:.{digits}f} ns"
