"""The core's interacting filters and thermal monitor for tests: records in, arrays out."""

import numpy as np
from _traction_core import lib

from dbc import records
from dbc.records import pointer
from estimators.thermal import model
from estimators.thermal.monitor import SIZES_K, imm_config

MODES, STATES, HEATS = lib.IMM_MODES, lib.IMM_STATES, lib.IMM_HEATS
SIZE, RATE = STATES - 2, STATES - 1


def config(dt, faults=SIZES_K, **fields):
    """(1,) of `struct imm_config`; only the first faults: fewer modes."""
    every = np.zeros((MODES, 4))
    every[: len(faults)] = faults
    out = imm_config(1.0, dt, every)
    out["modes"] = len(faults)
    for name, value in fields.items():
        out[name] = value
    return out


def state(mode, mean, cov):
    """(1,) of `struct imm_state`; of fewer modes than there are: the others 0."""
    out = np.zeros(1, records.IMM_STATE)
    n = len(mode)
    out["mode"][0, :n], out["mean"][0, :n], out["cov"][0, :n] = mode, mean, cov
    return out


def started(options):
    """Filters of a motor that has just begun."""
    out = np.zeros(1, records.IMM_STATE)
    lib.imm_start(pointer("struct imm_config", options), pointer("struct imm_state", out))
    return out


def advance(options, around, y, noise, own, held=False):
    """`imm_advance`, own in place."""
    return lib.imm_advance(
        pointer("struct imm_config", options), pointer("struct imm_surroundings", around),
        pointer("double", np.array(y, dtype=float)), noise, held, pointer("struct imm_state", own),
    )  # fmt: skip


def mix(options, own, modes, begin, end):
    """Probabilities, means, covariances of the first modes after `imm_mix`."""
    out = np.zeros(1, records.IMM_STATE)
    lib.imm_mix(
        pointer("struct imm_config", options), pointer("struct imm_state", own), modes, begin, end,
        pointer("struct imm_state", out),
    )  # fmt: skip
    return out["mode"][0, :modes], out["mean"][0, :modes], out["cov"][0, :modes]


def update(g, y, noise, wide, x, p):
    """`imm_update`, x and p in place."""
    return lib.imm_update(
        g, pointer("double", np.array(y)), noise, wide, pointer("double", x), pointer("double", p)
    )


def kinds(options, own):
    """Probabilities (8,) and the likely size."""
    kind = np.empty(MODES - 1)
    size = lib.imm_kinds(
        pointer("struct imm_config", options), pointer("struct imm_state", own),
        pointer("double", kind),
    )  # fmt: skip
    return kind, size


def response(rates, dt):
    """fade, gain."""
    fade, gain = np.empty((5, 5)), np.empty((5, 5))
    given = np.ascontiguousarray(rates)
    lib.imm_response(
        pointer("double", given), dt, pointer("double", fade), pointer("double", gain)
    )  # fmt: skip
    return fade, gain


def surroundings(rates, pushes, heats, rise):
    """(1,) of `struct imm_surroundings`."""
    out = np.zeros(1, records.IMM_SURROUNDINGS)
    out["rates"], out["pushes"], out["heats"], out["rise_k"] = rates, pushes, heats, rise
    return out


def sums_of(means, count):
    """(1,) of `struct thermal_sums`: A^2, rad/s, K/s, K/s, K of a block of so many samples."""
    out = np.zeros(1, records.THERMAL_SUMS)
    names = ("current_square", "speed", "cooling", "copper", "rise")
    for name, value in zip(names, means, strict=True):
        out[name] = count * value
    out["count"] = count
    return out


def step(parameters, square, speed, ambient, extra, dt, x):
    """`thermal_model_step`, x (5,) in place."""
    given = np.array([(square, speed, ambient)], records.THERMAL_INPUT)
    lib.thermal_model_step(
        pointer("struct thermal_parameters", model.parameter_records(parameters)),
        pointer("struct thermal_input", given), pointer("double", extra), dt, pointer("double", x),
    )  # fmt: skip


def start(parameters, reading, speed, ambient, x):
    """`thermal_motor_start`, x (5,) in place."""
    given = np.array([(0.0, speed, ambient)], records.THERMAL_INPUT)
    return bool(
        lib.thermal_motor_start(
            pointer("struct thermal_parameters", model.parameter_records(parameters)),
            pointer("struct thermal_input", given),
            pointer("double", np.array(reading)),
            pointer("double", x),
        )
    )
