"""Coverage of the monitor's own prediction, on fault-free blocks that calibration held back.

The healthy filter of `monitor` predicts every block from those before it. Its normalised
innovations have unit variance and no correlation where the model explains the motor (Bar-Shalom,
Li and Kirubarajan 2001, section 5.4: filter consistency).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from _traction_core import lib

from dbc.arrays import Array
from dbc.records import Records, pointer
from estimators.thermal.monitor import Coverage, ThermalMonitor

START: Final = 5
"""First blocks, which are left out: the filter still finds the state of the motor."""
FEWEST: Final = 20
"""Fewest blocks that a motor is measured on."""
MOST_INFLATION: Final = 1.5
"""Largest inflation: a model that is wrong by more is not trusted, however wide its band."""
BAND: Final = 1.96
"""Standard deviations that hold 95 % of a normal distribution."""


def innovations(monitor: ThermalMonitor, off: Array, inputs: Records) -> Array:
    """Normalised innovations (B, M, 3), unit variance if the filter is right; NaN: no reading.

    off (B, M, 3): deviation from the other motors, K; inputs (B, M) of `struct thermal_sums`.
    """
    out = np.empty(off.shape)
    noise_k = monitor.known_motors["block_noise_k"]
    for m, held_back in enumerate(monitor.held_back(off, inputs)):
        mean, cov = np.empty((len(off), 3)), np.empty((len(off), 3, 3))
        lib.thermal_expected(*held_back, pointer("double", mean), pointer("double", cov))
        seen = np.isfinite(off[:, m])
        both = seen[:, :, None] & seen[:, None, :]
        cov = np.where(both, cov + noise_k[m] ** 2 * np.eye(3), np.eye(3))
        error = np.where(seen, off[:, m] - mean, 0.0)
        white = np.linalg.solve(np.linalg.cholesky(cov), error[:, :, None])[:, :, 0]
        out[:, m] = np.where(seen, white, np.nan)
    return out


def measure(monitor: ThermalMonitor, off: Array, inputs: Records) -> Coverage:
    """Measure the coverage of fault-free blocks; arguments as in `innovations`."""
    z = innovations(monitor, off, inputs)[START:]
    loss = inputs["copper"][START:] / np.maximum(inputs["count"][START:], 1.0)
    motors = off.shape[1]
    out = Coverage(
        np.ones(motors), np.full((motors, 2), np.nan), np.full(motors, np.nan), np.zeros(motors)
    )
    for m in range(motors):
        seen = np.isfinite(z[:, m]).any(axis=1)
        if np.count_nonzero(seen) < FEWEST:
            continue
        own = z[seen, m]
        out.inflation[m] = np.clip(np.sqrt(np.nanmean(own**2)), 1.0, MOST_INFLATION)
        inside = np.where(np.isfinite(own), np.abs(own) <= BAND * out.inflation[m], np.nan)
        halves = np.array_split(np.argsort(loss[seen, m], kind="stable"), 2)
        out.covered[m] = [np.nanmean(inside[half]) for half in halves]
        product, square = own[1:] * own[:-1], own**2
        out.lag_one[m] = np.nansum(product) / max(np.nansum(square), 1e-12)
    return out
