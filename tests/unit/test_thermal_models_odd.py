"""Thermal filters, what they say and what they begin with: outliers, sizes, bad numbers."""

import math

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from estimators.thermal import _models_kernels as models
from estimators.thermal import _watch_kernels as kernels
from estimators.thermal import heat
from estimators.thermal.hypotheses import KINDS
from estimators.thermal.watch import BENIGN_K, BURSTS, SHOWN_K, SIZES_K

DT, NOISE, WIDE = 16.0, 0.1, 5.0
SIGMA = np.array([0.01, 0.7, 0.02, 0.05, 0.05])
ODDS = np.array([1 / 36_000, 1 / 2400, 900.0, 0.6, 0.2, 0.03, 0.02, WIDE, 0.3, 0.3])
UNIT = np.array([200.0, 0.03, 0.08, 300.0, 900.0, 500.0, 500.0])
CONSTANT = -0.5 * math.log(2.0 * math.pi)


def judged(p, sums, off, bursts, state, held):
    """One block of one motor through `judge`; state: mode, mean, cov, base, loose, kind."""
    return kernels.judge(
        p, sums, UNIT, off, bursts, DT, SIGMA, ODDS, SIZES_K, NOISE, BENIGN_K,
        SHOWN_K, np.array([1 / 30_000, 1 / 3600, 1 / 7200]), *state, held,
    )  # fmt: skip


def begun():
    mode, mean = np.empty(models.MODES), np.empty((models.MODES, models.STATES))
    cov = np.empty((models.MODES, models.STATES, models.STATES))
    kernels.forget(mode, mean, cov, SIGMA, SIZES_K)
    return mode, mean, cov, np.zeros(3), np.zeros(3), np.zeros(len(KINDS))


@pytest.mark.parametrize("g", range(models.MODES))
def test_an_update_is_the_mixture_of_a_good_and_an_outlying_block(g):
    rng = np.random.default_rng(g)
    for size in (0.1, 1.0, 3.0, 30.0):
        root = 0.3 * rng.standard_normal((12, 12))
        x, p = rng.standard_normal(12), root @ root.T
        h = np.eye(12)[[0, 3, 4]]
        if g > models.HEATS:
            h[g - models.HEATS - 1, 10] = 1.0
        y = h @ x + size * rng.standard_normal(3)
        y[int(rng.integers(0, 3))] = np.nan
        here = np.isfinite(y)
        h = h[here]
        s = h @ p @ h.T + NOISE**2 * np.eye(2)
        good, bad = (
            math.log(share) + multivariate_normal.logpdf(y[here], h @ x, s + w * np.eye(2))
            for share, w in ((0.99, 0.0), (0.01, WIDE**2))
        )
        total = np.logaddexp(good, bad)
        sure = math.exp(good - total)
        gain = p @ h.T @ np.linalg.inv(s)
        moved = gain @ (y[here] - h @ x)
        want_p = p - sure * gain @ s @ gain.T + sure * (1.0 - sure) * np.outer(moved, moved)
        got_x, got_p = x.copy(), p.copy()
        says = models._update(got_x, got_p, g, y, NOISE, WIDE)
        assert says == pytest.approx(total - 2 * CONSTANT, rel=1e-9)
        np.testing.assert_allclose(got_x, x + sure * moved, atol=1e-9)
        np.testing.assert_allclose(got_p, want_p, atol=1e-9)


def test_what_is_told_is_the_probability_of_more_than_is_benign_and_of_being_seen():
    rng = np.random.default_rng(0)
    for _ in range(50):
        mode, mean = rng.dirichlet(np.ones(models.MODES)), 4.0 * rng.standard_normal((9, 12))
        cov = np.zeros((9, 12, 12))
        cov[:, 10, 10] = rng.uniform(0.1, 9.0, 9)
        seen = list(heat.MEASURED)
        cov[:, seen, seen] = rng.uniform(0.1, 4.0, (9, 3))
        kind = np.empty(8)
        size = models.tell(mode, mean, cov, BENIGN_K, SHOWN_K, kind)
        sizes = norm(mean[1:, 10], np.sqrt(cov[1:, 10, 10]))
        beyond = sizes.sf(BENIGN_K)
        beyond[models.HEATS :] += sizes.cdf(-BENIGN_K)[models.HEATS :]
        warm = norm(mean[1:, seen], np.sqrt(cov[1:, seen, seen])).sf(SHOWN_K).max(axis=1)
        beyond[: models.HEATS] = np.minimum(beyond, warm)[: models.HEATS]
        np.testing.assert_allclose(kind, mode[1:] * beyond, atol=1e-12)
        assert size == pytest.approx(kind @ np.abs(mean[1:, 10]) / kind.sum())


