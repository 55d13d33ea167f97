"""Compiled side of `watch`: samples in, blocks of residuals out, motor by motor judged."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from estimators._lean import njit
from estimators.thermal import _models_kernels as models
from estimators.thermal import _steps_kernels as steps
from estimators.thermal._heat_kernels import REFERENCE as WARM
from estimators.thermal._heat_kernels import SLOPE, coupling, step
from estimators.thermal._hypotheses_kernels import references

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Ints = NDArray[np.int64]

POINTS, LUMPS, SEEN = models.POINTS, models.LUMPS, models.SEEN
SQUARE, SPEED, COOLING, COPPER, RISE, COUNT = range(6)
"""Sums of a motor's inputs over half a block: A^2, rad/s, K/s of frame and winding, K, samples."""
INPUTS = 6
NONE = np.zeros(LUMPS)
_FIRST_K = np.array([0.3, 5.0, 2.0, 0.3, 0.3])
"""How far lumps may be from what `begin` takes them for: core and frame are not seen."""
_COLDEST_RISE = 3.0
_MOST_SIGMA = 3.0
_RAISE, _HALF, _CLEAR = 0.9, 0.5, 0.3
_SUREST = 0.95
"""Of a loose connector: it has to be forgotten when it is mended."""


@njit(cache=True, error_model="numpy")
def begin(p: Array, reading: Array, speed: float, ambient: float, x: Array) -> bool:
    """Lumps x (5,) of a motor with readings (3,), NaN without. False: none at all.

    As `heat.begun`, and friction at this speed is taken off: the frame is as warm as the ends that
    are seen say, or half way from the winding to the air.
    """
    total, count = 0.0, 0
    for q in range(1, POINTS):
        if math.isfinite(reading[q]):
            k, f, b = (p[9], p[10], p[11]) if q == 1 else (p[12], p[13], p[14])
            own = reading[q] - p[15 + q]
            total += max(ambient + ((own - ambient) * (k + b) - f * speed) / k, min(ambient, own))
            count += 1
    winding = reading[0] - p[15]
    if count == 0 and not math.isfinite(winding):
        return False
    frame = total / count if count else 0.5 * (winding + ambient)
    x[0] = winding if math.isfinite(winding) else frame
    x[1], x[2] = 0.5 * (x[0] + frame), frame
    for q in range(1, POINTS):
        k, f, b = (p[9], p[10], p[11]) if q == 1 else (p[12], p[13], p[14])
        settled = ambient + (k * (frame - ambient) + f * speed) / (k + b)
        x[SEEN[q]] = reading[q] - p[15 + q] if math.isfinite(reading[q]) else settled
    return True


@njit(cache=True, error_model="numpy")
def forget(mode: Array, mean: Array, cov: Array, sigma: Array, sizes: Array) -> None:
    """Filters of a motor that has just begun: nothing is wrong, little is known."""
    mode[:], mean[:], cov[:] = 1e-30, 0.0, 0.0
    mode[0] = 1.0
    for g in range(len(mode)):
        for i in range(LUMPS):
            cov[g, i, i] = _FIRST_K[i] ** 2
            cov[g, LUMPS + i, LUMPS + i] = sigma[i] ** 2
        mean[g, models.SIZE] = sizes[g, models.MEAN]
        cov[g, models.SIZE, models.SIZE] = sizes[g, models.SPREAD] ** 2
        cov[g, models.RATE, models.RATE] = sizes[g, models.CREEP] ** 2


@njit(cache=True, error_model="numpy")
def clear(
    m: int, sigma: Array, sizes: Array, ring: Array, jumps: Array, block: Array, raw: Array,
    sums: Array, mode: Array, mean: Array, cov: Array, base: Array, burst: Array, loose: Array,
    kind: Array,
) -> None:  # fmt: skip
    """Motor m begins anew."""
    forget(mode[m], mean[m], cov[m], sigma, sizes)
    ring[m], block[m], raw[m] = math.nan, math.nan, math.nan
    base[m], loose[m], kind[m] = 0.0, 0.0, 0.0
    burst[m, :, 0], burst[m, :, 1] = math.nan, 0.0
    sums[:, m] = 0.0
    for q in range(POINTS):
        steps.start(jumps[m, q])


