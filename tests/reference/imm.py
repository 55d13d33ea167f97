"""Interacting filters of one motor in NumPy, which `estimators/thermal/imm.c` is compared with."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LUMPS, DISTURBANCES, POINTS, HEATS = 5, 5, 3, 5
STATES = LUMPS + DISTURBANCES + 2
SIZE, RATE = STATES - 2, STATES - 1
MODES = 1 + HEATS + POINTS
MEAN, SPREAD, CREEP, SHARE = range(4)
"""Of a fresh fault, in a mode's row of `sizes`: K, K, K/s, and of all faults that begin."""
LOCAL = [1, 3, 4]
"""Modes whose heat comes into one lump: winding, ends."""
COOLING = 2
"""Mode whose heat grows with the frame's own excess over the air."""
SEEN = np.array([0, 3, 4])
"""Lumps with a sensor."""
_ORDER = 12
_LEAST = 1e-30
_OUTLYING = 0.01
"""Share of blocks that are not what they seem."""


def _response(rates: Array, dt: float, fade: Array, gain: Array) -> None:
    """What is left after dt s of deviations, and what a steady heat of 1 K/s has made of them.

    rates (5, 5) 1/s as `heat.coupling`; fade, gain (5, 5) are filled: exp(rates dt) and its
    integral, by Taylor of a step short enough and doubling.
    """
    norm = np.abs(rates).sum(axis=1).max() * dt
    halvings = 0
    while norm > 0.5:
        norm *= 0.5
        halvings += 1
    h = dt / 2.0**halvings
    term = np.eye(LUMPS) * h
    total = term.copy()
    for k in range(2, _ORDER):
        term = term @ rates * (h / k)
        total = total + term
    power = np.eye(LUMPS) + rates @ total
    for _ in range(halvings):
        total = total + power @ total
        power = power @ power
    fade[:], gain[:] = power, total


def _mix(
    mode: Array, mean: Array, cov: Array, begin: float, end: float, sizes: Array,
    weight: Array, mean_out: Array, cov_out: Array,
) -> None:  # fmt: skip
    """The Markov chain of modes: faults begin with a fresh size, and end with none."""
    modes = len(mode)
    # What becomes healthy, or stays so.
    weight[0] = (1.0 - begin) * mode[0] + end * mode[1:].sum()
    mean_out[0], cov_out[0] = 0.0, 0.0
    for g in range(modes):
        share = ((1.0 - begin) if g == 0 else end) * mode[g] / weight[0]
        mean_out[0, :SIZE] += share * mean[g, :SIZE]
    for g in range(modes):
        share = ((1.0 - begin) if g == 0 else end) * mode[g] / weight[0]
        if share > 1e-12:
            off = mean[g, :SIZE] - mean_out[0, :SIZE]
            cov_out[0, :SIZE, :SIZE] += share * (cov[g, :SIZE, :SIZE] + np.outer(off, off))
    for g in range(1, modes):
        entering = begin * mode[0] * sizes[g, SHARE]
        weight[g] = (1.0 - end) * mode[g] + entering
        new = entering / weight[g]
        fresh = mean[0].copy()
        fresh[SIZE], fresh[RATE] = sizes[g, MEAN], 0.0
        middle = new * fresh + (1.0 - new) * mean[g]
        a, b = fresh - middle, mean[g] - middle
        mean_out[g] = middle
        cov_out[g] = new * np.outer(a, a) + (1.0 - new) * (cov[g] + np.outer(b, b))
        cov_out[g, :SIZE, :SIZE] += new * cov[0, :SIZE, :SIZE]
        cov_out[g, SIZE, SIZE] += new * sizes[g, SPREAD] ** 2
        cov_out[g, RATE, RATE] += new * sizes[g, CREEP] ** 2


def _update(x: Array, p: Array, g: int, y: Array, noise: float, wide: float) -> float:
    """Kalman update by the readings y (3,) that there are, robust; log likelihood of them.

    Readings are normal with `noise` K, or, rarely, `wide` of what they should be: then they say
    little. x, p in place.
    """
    count = 0
    rows = np.empty(POINTS, dtype=np.int64)
    for q in range(POINTS):
        if math.isfinite(y[q]):
            rows[count] = q
            count += 1
    if count == 0:
        return 0.0
    seen = np.zeros((count, STATES))
    error = np.empty(count)
    for i in range(count):
        q = rows[i]
        seen[i, SEEN[q]] = 1.0
        if g == 1 + HEATS + q:
            seen[i, SIZE] = 1.0
        error[i] = y[q] - seen[i] @ x
    gain_t = seen @ p
    inner = gain_t @ seen.T + noise * noise * np.eye(count)
    inverse = np.linalg.inv(inner)
    normal = float(-0.5 * (error @ (inverse @ error))) - 0.5 * math.log(np.linalg.det(inner))
    loose = inner + wide * wide * np.eye(count)
    outlying = float(-0.5 * (error @ np.linalg.solve(loose, error)))
    outlying -= 0.5 * math.log(np.linalg.det(loose))
    normal += math.log(1.0 - _OUTLYING)
    outlying += math.log(_OUTLYING)
    top = max(normal, outlying)
    says = top + math.log(math.exp(normal - top) + math.exp(outlying - top))
    believed = math.exp(normal - says)
    gain = gain_t.T @ inverse
    moved = gain @ error
    x += believed * moved
    # Of the mixture of the two outcomes.
    p -= believed * (gain @ gain_t)
    p += believed * (1.0 - believed) * np.outer(moved, moved)
    p[:] = 0.5 * (p + p.T)
    return says


