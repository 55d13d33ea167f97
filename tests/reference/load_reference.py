"""What each drive's load is while it adheres: learnt slowly, never during a loss.

Healthy drives differ for good (wheel diameter, axle load, a magnet off its data sheet): by a
ratio, because all of these scale with the load. Per drive a scalar Kalman filter learns it,

    x_i = rho_i m + e_i,    rho_i ~ N(1, RATIO_SIGMA^2) at the start,    e_i ~ N(0, s^2)

with m the load that adhering drives share; e is correlated over some 50 ms, so `learn` is called
once in `EVERY_S`. The spread s is learnt from what remains. Not in paper `adhesion`,
whose drives are equal and whose thresholds are constants.

NumPy forms, which `estimators/detect/load_reference.c` is compared with.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

RATIO_SIGMA: Final = 0.06
"""Drives differ by this much, standard deviation, before anything is known."""
RATIO_LIMIT: Final = 0.2
"""More than this is a loss, not a difference."""
RATIO_TAU_S: Final = 30.0
"""Time constant of learning in the long run: slow against any loss."""
EVERY_S: Final = 0.05
"""Errors of the load estimate are independent only this far apart."""
SPREAD_TAU_S: Final = 0.7
SPREAD_FLOOR: Final = 0.6
"""The spread is never believed to be less than this share of the configured one."""
SPREAD_MOST: Final = 8.0
STEP_CLIP: Final = 4.0
"""One step counts as at most this many spreads: the edge of a loss is not a wide spread."""
NOT_WHITE: Final = 2.0
"""Errors last longer than the spread says: an offset turns with the rotor."""
GATE: Final = 4.0
"""An observation that is off by more standard deviations does not belong to the model: a command
that had not been heard yet, say."""
LEAST_COMMON: Final = 0.1
"""Per unit of rated torque: below it nothing is said about ratios."""


class Reference(NamedTuple):
    """Memory for N drives, per unit of rated torque.

    ratio, variance (N,): estimate of rho and its variance; spread: s; configured: s at the start;
    residual (N,): of the last observation, where seen (N,).
    """

    ratio: Array
    variance: Array
    spread: float
    configured: float
    residual: Array
    seen: Flags

    def referred(self, load: Array) -> Array:
        """(N,) loads as if the drives were equal."""
        return load / self.ratio

    def sigma(self, load: Array) -> Array:
        """(N,) standard deviation of a healthy drive's referred load around the common one."""
        return np.sqrt(self.spread**2 + self.variance * load * load)


def start(n: int, spread: float) -> Reference:
    """Nothing learnt yet; `spread` per unit of rated torque."""
    return Reference(
        np.ones(n), np.full(n, RATIO_SIGMA**2), spread, spread,
        np.zeros(n), np.zeros(n, dtype=np.bool_),
    )  # fmt: skip


def watch(
    memory: Reference, load: Array, common: float | Array, known: Flags, *, relative: bool = True
) -> Reference:
    """Learn the spread from one observation, `EVERY_S` after the last; lost drives included.

    What changes from one observation to the next is noise: a loss has two edges and no more, and
    lasting differences cancel. So this needs no verdict, and no verdict can stop it. `relative`:
    `common` is the drives' own mean, which follows each of them by its share.
    """
    residual = load / memory.ratio - common
    both = known & memory.seen
    n = np.count_nonzero(both)
    spread = memory.spread
    if n > relative:
        most = STEP_CLIP * spread
        step = np.clip((residual - memory.residual)[both], -most, most)
        square = 0.5 * float(np.sum(step * step)) / (n - relative)
        square = spread**2 + EVERY_S / SPREAD_TAU_S * (square - spread**2)
        floor = SPREAD_FLOOR * memory.configured
        spread = min(max(float(np.sqrt(square)), floor), SPREAD_MOST * memory.configured)
    kept = np.where(known, residual, memory.residual)
    return memory._replace(spread=spread, residual=kept, seen=known | memory.seen)


def learn(
    memory: Reference, load: Array, common: float | Array, healthy: Flags, *, relative: bool = True
) -> Reference:
    """Learn ratios from one observation in which the `healthy` drives certainly adhere.

    load (N,) per unit; common: what `referred` loads share, one number or one for each drive. With
    less than `LEAST_COMMON`, or `relative` and fewer than two healthy drives: nothing is learnt.
    `relative`: common is the drives' own, so that only differences between them are observable.
    """
    common = np.broadcast_to(common, load.shape)
    noise = NOT_WHITE * memory.spread**2
    square = np.maximum(common * common, LEAST_COMMON**2)
    beside = load - memory.ratio * common
    fits = beside * beside <= GATE**2 * (memory.variance * square + noise)
    healthy = healthy & fits & (np.abs(common) >= LEAST_COMMON)
    if np.count_nonzero(healthy) < 1 + relative:
        return memory
    # In the long run the ratio may drift: the variance that keeps the filter at RATIO_TAU_S.
    drift = noise / square * (EVERY_S / RATIO_TAU_S) ** 2
    variance = memory.variance + np.where(healthy, drift, 0.0)
    gain = np.where(healthy, variance * common / (variance * square + noise), 0.0)
    ratio = memory.ratio + gain * beside
    variance = (1.0 - gain * common) * variance
    if relative:
        ratio[healthy] *= 1.0 / float(np.mean(ratio[healthy]))
    ratio = np.clip(ratio, 1.0 - RATIO_LIMIT, 1.0 + RATIO_LIMIT)
    return memory._replace(ratio=ratio, variance=variance)
