"""What is estimated of every drive, as records, and columns of them. May know: numbers.

The fields are those of `struct drive_estimate` in `gateway/core/records.h`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.records import DRIVE_ESTIMATE, Records
from gateway.core.codes import Reason

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]


class Told(NamedTuple):
    """`drive_estimate` of N drives, (N,), and its fields.

    reason: `health_reason`; speed, load, sigma, flux: `speed_rad_s`, `load_nm`, `load_sigma_nm`,
    `flux_ratio`.
    """

    estimates: Records
    health: Bytes
    reason: Bytes
    speed: Array
    load: Array
    sigma: Array
    nis: Array
    flux: Array


def estimates(n: int) -> Records:
    """`drive_estimate` of N drives of which nothing is known."""
    made = np.zeros(n, DRIVE_ESTIMATE)
    for name in ("speed_rad_s", "load_nm", "load_sigma_nm", "nis", "flux_ratio"):
        made[name] = np.nan
    made["health_reason"] = Reason.STARTING
    return made


def told_of(records: Records) -> Told:
    """Fields of these records."""
    return Told(
        records, records["health"], records["health_reason"], records["speed_rad_s"],
        records["load_nm"], records["load_sigma_nm"], records["nis"], records["flux_ratio"],
    )  # fmt: skip


def told(n: int) -> Told:
    """Of N drives of which nothing is known."""
    return told_of(estimates(n))