def _warmer(x: Array, p: Array) -> float:
    """Log probability that the size is above 0."""
    below = -x[SIZE] / math.sqrt(2.0 * max(p[SIZE, SIZE], 1e-9))
    return math.log(max(0.5 * math.erfc(below), _LEAST))


def advance(
    mode: Array, mean: Array, cov: Array, y: Array, rates: Array, pushes: Array, heats: Array,
    rise: float, dt: float, sigma: Array, odds: Array, sizes: Array, noise: float, held: bool,
) -> float:  # fmt: skip
    """One block of one motor; mode (G,), mean (G, 12), cov (G, 12, 12) in place.

    y (3,) K from its peers, NaN without; rates (5, 5) 1/s; pushes (5, 5) K/s of the lumps per
    disturbance; heats (5, 5) K/s per kind of fault (rows) and K of size; rise: frame above the air,
    K; dt: s since the last block; sigma (5,) of the disturbances; odds: begin and end per s, memory
    of disturbances s, unsure share, size's walk K and share per block, K of a lump's own noise per
    root of a minute, wide K, unsteady share, a sensor's walk K per block; sizes (G, 4): see
    `MEAN`; held: a fault is being told. Gives the log likelihood.
    """
    modes = len(mode)
    weight = np.empty(modes)
    before, spread = np.empty_like(mean), np.empty_like(cov)
    # While a fault is told no other begins: one that did would write over an explanation that is
    # less likely as yet, and what the fault really is would be forgotten.
    begin = 0.0 if held else odds[0] * dt
    _mix(mode, mean, cov, begin, odds[1] * dt, sizes, weight, before, spread)
    fade, gain = np.empty((LUMPS, LUMPS)), np.empty((LUMPS, LUMPS))
    _response(rates, dt, fade, gain)
    keep = math.exp(-dt / odds[2])
    step = np.zeros((STATES, STATES))
    step[:LUMPS, :LUMPS] = fade
    step[:LUMPS, LUMPS:SIZE] = gain @ pushes * math.sqrt(keep)
    for i in range(LUMPS, SIZE):
        step[i, i] = keep
    step[SIZE, SIZE], step[SIZE, RATE], step[RATE, RATE] = 1.0, dt, keep
    says = np.empty(modes)
    for g in range(modes):
        x = before[g]
        heat = 0 < g <= HEATS
        step[:LUMPS, SIZE] = 0.0
        if heat:
            more = max(1.0 + x[2] / rise, 0.2) if g == COOLING else 1.0
            step[:LUMPS, SIZE] = gain @ heats[g - 1] * more
        p = step @ spread[g] @ step.T
        for i in range(LUMPS):
            p[i, i] += odds[6] ** 2 * dt / 60.0 + (odds[3] * (1.0 - fade[i, i]) * x[i]) ** 2
            p[LUMPS + i, LUMPS + i] += sigma[i] ** 2 * (1.0 - keep * keep)
        if heat:
            # A fault begins anywhere in a block, and no heat is as steady as a number.
            heated = step[:LUMPS, SIZE] * x[SIZE]
            p[:LUMPS, :LUMPS] += odds[8] ** 2 * np.outer(heated, heated)
        if g > 0:
            walk = odds[4] if heat else odds[9]
            p[SIZE, SIZE] += walk**2 + (odds[5] * x[SIZE]) ** 2
            p[RATE, RATE] += sizes[g, CREEP] ** 2 * (1.0 - keep * keep)
        mean[g] = step @ x
        cov[g] = p
        before_it = _warmer(mean[g], cov[g]) if heat else 0.0
        says[g] = _update(mean[g], cov[g], g, y, noise, odds[7])
        if heat:
            # No fault cools: of a normal size only what is above 0 explains anything.
            says[g] += _warmer(mean[g], cov[g]) - before_it
    top = says.max()
    total = 0.0
    for g in range(modes):
        mode[g] = max(weight[g] * math.exp(says[g] - top), _LEAST)
        total += mode[g]
    mode /= total
    return float(top + math.log(total))


def _warm(x: Array, p: Array, shown: float) -> float:
    """Probability that the reading that shows most is `shown` K too warm."""
    most = 0.0
    for i in SEEN:
        scale = math.sqrt(2.0 * max(p[i, i], 1e-9))
        most = max(most, 0.5 * math.erfc((shown - x[i]) / scale))
    return most


def tell(mode: Array, mean: Array, cov: Array, limits: Array, shown: float, kind: Array) -> float:
    """Fill kind (8,): probability of every kind with a size beyond its limit; the likely size K.

    shown: K that heat has to have made of some reading by now.
    """
    total, size = 0.0, 0.0
    for g in range(1, len(mode)):
        scale = math.sqrt(2.0 * max(cov[g, SIZE, SIZE], 1e-9))
        here = 0.5 * math.erfc((limits[g - 1] - mean[g, SIZE]) / scale)
        if g > HEATS:
            here += 0.5 * math.erfc((limits[g - 1] + mean[g, SIZE]) / scale)
        else:
            here = min(here, _warm(mean[g], cov[g], shown))
        kind[g - 1] = mode[g] * here
        total += kind[g - 1]
        size += kind[g - 1] * abs(mean[g, SIZE])
    return size / total if total > 1e-12 else 0.0
