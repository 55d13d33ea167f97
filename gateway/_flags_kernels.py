"""Flags of the compiled core for loops that numba still compiles: columns to records."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dbc._core_symbols import symbol
from dbc._lean import inlined, lean

if TYPE_CHECKING:
    from dbc.records import Records
    from gateway.flags import Status
    from gateway.inputs import Inputs
    from gateway.said import Findings
    from gateway.tracks import Told

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Bytes = NDArray[np.uint8]

_collect, _debounce_flags = symbol("collect_evidence"), symbol("debounce_flags")
_publish = symbol("publish")


@lean
def fill_inputs(
    inputs: Inputs, wrong: Bytes, uncertain: Bytes, told: Told, lost: Array, known: Bools,
    severe: Bytes, findings: Findings, sample_ns: Ints, out: Records,
) -> None:  # fmt: skip
    """`flag_inputs` of N drives from the columns of the stations before.

    wrong (N,): the input cannot be what it seems; uncertain (N,): the rotor may run away; lost,
    known (N,): the detector's probabilities; sample_ns (N,): stamp of the newest sample.
    """
    for k in range(out.shape[0]):
        one = out[k]
        one["input_reason"], one["comm"] = inputs.cause[k], inputs.comm[k]
        one["current_sum_fault"], one["input_implausible"] = inputs.suspect[k], wrong[k]
        one["sample_ns"] = sample_ns[k]
        one["health"], one["health_reason"] = told.health[k], told.reason[k]
        one["speed_rad_s"], one["nis"] = told.speed[k], told.nis[k]
        one["load_nm"], one["load_sigma_nm"] = told.load[k], told.sigma[k]
        one["loss_probability"], one["loss_known"] = lost[k], known[k]
        one["may_spin_up"], one["severe_loss"] = uncertain[k], severe[k]
        one["thermal"], one["sensor"] = findings.thermal[k], findings.sensor[k]
        one["thermal_reason"], one["jumps"] = findings.reason[k], findings.jumps[k]
        one["fault_class"] = findings.fault_class[k]
        one["fault_sensor"] = findings.fault_sensor[k]
        one["mixed_c"], one["maisd_k"] = findings.mixed_c[k], findings.maisd_k[k]
        one["rate_k_h"], one["temperature_ns"] = findings.rate_k_h[k], findings.heard_ns[k]


@inlined
def update_flags(
    now: int, rules: Records, train_inputs: Records, inputs: Records, evidence: Records,
    status: Status,
) -> bool:  # fmt: skip
    """The three steps of `Flags`; whether a flag has changed."""
    n = inputs.shape[0]
    train, drives = train_inputs.ctypes.data, status.drives.ctypes.data
    _collect(rules.ctypes.data, train, inputs.ctypes.data, n, evidence.ctypes.data)
    changed = _debounce_flags(rules.ctypes.data, evidence.ctypes.data, n, now, drives)
    _publish(
        train, inputs.ctypes.data, evidence.ctypes.data, n, now, drives, status.train.ctypes.data
    )
    return changed != 0  # type: ignore[no-any-return]
