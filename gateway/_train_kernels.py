"""The train of the compiled core for loops that are still numba's: columns to records and back."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dbc._core_symbols import symbol
from dbc._lean import inlined, lean

if TYPE_CHECKING:
    from gateway.slow import SlowState
    from gateway.tracks import Told
    from gateway.train import Train

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

_assess = symbol("assess_train")


@inlined
def _call(now: int, tick_s: float, train: Train) -> None:
    _assess(
        train.rotors.ctypes.data, train.inputs.ctypes.data, train.inputs.shape[0], now, tick_s,
        train.rank.ctypes.data,
    )  # fmt: skip


@lean
def assess_train(
    measured: Array, commanded: Flags, slow: SlowState, flag: Ints, now: int, tick_s: float,
    told: Told, train: Train,
) -> None:  # fmt: skip
    """`assess_train` in gateway/core/train.c, after the estimates and before they are compared.

    measured (N,): rotor speeds of fresh `Motion`, rad/s, NaN without; flag (N,): adhesion flags so
    far. Changes commanded (N,), false where a command cannot be right, and `told` of drives that
    are not judged.
    """
    for k in range(flag.shape[0]):
        one = train.inputs[k]
        one["measured_rad_s"], one["speed_rad_s"] = measured[k], told.speed[k]
        one["load_nm"], one["health"] = told.load[k], told.health[k]
        one["command_nm"], one["previous_command_nm"] = slow.command[k], slow.before[k]
        one["command_valid"], one["operating"] = commanded[k], slow.operating[k]
        one["adhesion"], one["not_judged"] = flag[k], 0
    _call(now, tick_s, train)
    for k in range(flag.shape[0]):
        one = train.inputs[k]
        commanded[k] = one["command_valid"] != 0
        if one["not_judged"] != 0:
            told.health[k], told.reason[k] = one["health"], one["health_reason"]
            told.speed[k] = told.load[k] = told.sigma[k] = told.nis[k] = math.nan
