"""What is learnt while a filter runs: `adaptation.c` for records of N drives."""

from __future__ import annotations

from _traction_core import ffi, lib

from dbc.arrays import Array
from dbc.records import Columns, pointer


def adapt(
    samples: Columns, filters: Columns, chords: Columns, table: Array, I_rated: Array, dt: float
) -> None:
    """After the filters: M innovations, in order. table (N, 7), I_rated (N,) A, dt: sub-step, s."""
    lib.adapt_filters(
        pointer("struct filter_sample", samples), len(samples),
        pointer("struct filter", filters), pointer("struct acquisition", chords),
        pointer("struct pmsm", table), ffi.from_buffer("double[]", I_rated), dt,
    )  # fmt: skip


def first_q_bias(chords: Columns, k: int, table: Array, I_rated: float) -> float:
    """`v_q_bias` of a new filter k, V."""
    return float(
        lib.first_q_bias(
            pointer("struct acquisition", chords[k:]), pointer("struct pmsm", table[k:]), I_rated
        )
    )
