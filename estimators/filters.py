"""EKF and UKF: `filter_simd.c` for records of N drives."""

from __future__ import annotations

from typing import Final

import numpy as np
from _traction_core import lib
from numpy.typing import NDArray

from dbc.arrays import Array
from dbc.records import (
    FILTER,
    FILTER_NOISE,
    FILTER_SAMPLE,
    FILTER_SETTINGS,
    Columns,
    pointer,
    zeros,
)
from estimators.models.pmsm import Noise

KAPPA: Final = -2.0
"""kappa of the UKF: n + kappa = 3, so that the sigma points match the kurtosis of a Gaussian."""


def unstarted(n: int) -> Columns:
    """`struct filter` of N drives whose filters have not started."""
    made = zeros(n, FILTER)
    made.P, made.nis, made.r_scale, made.is_finite = np.eye(5), 2.0, 1.0, 1
    return made


def noise_records(noise: Noise) -> Columns:
    """`struct filter_noise` of N drives."""
    made = zeros(len(noise.Q), FILTER_NOISE)
    made.Q, made.R, made.coast = noise.Q, noise.R, noise.coast
    return made


def settings(dt: float, kind: str = "ekf") -> Columns:
    """One `struct filter_settings`; dt: sub-step, s; kind: "ekf" or "ukf"."""
    made = zeros(1, FILTER_SETTINGS)
    made.dt, made.kappa, made.unscented = dt, KAPPA, kind == "ukf"
    return made


def sample_records(
    drive: NDArray[np.int_], u: Array, i: Array, steps: NDArray[np.int_], gap: NDArray[np.int_]
) -> Columns:
    """`struct filter_sample` of M samples: drive (M,), u V and i A (M, 2), steps and gap (M,)."""
    made = zeros(len(drive), FILTER_SAMPLE)
    made.drive, made.steps, made.gap, made.nis = drive, steps, gap, np.nan
    # A view keeps every value as it is: a product with 1j would turn infinity into NaN.
    made.u = np.ascontiguousarray(u, dtype=np.float64).view(np.complex128)[:, 0]
    made.i = np.ascontiguousarray(i, dtype=np.float64).view(np.complex128)[:, 0]
    return made


def run(
    samples: Columns, table: Array, noise: Columns, drives: Columns, settings: Columns,
    bits: int = 0,
) -> None:  # fmt: skip
    """Run filters over M samples, in place; table (N, 7) as `pmsm.table`.

    bits: width of the vector registers, 0: the best for the processor. Raises ValueError if the
    processor has no registers of this width.
    """
    given = (
        pointer("struct filter_sample", samples), len(samples), pointer("struct pmsm", table),
        pointer("struct filter_noise", noise), pointer("struct filter", drives), len(drives),
        pointer("struct filter_settings", settings),
    )  # fmt: skip
    if bits == 0:
        lib.filter_run(*given)
    elif lib.filter_run_with(bits, *given) < 0:
        raise ValueError(f"no registers of {bits} bits")
