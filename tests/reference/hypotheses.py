"""Hypotheses in NumPy, which `hypotheses.c` and `peers.c` are compared with."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_HEAT = 5
_POINTS = 3
_HELD = 0.6
_LEAST = 1.5
"""Hysteresis of the size that is a fault, and K below which it does not reach."""

_TWO_APART_K = 3.0
"""Half of it is as much as passes for dirt and wear of a sensor (`hypotheses.BENIGN_K`)."""
_UNSURE = 0.15
"""Share by which a signature may be off: sizes are tried in steps of 1.4, and models err."""


def _tails(x: float, nu: float) -> float:
    """Log density of Student's t up to a constant, unit scale."""
    return -0.5 * (nu + 1.0) * math.log1p(x * x / nu)


def _unsure(x: float, mean: float, nu: float) -> float:
    """The same around a mean that is known to `_UNSURE` of itself."""
    scale = math.sqrt(1.0 + (_UNSURE * mean) ** 2)
    return _tails((x - mean) / scale, nu) - math.log(scale)


def _whitened(
    z: Array, white: Array, share: Array, shapes: Array, sizes: Array, nu: float, out: Array
) -> None:
    """Log likelihoods of one whole sample z (3,) under nothing, kinds of heat, sensors off."""
    count = sizes.shape[0]
    w = white @ z
    none = 0.0
    for c in range(_POINTS):
        none += share[c] * _tails(w[c], nu)
    out[0] = none
    n = 1
    for g in range(_HEAT + 2 * _POINTS):
        # What the sample would be for a size of 1 K.
        unit = np.zeros(_POINTS)
        for c in range(_POINTS):
            if g < _HEAT:
                for p in range(_POINTS):
                    unit[c] += white[c, p] * shapes[g, p]
            else:
                sign = 1.0 if (g - _HEAT) % 2 == 0 else -1.0
                unit[c] = sign * white[c, (g - _HEAT) // 2]
        for s in range(count):
            total = 0.0
            for c in range(_POINTS):
                total += share[c] * _unsure(w[c], unit[c] * sizes[s], nu)
            out[n] = total
            n += 1


def _marginal(
    z: Array, sigma: Array, share: Array, shapes: Array, sizes: Array, nu: float, out: Array
) -> None:
    """The same from the points that there are, each by itself; the others are NaN."""
    count = sizes.shape[0]
    least = share.min()
    out[:] = 0.0
    for p in range(_POINTS):
        if not math.isfinite(z[p]):
            continue
        out[0] += least * _tails(z[p] / sigma[p], nu)
        n = 1
        for g in range(_HEAT + 2 * _POINTS):
            own = (g - _HEAT) // 2 == p
            unit = shapes[g, p] if g < _HEAT else (1.0 - 2.0 * ((g - _HEAT) % 2)) * own
            for s in range(count):
                out[n] += least * _unsure(z[p] / sigma[p], unit * sizes[s] / sigma[p], nu)
                n += 1


def _own(z: Array, white: Array, q: int) -> tuple[float, float]:
    """Point q's deviation from what the other two make likely, and its standard deviation."""
    total, precision = 0.0, 0.0
    for c in range(_POINTS):
        row = 0.0
        for p in range(_POINTS):
            row += white[c, p] * z[p]
        total += white[c, q] * row
        precision += white[c, q] * white[c, q]
    return total / precision, 1.0 / math.sqrt(precision)


def _loose(z: float, sigma: float, nu: float, share: float, most_k: float) -> float:
    """Log likelihood ratio of a loose connector's reading to a good one; readings count in full."""
    if not math.isfinite(z):
        return 0.0
    constant = math.lgamma(0.5 * (nu + 1.0)) - math.lgamma(0.5 * nu) - 0.5 * math.log(nu * math.pi)
    good = math.exp(_tails(z / sigma, nu) + constant) / sigma
    return math.log((1.0 - share) * good + share / (2.0 * most_k)) - math.log(max(good, 1e-300))


def _kind_of(g: int) -> int:
    """A sensor's two signs are one kind."""
    return g if g < _HEAT else _HEAT + (g - _HEAT) // 2


def _faulty(g: int, size: float, limit: float) -> bool:
    """A motor that is cooler than the model has no fault; a sensor's error has either sign."""
    return size >= limit or (g >= _HEAT and -size >= limit)


def _move(now: Array, sizes: Array, benign: Array, rates: Array, out: Array) -> None:
    """One step of the Markov chain: (S,) probabilities before, after."""
    begin, end, growth, often = rates[0], rates[1], rates[2], rates[6]
    count = sizes.shape[0]
    groups = _HEAT + 2 * _POINTS
    out[0] = now[0] * (1.0 - begin - often) + (1.0 - now[0]) * end
    for g in range(groups):
        limit = benign[_kind_of(g)]
        faults = 0
        for s in range(count):
            faults += 1 if _faulty(g, sizes[s], limit) else 0
        share = now[0] / (_HEAT + _POINTS) * (1.0 if g < _HEAT else 0.5)
        first = 1 + g * count
        for s in range(count):
            stay = now[first + s]
            moved = stay * (1.0 - 2.0 * growth)
            moved += growth * (now[first + s - 1] if s > 0 else stay)
            moved += growth * (now[first + s + 1] if s + 1 < count else stay)
            ill = _faulty(g, sizes[s], limit)
            enter = begin / faults if ill else often / (count - faults)
            out[first + s] = (1.0 - end) * moved + share * enter
    for q in range(_POINTS):
        n = 1 + groups * count + q
        # Between two bursts nothing is wrong to be seen: that must not last.
        out[n] = (1.0 - rates[8]) * now[n] + now[0] * begin / (_HEAT + _POINTS)
        out[0] += (rates[8] - end) * now[n]


def references(u: Array, trusted: Flags, out: Array) -> None:
    """Fill out (M, 3): per motor and point the median of u (M, 3) over the other motors.

    Of those that are `trusted` (M,), of all where too few are (fewer than three, but of three
    motors fewer than two); 0 for a train of one motor, NaN where fewer than two others (of two
    motors, or beside one suspect of three: one) have a reading.

    Three motors, all trusted, two of them far apart: one is ill, and the mean of the two would make
    a healthy third ill the other way round. Believed is who is nearer to the model.
    """
    motors = u.shape[0]
    least = min(2, motors - 1)
    values = np.empty(motors)
    inside = np.empty(motors, dtype=np.bool_)
    for q in range(u.shape[1]):
        n, seen = 0, 0
        for m in range(motors):
            finite = math.isfinite(u[m, q])
            seen += finite
            n += finite and trusted[m]
        # Of three motors two are left beside a suspect: each has the other.
        three = n == least and seen == least + 1
        everybody = (n <= least < seen and not three) or n < least
        needed = 1 if three else least
        n = 0
        for m in range(motors):
            inside[m] = math.isfinite(u[m, q]) and (everybody or trusted[m])
            if inside[m]:
                values[n] = u[m, q]
                n += 1
        ranked = np.sort(values[:n])
        for m in range(motors):
            others = n - inside[m]
            if motors == 1:
                out[m, q] = 0.0
            elif others < needed:
                out[m, q] = math.nan
            else:
                left_out = np.searchsorted(ranked, u[m, q]) if inside[m] else n
                low, high = (others - 1) // 2, others // 2
                low += low >= left_out
                high += high >= left_out
                below, above = ranked[low], ranked[high]
                out[m, q] = 0.5 * (below + above)
                if motors == 3 and others == 2 and above - below > _TWO_APART_K:
                    out[m, q] = above if abs(above) < abs(below) else below


def sweep(
    z: Array, sigma: Array, white: Array, share: Array, shapes: Array, sizes: Array,
    benign: Array, rates: Array, kind: Array, size: Array, rise: Array,
) -> None:  # fmt: skip
    """All samples of all motors; fills kind (K, M, 11), size and rise (K, M): see `_mean_sizes`.

    z (K, M, 3) K, less the centre; sigma, white, share: as in `hypotheses.Spread`; shapes
    (K, 5, 3); sizes (S,); benign (8,): of heat and sensors, the least size that is a fault; rates:
    begin, end, growth, tail, loose share, loose K, often, learning, end of a loose connector.
    """
    motors, count = z.shape[1], sizes.shape[0]
    states = 1 + (_HEAT + 2 * _POINTS) * count + _POINTS
    p = np.zeros((motors, states))
    p[:, 0] = 1.0
    baseline, beside = np.zeros((motors, _POINTS)), np.empty((motors, _POINTS))
    held, trusted = np.full(motors, -1), np.ones(motors, dtype=np.bool_)
    for k in range(z.shape[0]):
        u = z[k] - baseline
        references(u, trusted, beside)
        for m in range(motors):
            off = u[m] - beside[m]
            _judge(
                p[m], off, sigma[m], white[m], share[m], shapes[k], sizes, benign,
                rates, held[m], kind[k, m],
            )  # fmt: skip
            size[k, m], rise[k, m] = _mean_sizes(p[m], sizes)
            likeliest = int(kind[k, m].argmax())
            held[m] = likeliest if kind[k, m, likeliest] > 0.5 else -1
            healthy = 1.0 - kind[k, m].sum()
            trusted[m] = healthy > 0.5
            # Between its bursts a loose connector reads as a good one does: not learnt meanwhile,
            # wear and dirt would pass for heat afterwards.
            calm = 1.0 - kind[k, m, : _HEAT + _POINTS].sum()
            for q in range(_POINTS):
                if math.isfinite(off[q]):
                    most = 3.0 * sigma[m, q]
                    baseline[m, q] += rates[7] * calm * min(max(off[q], -most), most)


def _judge(
    p: Array, off: Array, sigma: Array, white: Array, share: Array, shapes: Array,
    sizes: Array, benign: Array, rates: Array, held: int, kind: Array,
) -> None:  # fmt: skip
    """One sample of one motor, off (3,) K from its peers: its states p and kinds, in place."""
    states, loose = p.shape[0], p.shape[0] - _POINTS
    moved, says = np.empty(states), np.empty(states)
    nu = rates[3]
    _move(p, sizes, benign, rates, moved)
    whole = math.isfinite(off[0]) and math.isfinite(off[1]) and math.isfinite(off[2])
    if whole:
        _whitened(off, white, share, shapes, sizes, nu, says[:loose])
    else:
        _marginal(off, sigma, share, shapes, sizes, nu, says[:loose])
    for q in range(_POINTS):
        own, spread = _own(off, white, q) if whole else (off[q], sigma[q])
        says[loose + q] = says[0] + _loose(own, spread, nu, rates[4], rates[5])
    best = says.max()
    total = 0.0
    for n in range(states):
        p[n] = moved[n] * math.exp(says[n] - best)
        total += p[n]
    for n in range(states):
        p[n] /= total
    _tell(p, sizes, benign, held, kind)


def _tell(p: Array, sizes: Array, benign: Array, held: int, kind: Array) -> None:
    """Probabilities of the kinds, benign sizes left out: heat, sensors, loose connectors.

    Of a kind that has been `held` for a fault (-1 none), lesser sizes belong to it as well.
    """
    count = sizes.shape[0]
    kind[:] = 0.0
    for g in range(_HEAT + 2 * _POINTS):
        c = _kind_of(g)
        limit = max(_HELD * benign[c], _LEAST) if c == held else benign[c]
        for s in range(count):
            if _faulty(g, sizes[s], limit):
                kind[c] += p[1 + g * count + s]
    for q in range(_POINTS):
        kind[_HEAT + _POINTS + q] = p[1 + (_HEAT + 2 * _POINTS) * count + q]


def _mean_sizes(p: Array, sizes: Array) -> tuple[float, float]:
    """K: of the faults that have a size, without sign; of sensors alone, + where they read high.

    0 without any.
    """
    count = sizes.shape[0]
    weight, total, sensors, rise = 0.0, 0.0, 0.0, 0.0
    for g in range(_HEAT + 2 * _POINTS):
        sign = 1.0 if (g - _HEAT) % 2 == 0 else -1.0
        for s in range(count):
            q = p[1 + g * count + s]
            weight += q
            total += q * (sizes[s] if g < _HEAT else abs(sizes[s]))
            if g >= _HEAT:
                sensors += q
                rise += q * sign * sizes[s]
    size = total / weight if weight > 1e-12 else 0.0
    return size, rise / sensors if sensors > 1e-12 else 0.0
