"""Compiled forms of `reference` and `response`, whose functions are the NumPy twins.

A handful of drives every tick: the array forms spend their time in call overhead, 250 us a tick
for three drives against 20 us here. Memories are changed in place.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from estimators._lean import lean
from estimators.detect import reference, response

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_LEAST_COMMON = reference.LEAST_COMMON
_GATE_SQUARE = reference.GATE**2
_NOT_WHITE = reference.NOT_WHITE
_DRIFT = (reference.EVERY_S / reference.RATIO_TAU_S) ** 2
_SPREAD_GAIN = reference.EVERY_S / reference.SPREAD_TAU_S
_SPREAD_FLOOR = reference.SPREAD_FLOOR
_SPREAD_MOST = reference.SPREAD_MOST
_STEP_CLIP = reference.STEP_CLIP
_LOW, _HIGH = 1.0 - reference.RATIO_LIMIT, 1.0 + reference.RATIO_LIMIT
_THRESHOLD = response.THRESHOLD
_LEAST_COMMAND = response.LEAST_COMMAND
_OPEN = response.OPEN
_CLEAR = response.CLEAR
_LAG_S = response.LAG_S
_LARGE = response.LARGE
_SUDDEN_S = response.SUDDEN_S
_FREED = response.FREED
_FOR_GOOD_S = response.FOR_GOOD_S
_STEADY = response.STEADY
_CERTAINLY_GOOD = response.CERTAINLY_GOOD
_VETOED = response.VETOED
_SURE = response.SURE
_SQRT_HALF = 1.0 / math.sqrt(2.0)


@lean
def refer(
    memory: reference.Reference, load: Array, share: Array, passing: float, out: Array,
    spread: Array,
) -> None:  # fmt: skip
    """Loads as if the drives were equal and fully commanded, out (N,), and their spread (N,).

    `Reference.referred` and `sigma` over `share`; passing: relative, of what is not learnt.
    """
    for i in range(load.shape[0]):
        x = load[i]
        out[i] = x / memory.ratio[i] / share[i]
        square = memory.spread * memory.spread + (memory.variance[i] + passing * passing) * x * x
        spread[i] = math.sqrt(square) / share[i]


@lean
def severely(
    common: float, heard: response.Heard, referred: Array, spread: Array, known: Flags,
    part: float, spreads: float, out: Flags,
) -> None:  # fmt: skip
    """Drives that miss more than `part`, and `spreads`, of what the others carry; fills out (N,).

    With nobody to compare with (`common` 0) of their own command.
    """
    for i in range(out.shape[0]):
        wanted = common if common != 0.0 else heard.command[i]
        carried = referred[i] if common != 0.0 else heard.load[i]
        missing = wanted - carried if wanted > 0.0 else carried - wanted
        least = max(part * abs(wanted), spreads * spread[i])
        out[i] = known[i] and wanted != 0.0 and missing > least


@lean
def watch(
    memory: reference.Reference, load: Array, common: Array, known: Flags, relative: bool
) -> float:
    """`reference.watch`; changes residual and seen, gives the new spread."""
    ratio, residual, seen = memory.ratio, memory.residual, memory.seen
    spread, configured = memory.spread, memory.configured
    most = _STEP_CLIP * spread
    total = 0.0
    n = 0
    for i in range(load.shape[0]):
        if not known[i]:
            continue
        now = load[i] / ratio[i] - common[i]
        if seen[i]:
            step = min(max(now - residual[i], -most), most)
            total += step * step
            n += 1
        residual[i] = now
        seen[i] = True
    fewest = 1 if relative else 0
    if n <= fewest:
        return spread
    square = spread * spread
    square += _SPREAD_GAIN * (0.5 * total / (n - fewest) - square)
    return min(max(math.sqrt(square), _SPREAD_FLOOR * configured), _SPREAD_MOST * configured)


@lean
def _taught_by(load: float, m: float, ratio: float, variance: float, noise: float) -> bool:
    """Whether the observation of a healthy drive says something about its ratio."""
    beside = load - ratio * m
    return abs(m) >= _LEAST_COMMON and beside * beside <= _GATE_SQUARE * (variance * m * m + noise)


@lean
def learn(
    memory: reference.Reference, load: Array, common: Array, healthy: Flags, relative: bool,
    teaches: Flags,
) -> None:  # fmt: skip
    """`reference.learn`; changes ratio and variance; teaches: (N,), room."""
    ratio, variance = memory.ratio, memory.variance
    noise = _NOT_WHITE * memory.spread * memory.spread
    n = 0
    for i in range(load.shape[0]):
        fits = _taught_by(load[i], common[i], ratio[i], variance[i], noise)
        teaches[i] = healthy[i] and fits
        n += 1 if teaches[i] else 0
    if n < (2 if relative else 1):
        return
    total = 0.0
    for i in range(load.shape[0]):
        m = common[i]
        if not teaches[i]:
            continue
        # |m| is at least LEAST_COMMON here, which the twin has to ask for.
        before = variance[i] + noise / (m * m) * _DRIFT
        gain = before * m / (before * m * m + noise)
        ratio[i] += gain * (load[i] - ratio[i] * m)
        variance[i] = (1.0 - gain * m) * before
        total += ratio[i]
    for i in range(load.shape[0]):
        if relative and teaches[i]:
            ratio[i] *= n / total
        ratio[i] = min(max(ratio[i], _LOW), _HIGH)


@lean
def respond(
    memory: response.Memory, heard: response.Heard, dt: float, lost: Array, meant: Flags
) -> None:
    """`response.respond`; changes since_s, fills lost and meant (N,)."""
    healthy = memory.reference
    for i in range(heard.load.shape[0]):
        command, before = heard.command[i], heard.before[i]
        ahead = 2.0 * command - before
        low = min(command, before, ahead)
        high = max(command, before, ahead)
        least = min(abs(command), abs(before), abs(ahead)) if low > 0.0 or high < 0.0 else 0.0
        x = heard.load[i]
        p = 0.0
        sign = 1.0 if command > 0.0 else -1.0
        if least >= _LEAST_COMMAND and heard.usable[i]:
            missing = least * (1.0 - _THRESHOLD) - sign * x / healthy.ratio[i]
            sigma = math.sqrt(healthy.spread * healthy.spread + healthy.variance[i] * x * x)
            p = 0.5 * math.erfc(-missing / sigma * _SQRT_HALF)
        gone = least - sign * x
        freed = gone >= _LARGE * least and sign * heard.excess[i] >= _FREED * gone
        freed = freed and memory.since_s[i] <= _SUDDEN_S
        more = _FOR_GOOD_S if freed else dt
        memory.since_s[i] = memory.since_s[i] + more if p > _CLEAR else 0.0
        if p > _OPEN and not heard.age_s[i] + _LAG_S + dt <= memory.since_s[i]:
            p = _OPEN
        meant[i] = heard.usable[i] and least >= _LEAST_COMMAND
        lost[i] = p if meant[i] else _OPEN


@lean
def steady(heard: response.Heard, dt: float, out: Flags) -> bool:
    """Fills out (N,) with the drives whose load answers an unchanged command; any of them."""
    found = False
    for i in range(heard.load.shape[0]):
        near = _STEADY * max(abs(heard.command[i]), _LEAST_COMMAND)
        change = abs(heard.command[i] - heard.before[i])
        out[i] = heard.usable[i] and change <= near and heard.age_s[i] < dt
        found |= out[i]
    return found


@lean
def learn_response(
    memory: response.Memory, heard: response.Heard, healthy: Flags, dt: float, answer: Flags,
    teaches: Flags,
) -> float:  # fmt: skip
    """`response.learn`; changes the reference's arrays, gives its new spread.

    answer, teaches: (N,), room.
    """
    kept = memory.reference
    if not steady(heard, dt, answer):
        return kept.spread
    spread = watch(kept, heard.load, heard.command, answer, False)
    now = reference.Reference(
        kept.ratio, kept.variance, spread, kept.configured, kept.residual, kept.seen
    )
    for i in range(answer.shape[0]):
        answer[i] = answer[i] and healthy[i]
    learn(now, heard.load, heard.command, answer, False, teaches)
    return spread


@lean
def coasts(i: int, heard: response.Heard) -> bool:
    """`response.coasting` of drive i."""
    command, before = heard.command[i], heard.before[i]
    return bool(max(abs(command), abs(before), abs(2.0 * command - before)) < _LEAST_COMMAND)


@lean
def fuse(
    lost: Array, known: Flags, alone: Array, heard: response.Heard, away: Flags, meant: Flags,
    out: Array, told: Flags,
) -> None:  # fmt: skip
    """`response.fuse`; fills out and told (N,)."""
    for i in range(lost.shape[0]):
        both, asked = lost[i], heard.usable[i] and not coasts(i, heard)
        if meant[i]:
            outvoted = alone[i] < _CERTAINLY_GOOD and both <= _SURE
            both = max(min(both, _VETOED) if outvoted else both, alone[i])
        elif asked:
            both = max(both, alone[i]) if away[i] else min(both, _OPEN)
        out[i] = both if known[i] else alone[i]
        told[i] = known[i] or asked
