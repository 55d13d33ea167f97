"""Which fault explains the residual of the thermal model: a discrete Bayes filter per motor.

For samples hours apart, between which a motor settles anew; `monitor` is for every second.

States: no fault; a kind of heat times its size; a sensor off by a size, up or down; a loose
connector. Every kind of heat has its own signature over the three points and over time, from the
sensitivities of the calibrated model: more heat in the winding shows there and, less, elsewhere;
heat of a resistance grows with the squared current; less air lifts all three points, a bearing
fault one end. A sensor fault changes exactly one point. The filter reads each motor's residual less
the median of the other motors' residuals (the fault itself would pull a mean; weather and duty that
the model does not know are the same for all). Suspected motors are left out of the median, and each
residual is taken less its learnt baseline: otherwise a median over aged motors would step when one
of them develops a fault. Readings have heavy tails (Student t). Residuals are correlated from
sample to sample, so each counts as the share of an independent one that its correlation leaves.

It replaces paper `thermal`, eq. (28)-(31): a filter follows a fault, and the spread between motors
shows neither which motor has a fault nor which fault. The rules are in `hypotheses.c`, `peers.c`.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from _traction_core import ffi, lib
from numpy.typing import NDArray

from dbc import records
from dbc.arrays import Array
from dbc.records import pointer
from estimators.thermal import model
from estimators.thermal.model import Inputs, predict

HEAT: Final = ("overheating", "cooling_loss", "bearing_de", "bearing_nde", "winding_resistance")
SENSORS: Final = ("bias_stator", "bias_de", "bias_nde")
LOOSE: Final = ("loose_stator", "loose_de", "loose_nde")
KINDS: Final = (*HEAT, *SENSORS, *LOOSE)
FLOOR_K: Final = 0.1
SIZES_K: Final = np.array([-3.0, -2.0, -1.0, 1.0, 2.0, 3.0, 4.2, 6.0, 8.5, 12.0, 17.0])
BENIGN_K: Final = np.array([1.5, 3.6, 2.5, 2.5, 1.5, 1.5, 1.5, 1.5])
"""Least sizes that are faults, of `HEAT` and `SENSORS`. Smaller ones are dirt, draught, weather and
wear, of which air and bearings have more. They are states of their own, so that the filter takes
them neither for a healthy motor nor for a fault."""
TAIL: Final = 5.0
"""Degrees of freedom of the readings' Student t."""
NAMED: Final = 0.99
"""Share of the probability of heat and sensors together that one must have to be named."""
APART_NAMED, APART_LASTS, APART_HIDDEN_K = 0.999, 3, 3.0
"""The same for samples hours apart, between which a sensor's step is not seen: the share, for how
many samples in a row (a burst lasts one), and the K that dirt or wear may hide at another point."""
LOOSE_SHARE, LOOSE_K = 0.1, 60.0
"""Share of a loose connector's readings that are off, and how far off they may be, K."""


class Pace(NamedTuple):
    """Mean times of the Markov chain, in samples.

    healthy: until a fault begins; ill: until it ends; often: until dirt, draught or weather begins;
    grows: until a size becomes the next larger or smaller one; learnt: time constant of a motor's
    baseline, which is learnt while there is no fault; loose: until a loose connector is forgotten.
    """

    healthy: float = 5000.0
    ill: float = 1000.0
    often: float = 50.0
    grows: float = 50.0
    learnt: float = 40.0
    loose: float = 60.0


SNAPSHOTS: Final = Pace()
"""For samples that are hours apart, between which a motor settles anew."""


class Spread(NamedTuple):
    """Statistics of a healthy motor's residual less its peers', from fault-free data.

    centre, sigma (M, 3) K; white (M, 3, 3) 1/K: rows turn the three points' residuals into
    independent ones of unit variance (what the points share, and what each has of its own); share
    (M, 3): fraction of an independent sample that one sample of each of these counts as.
    """

    centre: Array
    sigma: Array
    white: Array
    share: Array