def test_nothing_seen_is_nothing_learnt():
    """Without readings every probability goes to the chain's own, and no other way."""
    state = begun()
    rates = heat.coupling(heat.TYPICAL, 2e4, 200.0)
    pushes, heats = np.zeros((5, 5)), np.zeros((5, 5))
    ill = 0.0
    for _ in range(400):
        ill += (1.0 - ill) * ODDS[0] * DT - ill * ODDS[1] * DT
        says = models.advance(
            *state[:3], np.full(3, np.nan), rates, pushes, heats, 30.0, DT, SIGMA, ODDS, SIZES_K,
            NOISE, False,
        )  # fmt: skip
        assert says == pytest.approx(0.0, abs=1e-12)
        np.testing.assert_allclose(state[0][1:], ill / 8, rtol=1e-9)


def hostile(rng, k):
    """A block's differences and inputs: from quiet to absurd."""
    scale = 10.0 ** rng.uniform(-3.0, 6.0) if k % 7 == 0 else 0.3
    off = scale * rng.standard_normal(3)
    off[rng.random(3) < 0.15] = np.nan
    if k % 501 == 0:
        off[:] = 1e6
    n = float(rng.integers(0, 17))
    sums = n * np.array([
        rng.uniform(0.0, 4e5), rng.uniform(0.0, 1e3), rng.uniform(0.0, 1.0),
        rng.uniform(0.0, 3.0), rng.uniform(3.0, 300.0), 1.0,
    ])  # fmt: skip
    return off, sums, rng.choice([-1e3, 0.0, 30.0, 1e3], 3)


def test_20_000_hostile_blocks_leave_probabilities_and_covariances():
    rng = np.random.default_rng(1)
    p, state, held = heat.TYPICAL, begun(), False
    mode, mean, cov, base, loose, kind = state
    for k in range(20_000):
        off, sums, bursts = hostile(rng, k)
        was = held
        size, says, ill, held = judged(p, sums, off, bursts, state, held)
        assert math.isfinite(size + says), k
        assert 0.0 <= ill <= 1.0
        assert held == (ill > (0.3 if was else 0.9))
        assert abs(mode.sum() - 1.0) < 1e-9
        assert mode.min() > 0.0
        assert kind.min() >= 0.0
        assert kind.sum() <= 1.0 + 1e-12
        assert (kind.sum() > 0.5) == held
        assert all(np.isfinite(a).all() for a in (mean, cov, base, loose))
        if k % 100 == 0:
            np.testing.assert_allclose(cov, cov.transpose(0, 2, 1), rtol=1e-9, atol=1e-12)
            values = np.linalg.eigvalsh(cov)
            assert (values[:, 0] >= -1e-7 * values[:, -1]).all(), k
    for _ in range(2000):
        judged(p, 16.0 * np.array([2e4, 200.0, 0.03, 0.08, 30.0, 1.0]),
               0.02 * rng.standard_normal(3), np.full(3, -0.16), state, held)  # fmt: skip
    assert kind.sum() < 0.5, "it recovers"


def test_lumps_begin_as_the_model_says_and_with_whatever_is_there():
    rng = np.random.default_rng(2)
    for _ in range(20):
        p = heat.TYPICAL * np.exp(0.3 * rng.standard_normal(heat.COUNT))
        p[heat.OFFSETS] = rng.standard_normal(3)
        readings, x = rng.uniform(20.0, 120.0, 3), np.empty(5)
        assert kernels.begin(p, readings, 0.0, 12.0, x)
        np.testing.assert_allclose(x, heat.begun(p[None], readings[None], 12.0)[0], rtol=1e-12)
        for gone in range(3):
            less = readings.copy()
            less[gone] = np.nan
            assert kernels.begin(p, less, 0.0, 12.0, x)
            assert np.isfinite(x).all()
            seen = x[list(heat.MEASURED)] + p[heat.OFFSETS]
            np.testing.assert_allclose(np.delete(seen, gone), np.delete(readings, gone))
        kept = x.copy()
        assert not kernels.begin(p, np.full(3, np.nan), 0.0, 12.0, x)
        np.testing.assert_array_equal(x, kept)


