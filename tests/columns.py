"""Fields of records under the short names of the oracles in `tests/reference/`."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.records import Records
from gateway.core.estimate import estimates
from gateway.core.inputs import statuses
from gateway.core.receiving import drive_inputs

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bytes = NDArray[np.uint8]
Flags = NDArray[np.bool_]


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


class Inputs(NamedTuple):
    """Fields of `input_status` of N drives, (N,).

    cause: `reason`; fresh: `sample_fresh`; commanded: `command_valid`; speed: `speed_rad_s`;
    suspect: `current_sum_fault`; comm.
    """

    cause: Bytes
    fresh: Flags
    commanded: Flags
    speed: Array
    suspect: Flags
    comm: Bytes


class SlowState(NamedTuple):
    """Last good values, columns of `struct drive_input`, (N,); NaN until the first.

    speed rad/s at the rotor; command and before (the one before that) Nm; irms A; operating: its
    `State` is Operation, or it sends none; command_ns: stamp of the last; steady: it has hardly
    changed since the one before; emergency_ns: stamp of the last emergency that counts.
    """

    speed: Array
    command: Array
    before: Array
    irms: Array
    operating: Flags
    command_ns: Ints
    steady: Flags
    emergency_ns: Ints


def told_of(records):
    """Fields of these records."""
    return Told(
        records, records["health"], records["health_reason"], records["speed_rad_s"],
        records["load_nm"], records["load_sigma_nm"], records["nis"], records["flux_ratio"],
    )  # fmt: skip


def told(n):
    """Of N drives of which nothing is known."""
    return told_of(estimates(n))


def inputs_of(status):
    """Fields of these records."""
    return Inputs(
        status["reason"], status["sample_fresh"].view(np.bool_),
        status["command_valid"].view(np.bool_), status["speed_rad_s"],
        status["current_sum_fault"].view(np.bool_), status["comm"],
    )  # fmt: skip


def inputs(n):
    """Of N drives of which nothing is known."""
    return inputs_of(statuses(n))


def slow_of(drives):
    """Columns of these records."""
    return SlowState(
        drives["speed"], drives["command"], drives["previous_command"], drives["irms"],
        drives["operating"].view(np.bool_), drives["command_ns"],
        drives["command_steady"].view(np.bool_), drives["emergency_ns"],
    )  # fmt: skip


def slow(n):
    """Of N drives, of which nothing has been received."""
    return slow_of(drive_inputs(n))
