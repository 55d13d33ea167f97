"""Common parts of the paper's detectors: presets, the sweep loop, conversion to an Opinion.

Paper `adhesion`, sections 4.2-5; `docs/papers.md` lists the misprints. The modules next door
(`paper_vb`, `message_passing`, `kmeans`) work on whole records, arrays of T ticks by N drives
by D observed quantities, and do not use `Evidence`; the detectors call them with T = 1.
Component 0 adheres, component 1 has lost adhesion.

Two rules around the paper's methods are ours, because a detector must always give a result.
Drives that are unusable or not finite take no part. Where the common load is within `carried`
spreads of zero, no drive is lost (the drives carry no load, so no load can be missing).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import StrEnum
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.arrays import Array
from estimators.detect.protocol import Evidence, Opinion, nobody

Mask = NDArray[np.bool_]
Arrays = tuple[Array, ...]

SWEEPS: Final = 5
"""The paper's fixed number of sweeps, section 5."""
MOST_SWEEPS: Final = 100
"""Largest number of sweeps when the bound ends them."""

UNIT_NM: Final = 30.0
"""Rated torque of the paper's motor: its priors are in Nm, the gateway's loads per unit."""

SLIP: Final = 0.2
"""Relative offset of a lost wheel's preset speed. Ours: the paper presets torque only."""


OVERFLOW: Final = 1e100
"""Larger values are treated as not finite, because products of their squares overflow."""


class Observe(StrEnum):
    """Quantity that the central unit observes of each drive: paper `adhesion`, section 4.2."""

    TORQUE = "torque"
    SPEED = "speed"
    BOTH = "both"


def largest(load: Array) -> Array:
    """Load of largest magnitude over the drives, with its sign: (T, N) -> (T,).

    The paper's "max(M_z)"; a plain maximum would swap the components in braking. A tie between
    the two signs goes to the positive one.
    """
    high, low = load.max(axis=-1), load.min(axis=-1)
    return np.asarray(np.where(high >= -low, high, low))


def preset_means(load: Array, speed: Array | None = None) -> tuple[Array, Array | None]:
    """Initial means of the components: load (T, N) -> (T, 2), speed (T, N) -> (T, 2) or None.

    Load: [largest, 0], as in the paper. Speed (ours): a lost wheel runs away from the train, so in
    traction (sum of load times speed not negative) the slowest adheres and a lost one is `SLIP`
    faster; in braking the fastest adheres and a lost one is `SLIP` slower.
    """
    top = largest(load)
    torque = np.stack([top, np.zeros_like(top)], axis=-1)
    if speed is None:
        return torque, None
    traction = np.sum(load * speed, axis=-1) >= 0.0
    order = np.argsort(np.abs(speed), axis=-1, kind="stable")
    pick = np.where(traction, order[..., 0], order[..., -1])[..., None]
    adhering = np.take_along_axis(speed, pick, axis=-1)[..., 0]
    lost = adhering * np.where(traction, 1.0 + SLIP, 1.0 - SLIP)
    return torque, np.stack([adhering, lost], axis=-1)


def observations(load: Array, speed: Array | None, observe: Observe) -> tuple[Array, Array]:
    """Observed vectors x (T, N, D) and preset means (T, 2, D); torque first when D = 2.

    load (T, N) Nm, speed (T, N) rad/s. Raises ValueError if `observe` needs a speed and
    `speed` is None.
    """
    if observe is Observe.TORQUE:
        return load[..., None], preset_means(load)[0][..., None]
    if speed is None:
        raise ValueError(f"observation {observe.value!r} needs the drives' speeds")
    torque, preset = preset_means(load, speed)
    assert preset is not None
    if observe is Observe.SPEED:
        return speed[..., None], preset[..., None]
    return np.stack([load, speed], axis=-1), np.stack([torque, preset], axis=-1)


class Run(NamedTuple):
    """Result of `iterate`: final state, bound (T, S, B), sweeps made (T,)."""

    state: Arrays
    bound: Array
    sweeps: NDArray[np.int64]


def iterate(
    sweep: Callable[[Arrays, Arrays], tuple[Arrays, Array]],
    fixed: Arrays,
    state: Arrays,
    sweeps: int,
    tolerance: float | None,
) -> Run:
    """Repeat `sweep(fixed, state) -> (state, bounds (T, B))` over T ticks at once.

    bounds: the lower bound (18) after each of the sweep's B partial updates. Without a `tolerance`
    exactly `sweeps` are made. With one, a tick stops after a sweep that has raised its bound by
    less than tolerance |bound|, or whose bound is NaN; the rise of the first sweep counts from its
    own first partial update, which only weighs the presets. After the stop the history repeats its
    last value. Raises ValueError for fewer than one sweep.
    """
    if sweeps < 1:
        raise ValueError("at least one sweep is needed")
    ticks = state[0].shape[0]
    live = np.arange(ticks)
    count = np.zeros(ticks, dtype=np.int64)
    result: Arrays = tuple(np.array(a) for a in state)
    history = np.empty((0, 0, 0))
    before = np.empty(0)
    for s in range(sweeps):
        state, bounds = sweep(fixed, state)
        if s == 0:
            history = np.empty((ticks, sweeps, bounds.shape[1]))
            before = bounds[:, 0]
        after = bounds[:, -1]
        history[live, s] = bounds
        history[live, s + 1 :] = after[:, None, None]
        count[live] = s + 1
        for whole, part in zip(result, state, strict=True):
            whole[live] = part
        if tolerance is not None:
            keep = after - before >= tolerance * np.abs(after)
            if not keep.all():
                live, after = live[keep], after[keep]
                state = tuple(a[keep] for a in state)
                fixed = tuple(a[keep] for a in fixed)
            if live.size == 0:
                break
        before = after
    return Run(result, history, count)


def taking_part(evidence: Evidence, observe: Observe = Observe.TORQUE) -> Mask:
    """Mask (N,) of the drives whose observation is usable, finite and below `OVERFLOW`."""
    good = evidence.usable & (np.abs(evidence.load) < OVERFLOW)
    if observe is not Observe.TORQUE:
        speed = evidence.speed
        good = good & (np.abs(speed) < OVERFLOW if speed is not None else False)
    return good


def opinion(evidence: Evidence, part: Mask, lost: Array, common: float, carried: float) -> Opinion:
    """Opinion over all N drives from the probabilities of the M that took part.

    lost: (M,); common: in the unit of the evidence. A drive whose probability is not finite is
    unknown; if `common` is not finite, all drives are.
    """
    n = len(evidence.load)
    if not math.isfinite(common):
        return nobody(n)
    full = np.zeros(n)
    full[part] = lost
    known = part & np.isfinite(full)
    # Negated, so that a drive whose spread is NaN is not lost.
    full[~(known & (abs(common) > carried * evidence.spread))] = 0.0
    return Opinion(np.clip(full, 0.0, 1.0), known, common)


def falls_short(load: Array, spread: Array, common: float, threshold: float) -> Array:
    """Probability (M,) that a load lies more than `threshold` spreads below the common one.

    For methods that give a common load but no probability. Uses `math.erfc`, because importing
    `scipy.special` would take a quarter of a second at the start.
    """
    direction = 1.0 if common >= 0.0 else -1.0
    deficit = (common - load) * direction / spread - threshold
    return np.array([0.5 * math.erfc(-d / math.sqrt(2.0)) for d in deficit.tolist()])


def medians(load: Array) -> Array:
    """Global estimate by median filtering, section 5: loads (T, N) -> (T,)."""
    return np.asarray(np.median(load, axis=-1))