def settled(motors):
    """No readings yet."""
    burst = np.zeros((motors, 3, 2))
    burst[:, :, 0] = np.nan
    return burst


def evidence(far, near):
    loose, good = BURSTS[0], BURSTS[1]
    ratio = far * math.log(loose / good) + near * math.log((1.0 - loose) / (1.0 - good))
    return ratio / BURSTS[3]


def closed(blocks):
    """Odds of one sensor's blocks (B, K), one after the other."""
    burst, out = settled(1), []
    odds, middle, off, shift = (np.empty((1, 3)) for _ in range(4))
    for block in blocks:
        raw = np.tile(block, (1, 3, 1))
        kernels.close(
            raw, raw, np.full((1, 3), 0.25), BURSTS, np.zeros((1, 3)), np.zeros(1, dtype=np.bool_),
            burst, odds, middle, off, np.ones(1, dtype=np.bool_), shift,
        )  # fmt: skip
        out.append(odds[0, 0])
    return out


@pytest.mark.parametrize("first", range(16, 33))
def test_a_burst_counts_once_wherever_a_block_ends_and_a_step_does_not(first):
    quiet = np.full((4, 16), 0.1)
    rest = 4 * 16 - 5
    for size in (20.0, -5.0):
        burst = quiet.copy()
        burst.ravel()[first : first + 5] += size
        assert sum(closed(burst)) == pytest.approx(evidence(5, rest)), size
        step = quiet.copy()
        step.ravel()[first:] += size
        assert max(closed(step)) <= 0.0, size


def test_a_sensor_that_begins_within_a_burst_is_not_believed_to_step_or_burst():
    blocks = np.zeros((2, 16))
    blocks[0, :5] = 20.0
    first, second = closed(blocks)
    assert first == pytest.approx(evidence(0, 11))
    assert second == pytest.approx(evidence(0, 16))


def test_a_block_closes_with_medians_and_what_bursts_make_likely():
    rng = np.random.default_rng(3)
    motors, together = 6, 16
    raw = 0.25 * rng.standard_normal((motors, 3, together))
    raw[rng.random(raw.shape) < 0.2] = np.nan
    raw[1, 0, 4:9] = 25.0
    raw[2, 1, 5:] = np.nan
    raw[2, 1, :5] = 0.0
    block, base = raw - 3.0, rng.standard_normal((motors, 3))
    held = np.arange(motors) == 1
    odds, middle, off = (np.empty((motors, 3)) for _ in range(3))
    before, shift = np.ones(motors, dtype=np.bool_), np.empty((motors, 3))
    kernels.close(
        block, raw, np.full((motors, 3), 0.25), BURSTS, base, held, settled(motors), odds, middle,
        off, before, shift,
    )  # fmt: skip
    want = np.nanmedian(block, axis=2)
    want[2, 1] = np.nan
    np.testing.assert_array_equal(middle, want)
    u = want - base
    for m in range(motors):
        others = [n for n in range(motors) if n not in (m, 1)]
        np.testing.assert_allclose(off[m], u[m] - np.nanmedian(u[others], axis=0), atol=1e-12)
    far = (np.abs(raw - np.nanmedian(raw, axis=2)[:, :, None]) > BURSTS[4]).sum(axis=2)
    near = np.isfinite(raw).sum(axis=2) - far
    assert far.sum() == 5
    ratio = np.array(
        [
            [evidence(*pair) for pair in zip(*two, strict=True)]
            for two in zip(far, near, strict=True)
        ]
    )
    known = np.isfinite(want)
    np.testing.assert_allclose(odds[known], ratio[known])
    assert odds[1, 0] > 5.0 > 0.0 > odds[0].max()
