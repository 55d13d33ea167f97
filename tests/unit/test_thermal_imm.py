"""Interacting filters of the thermal monitor, by law: matrices, Kalman, Bayes, Markov."""

import numpy as np
import pytest
from _traction_core import lib
from filterpy.kalman import IMMEstimator, KalmanFilter
from scipy.linalg import block_diag, expm
from scipy.stats import multivariate_normal

from dbc import records
from dbc.records import pointer
from estimators.thermal import model
from estimators.thermal.monitor import SIZES_K
from tests import thermal_core as imm

DT, NOISE = 30.0, 0.1
SIGMA = np.array([0.01, 0.7, 0.02, 0.05, 0.05])
CONFIG = imm.config(DT, end_per_s=1 / 2400)
SURE_OF_READINGS = 1e45
"""K: so wide that no block is what it seems not to be, but for the share of those that are."""
CONSTANT = -0.5 * np.log(2.0 * np.pi)
SHARE = np.log(0.99)


def motor(seed, spread=0.3):
    rng = np.random.default_rng(seed)
    return model.TYPICAL * np.exp(spread * rng.standard_normal(model.COUNT)), rng


def surroundings(p, square=2e4, speed=200.0, rise=30.0):
    """Of a motor at a steady duty that is the mean one: `struct imm_surroundings`."""
    warm = 1.0 + 0.0039 * (90.0 - 60.0)
    cooling, copper = (p[model.H_0] + p[model.H_1] * speed) * rise, p[model.A] * square * warm
    sums = imm.sums_of((square, speed, cooling, copper, rise), 7.0)
    config = np.zeros(1, records.THERMAL_CONFIG)
    config["duty_speed"], config["duty_cooling"], config["duty_copper"] = speed, cooling, copper
    settles = -np.linalg.inv(model.system_matrix(p, square, speed))
    config["settles_k"] = settles[list(model.MEASURED)].max(axis=0)
    out = np.zeros(1, records.IMM_SURROUNDINGS)
    lib.thermal_surroundings(
        pointer("struct thermal_config", config),
        pointer("struct thermal_parameters", model.parameter_records(p)),
        pointer("struct thermal_sums", sums), pointer("struct imm_surroundings", out),
    )  # fmt: skip
    assert out["rise_k"] == pytest.approx(rise)
    return out