class Belief(NamedTuple):
    """kind (K, M, len(KINDS)): probability of each; size_k (K, M): mean size if any.

    side (K, M): 1 heat, -1 a sensor, 0 undecided.
    """

    kind: Array
    size_k: Array
    side: NDArray[np.int64]

    @property
    def fault(self) -> Array:
        """(K, M) probability of any fault."""
        out: Array = self.kind.sum(axis=2)
        return out

    @property
    def statistic(self) -> Array:
        """(K, M) log odds of a fault, 0 where a fault is less probable than none."""
        p = np.clip(self.fault, 1e-300, 1.0 - 1e-15)
        out: Array = np.maximum(np.log(p) - np.log1p(-p), 0.0)
        return out


def side(kind: Array, named: float = NAMED) -> NDArray[np.int64]:
    """1 where the fault is heat, -1 where it is a sensor, 0 where neither has the share `named`.

    See `thermal_sides` in `hypotheses.h`. kind (..., 11): probabilities; returns (...,).
    """
    given = np.ascontiguousarray(kind, dtype=np.float64)
    sides = np.empty(given.shape[:-1], dtype=np.int64)
    lib.thermal_sides(pointer("double", given), sides.size, named, pointer("int64_t", sides))
    return sides


def side_apart(kind: Array, rise_k: Array, shapes: Array) -> NDArray[np.int64]:
    """`side` of samples hours apart, between which a motor settles anew; causal.

    kind (K, M, 11); rise_k (K, M): error of a sensor, K; shapes (K, 5, 3): see `signatures`. A
    sensor that reads high is named only where heat of that size would have shown at another point.
    """
    first, then = len(HEAT), len(HEAT) + len(SENSORS)
    loose = kind[..., then:].sum(axis=-1)
    clear = loose / np.maximum(kind.sum(axis=-1), 1e-300)
    sides = side(kind, APART_NAMED)
    sides = np.where((loose > 0.5) & (clear < NAMED), 0, sides)
    which = kind[..., first:then].argmax(axis=-1)
    hot = [HEAT.index(name) for name in ("overheating", "bearing_de", "bearing_nde")]
    beside = [np.delete(shapes[:, hot[q]], q, axis=1).max(axis=1) for q in range(3)]
    shown_k = rise_k * np.take_along_axis(np.stack(beside, axis=1), which, axis=1)
    hidden = (rise_k > 0.0) & (shown_k < APART_HIDDEN_K) & (loose < 0.5)
    sides = np.where((sides < 0) & hidden, 0, sides)
    lasts = np.zeros_like(sides, dtype=np.bool_)
    lasts[APART_LASTS - 1 :] = True
    for back in range(1, APART_LASTS):
        lasts[back:] &= sides[back:] == sides[:-back]
    # In a motor with a fault, a burst looks like another kind of the same side for one sample.
    kinds = kind.argmax(axis=-1)
    lasts[1:] &= kinds[1:] == kinds[:-1]
    return np.where(lasts, sides, 0)


def spread(residual: Array, learnt: float) -> Spread:
    """`Spread` of fault-free residuals (K, M, 3) that were not used for the model.

    learnt: as in `Pace`.
    """
    centre = np.nanmedian(residual, axis=0)
    off = beside_peers(residual - centre, learnt)
    motors = off.shape[1]
    white, share = np.empty((motors, 3, 3)), np.empty((motors, 3))
    sigma = np.empty((motors, 3))
    for m in range(motors):
        seen = off[np.isfinite(off[:, m]).all(axis=1), m]
        covariance = seen.T @ seen / max(len(seen), 1) + FLOOR_K**2 * np.eye(3)
        sigma[m] = np.sqrt(np.diag(covariance))
        values, vectors = np.linalg.eigh(covariance)
        white[m] = (vectors / np.sqrt(values)).T
        parts = seen @ white[m].T
        product = np.sum(parts[1:] * parts[:-1], axis=0)
        square = np.maximum(np.sum(parts[:-1] ** 2, axis=0), 1e-12)
        rho = np.clip(product / square, 0.0, 0.9999)
        share[m] = (1.0 - rho) / (1.0 + rho)
    return Spread(centre, sigma, white, share)


def peers_median(u: Array, trusted: NDArray[np.bool_]) -> Array:
    """(M, 3) K: per motor and point the median of u (M, 3) over the other motors; see `peers.h`.

    trusted (M,): motors that others are compared with, if these are enough.
    """
    out, given = np.empty(u.shape), np.ascontiguousarray(u, dtype=np.float64)
    lib.peers_median(
        pointer("double", given), pointer("uint8_t", trusted), len(u),
        ffi.new("double[]", len(u)), pointer("double", out),
    )  # fmt: skip
    return out