@njit(cache=True, error_model="numpy")
def _sample(
    p: Array, reading: Array, square: float, speed: float, ambient: float, dt: float, centre: Array,
    x: Array, sums: Array, ring: Array, jumps: Array, block: Array, raw: Array, at: int,
    counts: Ints, how: Array,
) -> None:  # fmt: skip
    """One sample of one motor that has begun, dt s since the last; see `samples`."""
    step(p, square, speed, ambient, NONE, dt, x)
    rise = max(x[2] - ambient, _COLDEST_RISE)
    sums[SQUARE] += square
    sums[SPEED] += speed
    sums[COOLING] += (p[7] + p[8] * speed) * rise
    sums[COPPER] += p[0] * square * (1.0 + SLOPE * (x[0] - WARM))
    sums[RISE] += rise
    sums[COUNT] += 1.0
    for q in range(POINTS):
        residual = reading[q] - x[SEEN[q]] - p[15 + q] - centre[q]
        raw[q, at] = residual
        if how[0] > 0.0:
            for i in range(ring.shape[1] - 1):
                ring[q, i] = ring[q, i + 1]
            ring[q, -1] = residual
            steps.one(ring[q], jumps[q], counts[0], counts[1], how[0], how[1], how[2])
        settled = jumps[q, steps.SINCE] < 0.0
        block[q, at] = residual - jumps[q, steps.OFF] if settled else math.nan


@njit(cache=True, error_model="numpy")
def samples(
    parameters: Array, centre: Array, reading: Array, square: Array, speed: Array, ambient: Array,
    dt: float, hole_s: float, begun: Flags, unknown_s: Array, lumps: Array, half: Array,
    ring: Array, jumps: Array, block: Array, raw: Array, at: int, counts: Ints, how: Array,
    lost: Flags,
) -> None:  # fmt: skip
    """One sample of all motors; `lost` (M,) is set where a motor has to begin anew.

    parameters (M, 18); reading, centre (M, 3); square, speed, ambient, unknown_s (M,); lumps
    (M, 5); half (M, 6): sums of inputs; ring (M, 3, before + after + settled) newest last; jumps
    (M, 3, 5) states of `steps`; block, raw (M, 3, B): residuals less steps, and with; at: which of
    the block; counts: before, after; how: step, back, follows K, step 0 for no test.
    """
    for m in range(len(begun)):
        known = math.isfinite(square[m]) and math.isfinite(speed[m]) and math.isfinite(ambient[m])
        # The motor has gone on in a hole, as likely as not as it does behind it.
        since = dt + unknown_s[m]
        unknown_s[m] = 0.0 if known else unknown_s[m] + dt
        lost[m] = begun[m] and unknown_s[m] > hole_s
        block[m, :, at], raw[m, :, at] = math.nan, math.nan
        if known and not begun[m]:
            begun[m] = begin(parameters[m], reading[m], speed[m], ambient[m], lumps[m])
            since = dt
        if known and begun[m]:
            _sample(
                parameters[m], reading[m], square[m], speed[m], ambient[m], since, centre[m],
                lumps[m], half[m], ring[m], jumps[m], block[m], raw[m], at, counts, how,
            )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _middle(values: Array, store: Array) -> tuple[float, int]:
    """Median of the numbers in values, NaN of less than a third; how many, first in store."""
    n = 0
    for value in values:
        if math.isfinite(value):
            store[n] = value
            n += 1
    return (float(np.median(store[:n])) if 3 * n >= len(values) else math.nan), n