def beliefs(modes, seed):
    """Any probabilities, means, covariances; the first mode knows no size, heat does not creep."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((modes, 12, 12))
    cov = 0.1 * root @ root.transpose(0, 2, 1)
    mean = rng.standard_normal((modes, 12))
    mean[0, 10:], cov[0, 10:], cov[0, :, 10:] = 0.0, 0.0, 0.0
    heats = slice(1, 1 + imm.HEATS)
    mean[heats, 11], cov[heats, 11], cov[heats, :, 11] = 0.0, 0.0, 0.0
    return rng.dirichlet(np.ones(modes)), mean, cov


def test_a_variance_below_zero_is_no_more_than_none():
    """Of a damaged record: nothing ends in a number that is none."""
    x, p = np.zeros(12), np.diag(np.full(12, -1.0))
    assert np.isfinite(imm.update(0, [1.0, np.nan, 2.0], NOISE, 5.0, x, p))
    assert np.isfinite(x).all()
    assert np.isfinite(p).all()


def test_at_the_start_nothing_is_wrong_and_of_every_fault_its_first_size_is_known():
    own, fault = imm.started(CONFIG)[0], CONFIG["fault"][0]
    np.testing.assert_array_equal(own["mode"], [1.0] + [1e-30] * (imm.MODES - 1))
    np.testing.assert_array_equal(own["mean"][:, :10], 0.0)
    np.testing.assert_array_equal(own["mean"][:, imm.SIZE], fault["mean_k"])
    for g in range(imm.MODES):
        first = [0.3, 5.0, 2.0, 0.3, 0.3, *CONFIG["sigma"][0]]
        sigma = [*first, fault["sigma_k"][g], fault["creep_k_s"][g]]
        np.testing.assert_allclose(own["cov"][g], np.diag(np.square(sigma)), rtol=1e-15)


@pytest.mark.parametrize("sensor", [0, 1, 2])
def test_a_share_of_a_sensor_that_is_off_counts_for_heat_there(sensor):
    """Neither is named then; what reads low may be compared with another motor that is hot."""
    modes, mean, cov = beliefs(imm.MODES, 3)
    mode = np.where(np.arange(len(modes)) == 1 + imm.HEATS + sensor, 1.0, 1e-30)
    doubting = CONFIG.copy()
    doubting["ambiguous"], doubting["ambiguous_low"] = 0.3, 0.2
    for size_k, share in ((8.0, 0.3), (-8.0, 0.2)):
        mean[:, imm.SIZE] = size_k
        own = imm.state(mode, mean, cov)
        (before, size), (kind, same) = imm.kinds(CONFIG, own), imm.kinds(doubting, own)
        moved = share * before[imm.HEATS + sensor]
        want = before.copy()
        want[[imm.HEATS + sensor, (0, 2, 3)[sensor]]] += [-moved, moved]
        np.testing.assert_allclose(kind, want, atol=1e-9)
        assert same == pytest.approx(size)


@pytest.mark.parametrize("heat", range(imm.HEATS))
def test_heat_that_one_reading_shows_may_be_its_sensor(heat):
    """Unless a second reading is at least half as warm, or the heat follows the load."""
    modes, mean, cov = beliefs(imm.MODES, 3)
    mode = np.where(np.arange(len(modes)) == 1 + heat, 1.0, 1e-30)
    doubting = CONFIG.copy()
    doubting["ambiguous"] = 0.3
    mean[:, imm.SIZE] = 30.0
    alone = {(8.0, 3.9, -1.0): 0, (1.0, 1.0, 8.0): 2, (-8.0, 3.0, 3.0): 1, (0.5, 0.8, 0.5): 1}
    together = dict.fromkeys(((8.0, 4.1, -1.0), (3.0, 1.0, 3.0), (0.7, 0.1, 0.7)), -1)
    for seen, sensor in (alone | together).items():
        mean[:, list(model.MEASURED)] = seen
        own = imm.state(mode, mean, cov)
        (before, size), (kind, same) = imm.kinds(CONFIG, own), imm.kinds(doubting, own)
        want = before.copy()
        if sensor >= 0 and heat != imm.HEATS - 1:
            want[[heat, imm.HEATS + sensor]] += np.array([-0.3, 0.3]) * before[heat]
        np.testing.assert_allclose(kind, want, atol=1e-9)
        assert before[heat] > 0.05
        assert same == pytest.approx(size)


@pytest.mark.parametrize("dt", [0.5, 1.0, 16.0, 60.0, 120.0])
@pytest.mark.parametrize("stiff", [0.01, 1.0, 30.0])
def test_the_response_is_the_exponential_and_its_integral(dt, stiff):
    for seed in range(10):
        p, rng = motor(seed, 0.7)
        rates = stiff * model.system_matrix(p, rng.uniform(0.0, 1e5), rng.uniform(0.0, 400.0))
        fade, gain = imm.response(rates, dt)
        both = expm(np.block([[rates, np.eye(5)], [np.zeros((5, 10))]]) * dt)
        np.testing.assert_allclose(fade, both[:5, :5], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(gain, both[:5, 5:], rtol=1e-9, atol=1e-11 * dt)


def test_directions_are_derivatives_of_the_model():
    """Of `heat`, by differences: lumps, copper, air, less cooling, friction; faults settle at 1."""
    p, _ = motor(3)
    p[model.OFFSETS] = 0.0
    square, speed, ambient, dt = 2e4, 200.0, 15.0, 1e-3
    x0 = np.array([90.0, 70.0, ambient + 30.0, 42.0, 41.0])
    around = surroundings(p)
    rates, pushes, heats = (around[name][0] for name in ("rates", "pushes", "heats"))
    np.testing.assert_allclose(rates, model.system_matrix(p, square, speed), rtol=1e-12)

    def change(motor, air):
        x = x0.copy()
        imm.step(motor, square, speed, air, np.zeros(5), dt, x)
        return (x - x0) / dt

    for d, names in enumerate([(model.A,), (), (model.H_0, model.H_1), (model.F_D,), (model.F_N,)]):
        other, share = p.copy(), 1e-2
        other[list(names)] *= 1.0 - share if d == 2 else 1.0 + share
        got = (change(other, ambient + share * (d == 1)) - change(p, ambient)) / share
        np.testing.assert_allclose(pushes[:, d], got, rtol=2e-3, atol=2e-6)
    seen = (-np.linalg.inv(rates) @ heats.T)[list(model.MEASURED)]
    np.testing.assert_allclose(seen.max(axis=0), 1.0, rtol=1e-9)


def test_disturbances_push_as_the_joint_exponential_says():
    """They fade while they push: that they do so at once in the middle is 1 % off at most."""
    around = surroundings(motor(1)[0])
    rates, pushes = around["rates"][0], around["pushes"][0]
    for d in range(5):
        own = imm.state([1.0], np.eye(12)[[5 + d]], 1e-12 * np.eye(12)[None])
        joint = expm(DT * np.block([[rates, pushes], [np.zeros((5, 5)), -np.eye(5) / 900.0]]))
        imm.advance(imm.config(DT, SIZES_K[:1]), around, np.full(3, np.nan), NOISE, own)
        mean = own["mean"][0]
        largest = np.abs(joint[:5, 5 + d]).max()
        np.testing.assert_allclose(mean[0, :5], joint[:5, 5 + d], atol=0.01 * largest)
        assert mean[0, 5 + d] == pytest.approx(joint[5 + d, 5 + d], rel=1e-12)


def test_one_mode_is_a_kalman_filter():
    """filterpy's, with holes; its log likelihood by SciPy."""
    around = surroundings(motor(2)[0])
    config = imm.config(DT, SIZES_K[:1], wide_k=SURE_OF_READINGS)
    keep = np.exp(-DT / 900.0)
    fade, gain = imm.response(around["rates"][0], DT)
    _, mean, cov = beliefs(1, 4)
    own = imm.state([1.0], mean, cov)
    pushes = around["pushes"][0]
    kf = KalmanFilter(dim_x=10, dim_z=3)
    kf.F = np.block([[fade, gain @ pushes * np.sqrt(keep)], [np.zeros((5, 5)), keep * np.eye(5)]])
    kf.x, kf.P = mean[0, :10].copy(), cov[0, :10, :10].copy()
    seen = np.eye(10)[[0, 3, 4]]
    rng = np.random.default_rng(0)
    for k in range(300):
        y = 0.3 * rng.standard_normal(3)
        y[rng.random(3) < 0.2] = np.nan
        unsure = 0.6 * (1.0 - np.diag(fade)) * kf.x[:5]
        lumps = 0.02**2 * DT / 60.0 + unsure**2
        kf.predict(Q=np.diag([*lumps, *SIGMA**2 * (1.0 - keep**2)]))
        here = np.isfinite(y)
        says = imm.advance(config, around, y, NOISE, own)
        want = 0.0
        if here.any():
            h, r = seen[here], NOISE**2 * np.eye(here.sum())
            s = h @ kf.P @ h.T + r
            want = multivariate_normal.logpdf(y[here], h @ kf.x, s) - here.sum() * CONSTANT + SHARE
            kf.dim_z = here.sum()
            kf.update(y[here], R=r, H=h)
        assert says == pytest.approx(want, abs=1e-8), k
        np.testing.assert_allclose(own["mean"][0, 0, :10], kf.x, rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(own["cov"][0, 0, :10, :10], kf.P, rtol=1e-7, atol=1e-10)
    assert own["mean"][0, 0, 10] == 0.0
    assert own["mode"][0, 0] == 1.0


def test_explanations_that_never_change_are_weighed_by_bayes():
    """Every mode's whole record as one normal vector: no filter in the reference at all."""
    around = surroundings(motor(5)[0])
    config = imm.config(
        DT, begin_per_s=0.0, end_per_s=0.0, unsure=0.0, walk_share=0.0, wide_k=SURE_OF_READINGS,
        unsteady=0.0, walk_sensor_k=0.1,
    )  # fmt: skip
    keep, blocks = np.exp(-DT / 900.0), 12
    prior, mean, cov = beliefs(imm.MODES, 6)
    # Far from cooling, which no fault does; and so little heat that all may be true.
    mean[:, :10] *= 0.1
    mean[1 : 1 + imm.HEATS, 10] += 9.0
    around["heats"] *= 0.03
    pushes, heats = around["pushes"][0], around["heats"][0]
    fade, gain = imm.response(around["rates"][0], DT)
    y = np.cumsum(np.random.default_rng(3).normal(0.0, 0.1, (blocks, 3)), axis=0)
    want = np.empty(imm.MODES)
    for g in range(imm.MODES):
        f = block_diag(fade, keep * np.eye(5), 1.0, keep)
        f[10, 11] = DT
        f[:5, 5:10] = gain @ pushes * np.sqrt(keep)
        f[:5, 10] = gain @ heats[g - 1] if 0 < g <= imm.HEATS else 0.0
        walk = (g > 0) * (0.2 if g <= imm.HEATS else 0.1) ** 2
        creep = SIZES_K[g, 2] ** 2 * (1.0 - keep**2)
        q = np.diag([*[0.02**2 * DT / 60.0] * 5, *SIGMA**2 * (1.0 - keep**2), walk, creep])
        h = np.eye(12)[[0, 3, 4]]
        if g > imm.HEATS:
            h[g - imm.HEATS - 1, 10] = 1.0
        # All states from the first and what shook them.
        powers = [np.linalg.matrix_power(f, n) for n in range(blocks + 1)]
        rows = [
            np.hstack([powers[k + 1], *(powers[max(k - j, 0)] * (j <= k) for j in range(blocks))])
            for k in range(blocks)
        ]  # fmt: skip
        seen = block_diag(*[h] * blocks) @ np.vstack(rows)
        spread = seen @ block_diag(cov[g], *[q] * blocks) @ seen.T
        middle = seen[:, :12] @ mean[g]
        spread += NOISE**2 * np.eye(3 * blocks)
        want[g] = multivariate_normal.logpdf(y.ravel(), middle, spread) + np.log(prior[g])
    own = imm.state(prior, mean, cov)
    around["rise_k"] = 1e15  # An endless rise: lost cooling is linear as well.
    says = sum(imm.advance(config, around, y[k], NOISE, own) for k in range(blocks))
    mode = own["mode"][0]
    total = np.logaddexp.reduce(want)
    np.testing.assert_allclose(mode, np.exp(want - total), rtol=1e-5, atol=1e-15)
    assert np.sort(mode)[-3] > 1e-4, "not trivially so"
    assert says == pytest.approx(total - 3 * blocks * CONSTANT + blocks * SHARE, rel=1e-7)


def mixture(parts):
    """Mean and covariance of (weight, mean, covariance) parts, from raw moments."""
    weight = sum(w for w, _, _ in parts)
    mean = sum(w * m for w, m, _ in parts) / weight
    second = sum(w * (c + np.outer(m, m)) for w, m, c in parts) / weight
    return weight, mean, second - np.outer(mean, mean)


@pytest.mark.parametrize("modes", [2, 5, imm.MODES])
def test_mixing_is_the_markov_chain_s_moments(modes):
    begin, end = 0.02, 0.1
    mode, mean, cov = beliefs(modes, modes)
    sizes = SIZES_K[:modes].copy()
    sizes[:, 3] = np.arange(modes) / np.arange(modes).sum()
    weight, middle, spread = imm.mix(
        imm.config(DT, sizes), imm.state(mode, mean, cov), modes, begin, end
    )  # fmt: skip
    assert weight.sum() == pytest.approx(1.0, abs=1e-14)
    sizeless = np.diag([1.0] * 10 + [0.0] * 2)
    parts = [((1.0 - begin) * mode[0], mean[0], cov[0])]
    parts += [
        (end * mode[g], sizeless @ mean[g], sizeless @ cov[g] @ sizeless) for g in range(1, modes)
    ]
    wants = [mixture(parts)]
    for g in range(1, modes):
        fresh, fresh_cov = sizeless @ mean[0], sizeless @ cov[0] @ sizeless
        fresh[10], fresh_cov[10, 10] = SIZES_K[g, 0], SIZES_K[g, 1] ** 2
        fresh_cov[11, 11] = SIZES_K[g, 2] ** 2
        stays = ((1.0 - end) * mode[g], mean[g], cov[g])
        wants.append(mixture([stays, (begin * mode[0] * sizes[g, 3], fresh, fresh_cov)]))
    for g, (w, m, c) in enumerate(wants):
        assert weight[g] == pytest.approx(w, rel=1e-12)
        np.testing.assert_allclose(middle[g], m, rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(spread[g], c, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("held", [False, True])
def test_while_a_fault_is_told_no_other_explanation_is_written_over(held):
    """An unlikely one keeps what it has learnt; else it would begin anew with every block."""
    mode, mean, cov = beliefs(imm.MODES, 8)
    mode[:] = [0.3, 0.7 - 7e-20, *[1e-20] * 7]
    mean[-1, imm.SIZE :] = 7.0, 0.0
    own = imm.state(mode, mean, cov)
    imm.advance(CONFIG, surroundings(motor(7)[0]), np.full(3, np.nan), NOISE, own, held)
    assert own["mean"][0, -1, imm.SIZE] == pytest.approx(7.0 if held else 0.0, abs=1e-9)


def test_mixing_without_sizes_is_filterpys():
    """Where all sizes are alike and certain, a fresh one is nothing new."""
    modes, begin, end = 4, 0.05, 0.2
    mode, mean, cov = beliefs(modes, 1)
    mean[:, 10:], cov[:, 10:], cov[:, :, 10:] = 0.0, 0.0, 0.0
    chain = np.eye(modes) * (1.0 - end)
    chain[0], chain[1:, 0] = begin / (modes - 1), end
    chain[0, 0] = 1.0 - begin
    filters = []
    for g in range(modes):
        kf = KalmanFilter(dim_x=12, dim_z=1)
        kf.x, kf.P, kf.Q = mean[g].copy(), cov[g].copy(), np.zeros((12, 12))
        filters.append(kf)
    theirs = IMMEstimator(filters, mode.copy(), chain)
    sizes = np.zeros((modes, 4))
    sizes[1:, 3] = 1.0 / (modes - 1)
    theirs.predict()
    weight, middle, spread = imm.mix(
        imm.config(DT, sizes), imm.state(mode, mean, cov), modes, begin, end
    )  # fmt: skip
    np.testing.assert_allclose(weight, theirs.cbar, rtol=1e-12)
    np.testing.assert_allclose(middle, [f.x for f in filters], rtol=1e-10, atol=1e-13)
    np.testing.assert_allclose(spread, [f.P for f in filters], rtol=1e-10, atol=1e-13)