def beside_peers(residual: Array, learnt: float) -> Array:
    """Fault-free residuals (K, M, 3) less baseline and peers' median, as the filter reads them."""
    out, baseline = np.empty(residual.shape), np.zeros(residual.shape[1:])
    everybody = np.ones(residual.shape[1], dtype=np.bool_)
    for k, sample in enumerate(residual):
        u = sample - baseline
        out[k] = u - peers_median(u, everybody)
        baseline += np.nan_to_num(out[k]) / learnt
    return out


def signatures(parameters: Array, inputs: Inputs, start: Array | None) -> Array:
    """(K, 5, 3) K that faults of `HEAT` add to the readings; the mean of the largest point is 1.

    For the mean motor and faults that are present from the beginning.
    """
    mean = parameters.mean(axis=0)
    tried = np.tile(mean, (1 + len(HEAT), 1))
    tried[2, [model.H_0, model.H_1]] *= 0.9
    tried[3, model.F_D] *= 2.0
    tried[4, model.F_N] *= 2.0
    tried[5, model.A] *= 1.1
    extra = np.zeros((len(tried), model.EXTRA))
    extra[1, 0] = 0.01
    square = inputs.current_square.mean(axis=1, keepdims=True)
    begin = None if start is None else np.tile(start.mean(axis=0), (len(tried), 1))
    out = predict(tried, inputs._replace(current_square=square), begin, extra)
    more = out[:, 1:] - out[:, :1]
    largest = np.abs(more).mean(axis=0).max(axis=1)
    return np.asarray(more / np.maximum(largest, 1e-9)[:, None])


def believe(residual: Array, known: Spread, shapes: Array) -> Belief:
    """Filter K samples of M motors, residual (K, M, 3) K; shapes (K, 5, 3): see `signatures`."""
    kind, size, rise = filter_samples(residual - known.centre, known, shapes)
    return Belief(kind, size, side_apart(kind, rise, shapes))


def filter_samples(
    z: Array, known: Spread, shapes: Array, at: Pace = SNAPSHOTS
) -> tuple[Array, Array, Array]:
    """Probabilities (K, M, 11); mean size and mean error of a sensor (K, M), K.

    z (K, M, 3) K: residuals less their centre, NaN without a reading; shapes (K, 5, 3).
    """
    samples, motors, _ = z.shape
    config, spread = _config(at), np.zeros(motors, records.HYPOTHESIS_SPREAD)
    spread["sigma_k"], spread["white"], spread["share"] = known.sigma, known.white, known.share
    state = np.zeros(motors, records.HYPOTHESIS_STATE)
    every = pointer("struct hypothesis_state", state)
    for motor in every:
        lib.hypothesis_start(ffi.addressof(motor))
    kind, size, rise = np.empty((samples, motors, len(KINDS))), *np.empty((2, samples, motors))
    workspace = ffi.new("double[]", 8 * motors)
    seen, signs = (np.ascontiguousarray(part, dtype=np.float64) for part in (z, shapes))
    for k in range(samples):
        lib.hypothesis_step(
            pointer("struct hypothesis_config", config),
            pointer("struct hypothesis_spread", spread), every, motors, pointer("double", seen[k]),
            pointer("double", signs[k]), workspace,
        )  # fmt: skip
        kind[k], size[k], rise[k] = state["kind"], state["size_k"], state["rise_k"]
    return kind, size, rise


def _config(at: Pace) -> records.Records:
    """(1,) of `struct hypothesis_config`."""
    out = np.zeros(1, records.HYPOTHESIS_CONFIG)
    out["sizes_k"], out["benign_k"] = SIZES_K, BENIGN_K
    out["begin"], out["end"], out["growth"] = 1.0 / at.healthy, 1.0 / at.ill, 1.0 / at.grows
    out["often"], out["learn"], out["loose_end"] = 1.0 / at.often, 1.0 / at.learnt, 1.0 / at.loose
    out["tail"] = TAIL
    out["log_t"] = (
        math.lgamma(0.5 * (TAIL + 1.0)) - math.lgamma(0.5 * TAIL) - 0.5 * math.log(math.pi * TAIL)
    )
    out["loose_share"], out["loose_k"] = LOOSE_SHARE, LOOSE_K
    return out
