"""Thermal model of a motor: five lumps, driven by the bus signals current, speed and ambient.

The equations are in `model.c`. Readings are those of winding and ends, plus an offset each. Core
and frame are two lumps: air cools the frame, the ends hang on it, the winding on the core, and this
shows when cooling fails. The parameters are rates, not heat capacities, because temperatures alone
do not determine more. The model runs open loop: a filter would follow the fault, and after a few
steps its residual would be white again. It replaces paper `thermal`, eq. (1), whose one lump of
850 kg has one time constant, whose Joule heat is that of the current's change, and which lacks the
time step.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from _traction_core import lib
from numpy.typing import NDArray

from dbc import records
from dbc.arrays import Array
from dbc.records import Records, pointer
from estimators.thermal.record import Record

NAMES: Final = (
    "a", "k_w", "k_c", "e_1", "e_2", "g_c", "g_f", "h_0", "h_1",
    "k_d", "f_d", "b_d", "k_n", "f_n", "b_n",
)  # fmt: skip
RATES: Final = len(NAMES)
A, K_W, K_C, E_1, E_2, G_C, G_F, H_0, H_1, K_D, F_D, B_D, K_N, F_N, B_N = range(RATES)
OFFSETS: Final = slice(RATES, RATES + 3)
COUNT: Final = RATES + 3
LUMPS: Final = 5
WINDING, CORE, FRAME, DRIVE_END, OTHER_END = range(LUMPS)
MEASURED: Final = (WINDING, DRIVE_END, OTHER_END)
EXTRA: Final = LUMPS
"""Columns of extra heat that no healthy motor has, K/s of each lump: for signatures of faults."""
TYPICAL: Final = np.array(
    [
        4e-6, 5e-3, 1e-3, 1e-5, 1.4e-7, 3e-3, 4e-3, 4e-4, 3e-6,
        1.6e-3, 3e-5, 6e-4, 1.6e-3, 3e-5, 6e-4, 0.0, 0.0, 0.0,
    ]
)  # fmt: skip
"""Start of the search: a motor of some hundred kilograms and kilowatts."""
LEAST_RISE_K: Final[float] = lib.THERMAL_LEAST_RISE_K
"""Least rise of the frame over the air that cooling is calculated with."""
STEP_S: Final = 60.0
"""Inputs are averaged over this time if they come faster and samples are further apart."""


class Inputs(NamedTuple):
    """Inputs of the model: current_square (L, M), speed (L,), ambient (L,), at (K,), step_s."""

    current_square: Array
    speed: Array
    ambient: Array
    at: NDArray[np.int64]
    step_s: float


def inputs_of(record: Record) -> Inputs:
    """A record's inputs, averaged to `STEP_S` where its samples are far enough apart."""
    spacing = np.diff(record.at, prepend=-1).min() * record.step_s
    group = round(min(STEP_S, spacing) / record.step_s)
    if group <= 1 or len(record.speed) % group or np.any((record.at + 1) % group):
        return Inputs(
            record.current_square, np.abs(record.speed), record.ambient, record.at, record.step_s
        )
    return Inputs(
        record.current_square.reshape(-1, group, record.motors).mean(axis=1),
        np.abs(record.speed).reshape(-1, group).mean(axis=1),
        record.ambient.reshape(-1, group).mean(axis=1),
        (record.at + 1) // group - 1,
        record.step_s * group,
    )


def predict(
    parameters: Array,
    inputs: Inputs,
    start: Array | None = None,
    extra: Array | None = None,
    core: Array | None = None,
) -> Array:
    """(K, M, 3) degC at stator, drive end, non-drive end, by the model alone.

    parameters (M, 18): rates of `NAMES` and three offsets; start (M, 3): readings at the beginning,
    None: the steady state of the first hour's mean inputs; extra (M, 5): constant heat in the
    lumps, K/s; core (M,): K that the core is warmer at the beginning than `initial_state` assumes.
    """
    lumps = simulate(parameters, inputs, start, extra, core)
    return np.asarray(lumps[:, :, list(MEASURED)] + parameters[:, OFFSETS])