@njit(cache=True, error_model="numpy")
def _bursts(x: Array, count: int, middle: float, far: float, burst: Array) -> tuple[int, int]:
    """Readings x[:count] of a block that are in bursts, and those that are not.

    Far readings at an edge of the block are those of a burst only if the sensor comes back: the
    next block, or the last one, is where this one is. burst (2,): median of the last block, far
    readings at its end; brought up to date.
    """
    first = last = inner = 0
    for k in range(count):
        if abs(x[k] - middle) <= far:
            inner += last
            last = 0
        elif k == first:
            first += 1
        else:
            last += 1
    odd = inner
    if abs(middle - burst[0]) < 0.5 * far:
        odd += first + int(burst[1])
    burst[0], burst[1] = middle, float(last)
    return odd, count - first - inner - last


@njit(cache=True, error_model="numpy")
def close(
    block: Array, raw: Array, noise: Array, bursts: Array, base: Array, held: Flags, burst: Array,
    odds: Array, middle: Array, off: Array, before: Flags, shift: Array,
) -> None:  # fmt: skip
    """Blocks of all motors: medians middle, off from the trusted others', odds, (M, 3) each.

    before (M,): who was trusted in the last block, brought up to date; shift (M, 3): what that
    makes the others' median move by. odds: log odds that bursts speak for a loose connector, NaN
    without readings. bursts: share of a loose and of a good connector's readings, standard
    deviations that are far, readings of a burst, K that are not far yet; burst (M, 3, 2): see
    `_bursts`.
    """
    motors, _, together = block.shape
    store = np.empty(together)
    trusted = np.empty(motors, dtype=np.bool_)
    for m in range(motors):
        trusted[m] = not held[m]
        for q in range(POINTS):
            middle[m, q], _ = _middle(block[m, q], store)
            here, n = _middle(raw[m, q], store)
            far = max(bursts[2] * noise[m, q], bursts[4])
            odd, good = _bursts(store, n, here, far, burst[m, q])
            odds[m, q] = odd * math.log(bursts[0] / bursts[1])
            odds[m, q] += good * math.log((1.0 - bursts[0]) / (1.0 - bursts[1]))
            odds[m, q] = odds[m, q] / bursts[3] if n else math.nan
    u = middle - base
    references(u, before, shift)
    references(u, trusted, off)
    for m in range(motors):
        for q in range(POINTS):
            shift[m, q] = off[m, q] - shift[m, q]
            shift[m, q] = shift[m, q] if math.isfinite(shift[m, q]) else 0.0
            off[m, q] = u[m, q] - off[m, q]
    before[:] = trusted


@njit(cache=True, error_model="numpy")
def directions(p: Array, inputs: Array, unit: Array, rates: Array, pushes: Array, heats: Array
               ) -> float:  # fmt: skip
    """What the mean inputs of a block make of disturbances and faults; returns the frame's rise K.

    inputs (6,) sums; unit (7,): of the calibration's mean duty, speed, cooling and heating K/s, and
    K that 1 K/s into winding, frame, ends settle at, where it is seen most; rates, pushes, heats
    (5, 5) are filled, see `models.advance`.
    """
    n = max(inputs[COUNT], 1.0)
    square, speed, cooling = inputs[SQUARE] / n, inputs[SPEED] / n, inputs[COOLING] / n
    # A block that lies in a short hole has no inputs at all.
    copper, rise = inputs[COPPER] / n, max(inputs[RISE] / n, _COLDEST_RISE)
    coupling(p, square, speed, rates)
    # Copper, local air, fan, friction of both ends.
    pushes[:] = 0.0
    pushes[0, 0] = copper
    pushes[2, 1], pushes[3, 1], pushes[4, 1] = p[7] + p[8] * speed, p[11], p[14]
    pushes[2, 2] = cooling
    pushes[3, 3], pushes[4, 4] = p[10] * speed, p[13] * speed
    heats[:] = 0.0
    heats[0, 0] = 1.0 / unit[3]
    heats[1, 2] = cooling / unit[1] / unit[4]
    heats[2, 3] = speed / unit[0] / unit[5]
    heats[3, 4] = speed / unit[0] / unit[6]
    heats[4, 0] = copper / unit[2] / unit[3]
    return float(rise)


