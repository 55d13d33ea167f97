"""The train as all its rotors and commands show it together, before any drive is judged.

The rules are in `gateway/core/train.c` and `rotors.c`, what is remembered of a rotor is `struct
rotor` in `gateway/core/records.h`. May know: numbers. May not know: frames, clocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from _traction_core import ffi, lib
from numpy.typing import NDArray

from dbc.records import ROTOR, ROTOR_INPUTS, Records
from gateway.config import Motor

Array = NDArray[np.float64]


class Train(NamedTuple):
    """N drives: `rotor` and `rotor_inputs`, (N,); rank (N,): scratch.

    uncertain, doubt_ns (N,): two fields of `rotors`, for those who know columns only.
    """

    rotors: Records
    inputs: Records
    rank: Array
    uncertain: NDArray[np.uint8]
    doubt_ns: NDArray[np.int64]


def start(motors: Sequence[Motor]) -> Train:
    """Nothing known. Speeds are compared between drives whose motors have the same ratings.

    What was measured on each motor, such as its flux, may differ.
    """
    n = len(motors)
    ratings = [(m.pole_pairs, m.T_rated, m.I_rated) for m in motors]
    kinds = list(dict.fromkeys(ratings))
    rotors = np.zeros(n, ROTOR)
    rotors["rated_nm"] = [m.T_rated for m in motors]
    rotors["inertia_kg_m2"] = [m.J for m in motors]
    rotors["motor"] = [kinds.index(rating) for rating in ratings]
    lib.train_reset(ffi.from_buffer("struct rotor[]", rotors), n)
    return Train(
        rotors, np.zeros(n, ROTOR_INPUTS), np.zeros(n), rotors["uncertain"],
        rotors["doubt_until_ns"],
    )  # fmt: skip