def simulate(
    parameters: Array,
    inputs: Inputs,
    start: Array | None = None,
    extra: Array | None = None,
    core: Array | None = None,
) -> Array:
    """(K, M, 5) degC of all lumps; arguments as `predict`."""
    motors = len(parameters)
    square = np.broadcast_to(inputs.current_square, (len(inputs.speed), motors))
    heat = np.zeros((motors, EXTRA)) if extra is None else extra
    if start is None:
        first = max(round(3600.0 / inputs.step_s), 1)
        speed, ambient = float(inputs.speed[:first].mean()), float(inputs.ambient[:first].mean())
        mean = square[:first].mean(axis=0).tolist()
        rows = [steady_state(p, mean[m], speed, ambient, heat[m]) for m, p in enumerate(parameters)]
        state = np.stack(rows)
    else:
        state = initial_state(parameters, start, float(inputs.ambient[0]))
        if core is not None:
            state[:, CORE] += core
    return run(parameters, inputs._replace(current_square=square), heat, state)


def run(parameters: Array, inputs: Inputs, extra: Array, state: Array) -> Array:
    """(K, M, 5) degC of all lumps from `state` (M, 5) on; `state` becomes that at the last of `at`.

    extra (M, 5): as in `predict`; current_square must have M columns.
    """
    out = np.empty((len(state), len(inputs.at), LUMPS))
    motors, at = parameter_records(parameters), np.ascontiguousarray(inputs.at, dtype=np.int64)
    given = np.empty(len(inputs.speed), records.THERMAL_INPUT)
    given["speed"], given["ambient"] = inputs.speed, inputs.ambient
    for m, x in enumerate(state):
        given["current_square"] = inputs.current_square[:, m]
        lib.thermal_model_simulate(
            pointer("struct thermal_parameters", motors[m : m + 1]),
            pointer("struct thermal_input", given),
            pointer("double", np.ascontiguousarray(extra[m], dtype=np.float64)), inputs.step_s,
            pointer("int64_t", at), len(at), pointer("double", x), pointer("double", out[m]),
        )  # fmt: skip
    return np.ascontiguousarray(out.transpose(1, 0, 2))


def parameter_records(parameters: Array) -> Records:
    """(M,) of `struct thermal_parameters`, from (M, 18) or (18,)."""
    rows = np.ascontiguousarray(np.atleast_2d(parameters), dtype=np.float64)
    out: Records = rows.view(records.THERMAL_PARAMETERS)[:, 0]
    return out


def initial_state(parameters: Array, readings: Array, ambient: float) -> Array:
    """(M, 5) degC: lumps of motors with readings (M, 3); the frame follows from its ends.

    An end that settles is k/(k + b) of the way from the air to the frame. The core is assumed
    half way from the frame to the winding.
    """
    p, true = parameters, readings - parameters[:, OFFSETS]
    drive_end = ambient + (true[:, 1] - ambient) * (1.0 + p[:, B_D] / p[:, K_D])
    other_end = ambient + (true[:, 2] - ambient) * (1.0 + p[:, B_N] / p[:, K_N])
    frame = 0.5 * (drive_end + other_end)
    return np.stack([true[:, 0], 0.5 * (true[:, 0] + frame), frame, true[:, 1], true[:, 2]], axis=1)


def steady_state(p: Array, square: float, speed: float, ambient: float, extra: Array) -> Array:
    """(5,) degC: steady state of the lumps; finite for positive rates."""
    # The winding's resistance is taken as constant: this is a start value, not a result.
    copper = p[A] * square + extra[WINDING]
    through = p[K_C] / p[K_W] * copper + p[E_1] * speed + p[E_2] * speed**2 + extra[CORE]
    air = p[H_0] + p[H_1] * speed
    frame = ambient + (p[G_F] / p[G_C] * through + extra[FRAME]) / air
    core = frame + through / p[G_C]
    ends = [
        (p[k] * frame + p[f] * speed + p[b] * ambient + more) / (p[k] + p[b])
        for k, f, b, more in (
            (K_D, F_D, B_D, extra[DRIVE_END]), (K_N, F_N, B_N, extra[OTHER_END])
        )
    ]  # fmt: skip
    return np.array([core + copper / p[K_W], core, frame, *ends])


def system_matrix(p: Array, square: float, speed: float) -> Array:
    """(5, 5) 1/s: system matrix of the lumps' deviations from `simulate` under extra heat, K/s.

    p (18,): of one motor; square A^2 and speed rad/s at this instant.
    """
    a = np.empty((LUMPS, LUMPS))
    lib.thermal_model_system_matrix(
        pointer("struct thermal_parameters", parameter_records(p)), square, speed,
        pointer("double", a),
    )  # fmt: skip
    return a


def resistance(winding: Array) -> Array:
    """Resistance of the winding at these temperatures, degC, relative to that at 60 degC."""
    return np.array([lib.thermal_model_resistance(w) for w in winding.ravel()]).reshape(
        winding.shape
    )