@njit(cache=True, error_model="numpy")
def judge(
    p: Array, inputs: Array, unit: Array, off: Array, bursts: Array, dt: float, sigma: Array,
    odds: Array, sizes: Array, noise: float, limits: Array, shown: float, loose_odds: Array,
    mode: Array, mean: Array, cov: Array, base: Array, loose: Array, kind: Array, held: bool,
) -> tuple[float, float, float, bool]:  # fmt: skip
    """One block of one motor through its filters.

    Likely size K, log likelihood, how probably it is ill, whether it is held to be: from when that
    is surer than `_RAISE` until it is less so than `_CLEAR`.

    off, bursts (3,): see `close`; limits (8,), shown: see `models.tell`; loose_odds: begin, end per
    s, 1/s of the baseline's learning; mode .. kind: the motor's state, in place; kind (11,).
    """
    rates, pushes = np.empty((LUMPS, LUMPS)), np.empty((LUMPS, LUMPS))
    heats = np.empty((models.HEATS, LUMPS))
    rise = directions(p, inputs, unit, rates, pushes, heats)
    says = models.advance(
        mode, mean, cov, off, rates, pushes, heats, rise, dt, sigma, odds, sizes, noise, held
    )
    size = models.tell(mode, mean, cov, limits, shown, kind[: models.MODES - 1])
    for q in range(POINTS):
        kind[models.MODES - 1 + q] = loose[q]
        if math.isnan(bursts[q]):
            # No readings: what was believed of the connector stands.
            continue
        here = loose[q] * (1.0 - loose_odds[1] * dt) + (1.0 - loose[q]) * loose_odds[0] * dt
        ratio = here / (1.0 - here) * math.exp(min(max(bursts[q], -50.0), 50.0))
        loose[q] = min(ratio / (1.0 + ratio), _SUREST)
        kind[models.MODES - 1 + q] = loose[q]
    total = kind.sum()
    if total > 1.0:
        kind /= total
        total = 1.0
    ill = total
    held = total > (_CLEAR if held else _RAISE)
    shown = max(total, _HALF + 0.01) if held else min(total, _HALF - 0.01)
    if total > 0.0:
        kind *= shown / total
    for q in range(POINTS):
        if math.isfinite(off[q]):
            most = _MOST_SIGMA * 0.3
            base[q] += loose_odds[2] * dt * (1.0 - total) * min(max(off[q], -most), most)
    return size, says, ill, held


@njit(cache=True, error_model="numpy")
def likely(
    parameters: Array, inputs: Array, unit: Array, off: Array, dt: float, sigma: Array, odds: Array,
    sizes: Array, noise: Array,
) -> float:  # fmt: skip
    """Log likelihood of fault-free blocks off (B, M, 3) with inputs (B, M, 6), faults left out."""
    rates, pushes = np.empty((LUMPS, LUMPS)), np.empty((LUMPS, LUMPS))
    heats = np.empty((models.HEATS, LUMPS))
    mode, mean = np.empty(1), np.empty((1, models.STATES))
    cov = np.empty((1, models.STATES, models.STATES))
    alone = odds.copy()
    alone[0] = 0.0
    total = 0.0
    for m in range(off.shape[1]):
        forget(mode, mean, cov, sigma, sizes)
        for k in range(off.shape[0]):
            rise = directions(parameters[m], inputs[k, m], unit, rates, pushes, heats)
            says = models.advance(
                mode, mean, cov, off[k, m], rates, pushes, heats, rise, dt, sigma, alone, sizes,
                noise[m], False,
            )  # fmt: skip
            total += says if k > 0 else 0.0
    return total
