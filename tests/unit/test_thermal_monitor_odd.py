"""Thermal filters, what they say and what they begin with: outliers, sizes, bad numbers."""

import math

import numpy as np
import pytest
from _traction_core import lib
from scipy.stats import multivariate_normal, norm

from dbc import records
from dbc.records import pointer
from estimators.thermal import model, monitor
from estimators.thermal.hypotheses import side
from estimators.thermal.monitor import BENIGN_K, SHOWN_K, Known, ThermalMonitor
from tests import thermal_core as imm

DT, NOISE, WIDE = 16.0, 0.1, 5.0
BEGIN, END = 1 / 36_000, 1 / 2400
CONFIG = imm.config(DT, end_per_s=END)
CONSTANT = -0.5 * math.log(2.0 * math.pi)


def train(motors, samples=16, noise=0.25):
    """A monitor of typical motors whose samples, a second apart, make blocks of so many."""
    nothing = np.zeros((motors, 3))
    known = Known(
        np.tile(model.TYPICAL, (motors, 1)), nothing, nothing + noise, 1.0,
        np.array([200.0, 2e4, 0.03, 0.08]),
    )  # fmt: skip
    out = ThermalMonitor(known, DT / samples)
    assert out.block == samples
    return out


@pytest.mark.parametrize("g", range(imm.MODES))
def test_an_update_is_the_mixture_of_a_good_and_an_outlying_block(g):
    rng = np.random.default_rng(g)
    for size in (0.1, 1.0, 3.0, 30.0):
        root = 0.3 * rng.standard_normal((12, 12))
        x, p = rng.standard_normal(12), root @ root.T
        h = np.eye(12)[[0, 3, 4]]
        if g > imm.HEATS:
            h[g - imm.HEATS - 1, 10] = 1.0
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
        says = imm.update(g, y, NOISE, WIDE, got_x, got_p)
        assert says == pytest.approx(total - 2 * CONSTANT, rel=1e-9)
        np.testing.assert_allclose(got_x, x + sure * moved, atol=1e-9)
        np.testing.assert_allclose(got_p, want_p, atol=1e-9)


def test_what_is_told_is_the_probability_of_more_than_is_benign_and_of_being_seen():
    rng = np.random.default_rng(0)
    for _ in range(50):
        mode, mean = rng.dirichlet(np.ones(imm.MODES)), 4.0 * rng.standard_normal((9, 12))
        cov = np.zeros((9, 12, 12))
        cov[:, 10, 10] = rng.uniform(0.1, 9.0, 9)
        seen = list(model.MEASURED)
        cov[:, seen, seen] = rng.uniform(0.1, 4.0, (9, 3))
        kind, size = imm.kinds(CONFIG, imm.state(mode, mean, cov))
        sizes = norm(mean[1:, 10], np.sqrt(cov[1:, 10, 10]))
        beyond = sizes.sf(BENIGN_K)
        beyond[imm.HEATS :] += sizes.cdf(-BENIGN_K)[imm.HEATS :]
        warm = norm(mean[1:, seen], np.sqrt(cov[1:, seen, seen])).sf(SHOWN_K).max(axis=1)
        beyond[: imm.HEATS] = np.minimum(beyond, warm)[: imm.HEATS]
        np.testing.assert_allclose(kind, mode[1:] * beyond, atol=1e-12)
        assert size == pytest.approx(kind @ np.abs(mean[1:, 10]) / kind.sum())


def test_nothing_seen_is_nothing_learnt():
    """Without readings every probability goes to the chain's own, and no other way."""
    own = imm.started(CONFIG)
    rates = model.system_matrix(model.TYPICAL, 2e4, 200.0)
    around = imm.surroundings(rates, np.zeros((5, 5)), np.zeros((5, 5)), 30.0)
    ill = 0.0
    for _ in range(400):
        ill += (1.0 - ill) * BEGIN * DT - ill * END * DT
        says = imm.advance(CONFIG, around, np.full(3, np.nan), NOISE, own)
        assert says == pytest.approx(0.0, abs=1e-12)
        np.testing.assert_allclose(own["mode"][0, 1:], ill / 8, rtol=1e-9)


def hostile(rng, k):
    """A block's differences and inputs: from quiet to absurd."""
    scale = 10.0 ** rng.uniform(-3.0, 6.0) if k % 7 == 0 else 0.3
    off = scale * rng.standard_normal(3)
    off[rng.random(3) < 0.15] = np.nan
    if k % 501 == 0:
        off[:] = 1e6
    means = [rng.uniform(0.0, 4e5), rng.uniform(0.0, 1e3), rng.uniform(0.0, 1.0),
             rng.uniform(0.0, 3.0), rng.uniform(3.0, 300.0)]  # fmt: skip
    sums = imm.sums_of(means, float(rng.integers(0, 17)))
    return off, sums, rng.choice([-1e3, 0.0, 30.0, 1e3], 3)


def judge(train, off, sums, bursts):
    """One block of its only motor."""
    motor = train.motors[0]
    motor["started"], motor["off_k"], motor["inputs"], motor["bursts"] = 1, off, sums[0], bursts
    train.record["waiting"] = 1
    train.judge(1)
    return motor


def test_20_000_hostile_blocks_leave_probabilities_and_covariances():
    rng = np.random.default_rng(1)
    one = train(1)
    for k in range(20_000):
        was, loose = bool(one.motors["held"][0]), one.motors["loose"][0].copy()
        block = hostile(rng, k)
        motor = judge(one, *block)
        begin, end = DT / monitor.LOOSE_BEGIN_S, DT / monitor.LOOSE_END_S
        now = loose * (1.0 - end) + (1.0 - loose) * begin
        odds = now / (1.0 - now) * np.exp(np.clip(block[2], -50.0, 50.0))
        np.testing.assert_allclose(motor["loose"], np.minimum(odds / (1.0 + odds), 0.95))
        assert math.isfinite(motor["size_k"] + motor["log_likelihood"]), k
        ill, held, kind, own = (
            motor["fault_probability"], bool(motor["held"]), motor["kind"], motor["imm"]
        )  # fmt: skip
        assert 0.0 <= ill <= 1.0
        assert held == (ill > (0.3 if was else 0.9))
        assert abs(own["mode"].sum() - 1.0) < 1e-9
        assert own["mode"].min() > 0.0
        assert kind.min() >= 0.0
        assert kind.sum() <= 1.0 + 1e-12
        assert (kind.sum() > 0.5) == held
        parts = (own["mean"], own["cov"], motor["base_k"], motor["loose"])
        assert all(np.isfinite(part).all() for part in parts)
        if k % 100 == 0:
            cov = own["cov"]
            np.testing.assert_allclose(cov, cov.transpose(0, 2, 1), rtol=1e-9, atol=1e-12)
            values = np.linalg.eigvalsh(cov)
            assert (values[:, 0] >= -1e-7 * values[:, -1]).all(), k
    calm = imm.sums_of((2e4, 200.0, 0.03, 0.08, 30.0), 16.0)
    for _ in range(2000):
        motor = judge(one, 0.02 * rng.standard_normal(3), calm, np.full(3, -0.16))
    assert motor["kind"].sum() < 0.5, "it recovers"


def test_lumps_begin_as_the_model_says_and_with_whatever_is_there():
    rng = np.random.default_rng(2)
    for _ in range(20):
        p = model.TYPICAL * np.exp(0.3 * rng.standard_normal(model.COUNT))
        p[model.OFFSETS] = rng.standard_normal(3)
        readings, x = rng.uniform(20.0, 120.0, 3), np.empty(5)
        assert imm.start(p, readings, 0.0, 12.0, x)
        (want,) = model.initial_state(p[None], readings[None], 12.0)
        np.testing.assert_allclose(x, want, rtol=1e-12)
        for gone in range(3):
            less = readings.copy()
            less[gone] = np.nan
            assert imm.start(p, less, 0.0, 12.0, x)
            assert np.isfinite(x).all()
            seen = x[list(model.MEASURED)] + p[model.OFFSETS]
            np.testing.assert_allclose(np.delete(seen, gone), np.delete(readings, gone))
        alone = np.array([readings[0], np.nan, np.nan])
        assert imm.start(p, alone, 0.0, 12.0, x)
        assert x[1] == pytest.approx(0.5 * (x[0] + x[2]))
        assert x[2] == pytest.approx(0.5 * (x[0] + 12.0)), "half way to the air"
        kept = x.copy()
        assert not imm.start(p, np.full(3, np.nan), 0.0, 12.0, x)
        np.testing.assert_array_equal(x, kept)


def test_a_motor_without_any_reading_starts_with_its_first_one():
    one, inputs = train(1), (np.full(1, 2e4), np.full(1, 200.0), np.full(1, 12.0))
    one.add_sample(np.full((1, 3), np.nan), *inputs)
    assert not one.motors["started"].any()
    one.add_sample(np.full((1, 3), 40.0), *inputs)
    assert one.motors["started"].all()


def evidence(far, near):
    loose, good = monitor.LOOSE_SHARE, monitor.GOOD_SHARE
    ratio = far * math.log(loose / good) + near * math.log((1.0 - loose) / (1.0 - good))
    return ratio / monitor.BURST_LENGTH


def closed(blocks):
    """Log odds of one sensor's blocks (B, K), one after the other; its neighbours read higher."""
    one, out = train(1, samples=blocks.shape[1]), []
    for block in blocks:
        each = block + 7.0 * np.arange(3)[:, None]
        one.motors["raw"][0, :, : one.block] = one.motors["block"][0, :, : one.block] = each
        lib.thermal_monitor_close_block(one.pointer)
        one.record["waiting"] = 0
        out.append(one.motors["bursts"][0, 0])
    return out


@pytest.mark.parametrize("together", [16, 8, 4])
@pytest.mark.parametrize("first", range(16, 33))
def test_a_burst_counts_once_wherever_a_block_ends_and_a_step_does_not(first, together):
    """Even if it fills most of a block, or more than one."""
    quiet = np.full((64 // together, together), 0.1)
    rest = 4 * 16 - 5
    for size in (20.0, -5.0):
        burst = quiet.copy()
        burst.ravel()[first : first + 5] += size
        assert sum(closed(burst)) == pytest.approx(evidence(5, rest)), size
        step = quiet.copy()
        step.ravel()[first:] += size
        assert max(closed(step)) <= 0.0, size


def test_a_departure_of_twenty_readings_is_bursts_and_a_longer_one_is_a_new_level():
    for away, odd, near in ((20, 20, 44), (21, 0, 43)):
        readings = np.zeros((8, 8))
        readings.ravel()[16 : 16 + away] = 9.0
        assert sum(closed(readings)) == pytest.approx(evidence(odd, near)), away
    readings = np.zeros((10, 8))
    readings[2:] = 9.0
    readings[6, :5] = 0.0
    says = closed(readings)
    assert says[2:5] == pytest.approx([0.0] * 3), "it may still come back"
    assert says[5] == pytest.approx(evidence(0, 8)), "it stays"
    assert says[6] == pytest.approx(evidence(5, 3)), "a burst from the new level"


def test_a_sensor_is_back_within_half_of_what_is_far():
    noise = train(1).known_motors["noise_k"].item(0)
    assert monitor.FAR_SIGMA * noise < monitor.FAR_K
    for back, odd in ((1.45, 5), (1.55, 0), (2.95, 0)):
        readings = np.zeros((2, 16))
        readings[1, 7:12], readings[1, 12:] = 8.0, back
        assert closed(readings)[1] == pytest.approx(evidence(odd, 11 if odd else 7)), back


def test_a_level_that_drifts_is_followed():
    drift = np.arange(320.0).reshape(20, 16) * 0.05
    assert sum(closed(drift)) == pytest.approx(evidence(0, 320))


def test_without_readings_a_block_says_nothing_and_with_half_of_them_it_has_a_median():
    blocks = np.full((3, 16), np.nan)
    blocks[1, 7] = 1.0
    np.testing.assert_array_equal(closed(blocks), [np.nan, np.nan, np.nan])
    one = train(1)
    one.config["block"] = 15
    for readings, median in ((8, 2.0), (7, np.nan)):
        one.motors["block"][0, 0, :readings], one.motors["block"][0, 0, readings:] = 2.0, np.nan
        lib.thermal_monitor_close_block(one.pointer)
        np.testing.assert_equal(one.motors["middle_k"][0, 0], median)


def test_what_changes_in_all_others_may_change_by_a_tenth_less_or_more_in_a_motor():
    fleet, level = levels()
    before = fleet.motors["imm"]["cov"].copy()
    fleet.motors["block"][:, :, :16] = level[:, :, None] - 5.0
    lib.thermal_monitor_close_block(fleet.pointer)
    want = np.zeros(12)
    want[list(model.MEASURED)] = 0.5**2
    got = fleet.motors["imm"]["cov"] - before
    np.testing.assert_allclose(got, np.tile(np.diag(want), (4, imm.MODES, 1, 1)), atol=1e-9)


def test_who_is_compared_with_others_than_before_may_stand_as_much_elsewhere():
    fleet, level = levels()
    before, fleet.motors["held"][3] = fleet.motors["imm"]["cov"].copy(), True
    lib.thermal_monitor_close_block(fleet.pointer)
    for m in range(4):
        every = [n for n in range(4) if n != m]
        medians = [np.median(level[some], axis=0) for some in (every, [n for n in every if n < 3])]
        want = np.zeros(12)
        want[list(model.MEASURED)] = (medians[1] - medians[0]) ** 2
        got = fleet.motors["imm"]["cov"][m] - before[m]
        np.testing.assert_allclose(got, np.tile(np.diag(want), (imm.MODES, 1, 1)), atol=1e-9)
        assert want.any() == (m < 3)


def levels():
    """Four motors in their first block, each off its model in its own way; (4, 3) K by how far."""
    fleet, level = train(4), np.random.default_rng(6).standard_normal((4, 3))
    fleet.motors["block"][:, :, :16] = level[:, :, None]
    lib.thermal_monitor_close_block(fleet.pointer)
    fleet.motors["judged"] = 1
    return fleet, level


def test_while_a_sensor_is_tested_for_a_step_the_others_are_compared_with_its_last_value():
    fleet, _ = levels()
    off, cov = fleet.motors["off_k"].copy(), fleet.motors["imm"]["cov"].copy()
    fleet.motors["step"]["since"][3, 0] = 0
    fleet.motors["block"][3, 0] = np.nan
    for _ in range(int(60 // DT)):
        lib.thermal_monitor_close_block(fleet.pointer)
        np.testing.assert_array_equal(fleet.motors["off_k"][:3], off[:3])
        np.testing.assert_array_equal(fleet.motors["off_k"][3], [np.nan, *off[3, 1:]])
        np.testing.assert_array_equal(fleet.motors["imm"]["cov"], cov)
    lib.thermal_monitor_close_block(fleet.pointer)
    assert (fleet.motors["off_k"][:3, 0] != off[:3, 0]).all(), "it has been away for too long"


@pytest.mark.parametrize("returns", [False, True])
def test_beside_a_sensor_that_goes_or_comes_the_others_may_stand_elsewhere(returns):
    fleet, level = levels()
    values = fleet.motors["block"][3, 0].copy()
    before = fleet.motors["imm"]["cov"].copy()
    fleet.motors["block"][3, 0] = np.nan
    lib.thermal_monitor_close_block(fleet.pointer)
    if returns:
        before, fleet.motors["block"][3, 0] = fleet.motors["imm"]["cov"].copy(), values
        lib.thermal_monitor_close_block(fleet.pointer)
    winding = model.MEASURED[0]
    for m in range(3):
        every = [n for n in range(4) if n != m]
        shift = np.median(level[every, 0]) - np.median(level[[n for n in every if n < 3], 0])
        got = fleet.motors["imm"]["cov"][m] - before[m]
        want = np.zeros((12, 12))
        want[winding, winding] = shift**2
        np.testing.assert_allclose(got, np.tile(want, (imm.MODES, 1, 1)), atol=1e-9)


def test_beside_a_motor_that_has_started_anew_the_others_may_stand_elsewhere():
    fleet, level = levels()
    before = fleet.motors["imm"]["cov"].copy()
    fleet.motors["judged"][3] = 0
    fleet.motors["block"][3, 0, :16] = level[3, 0] + 9.0
    lib.thermal_monitor_close_block(fleet.pointer)
    changed = np.array([*level[:3, 0], level[3, 0] + 9.0])
    for m in range(3):
        every = [n for n in range(4) if n != m]
        shift = np.median(changed[every]) - np.median(level[every, 0])
        got = fleet.motors["imm"]["cov"][m, 0] - before[m, 0]
        assert got[model.MEASURED[0], model.MEASURED[0]] == pytest.approx(shift**2)


def surroundings(one, sums):
    out = np.zeros(1, records.IMM_SURROUNDINGS)
    lib.thermal_surroundings(
        pointer("struct thermal_config", one.config),
        pointer("struct thermal_parameters", one.known_motors["model"].copy()),
        pointer("struct thermal_sums", sums), pointer("struct imm_surroundings", out),
    )  # fmt: skip
    return out


@pytest.mark.parametrize("means", [(3e4, 150.0, 0.05, 0.1, 20.0), (1e4, 300.0, 0.02, 0.04, 1.0)])
def test_a_disturbance_and_a_fault_heat_the_lumps_that_they_come_into(means):
    one, p = train(1), model.TYPICAL
    square, speed, cooling, copper, rise = means
    around, config = surroundings(one, imm.sums_of(means, 7.0))[0], one.config[0]
    pushes, heats = np.zeros((5, 5)), np.zeros((5, 5))
    pushes[0, 0], pushes[2, 2] = copper, cooling
    pushes[2:, 1] = p[model.H_0] + p[model.H_1] * speed, p[model.B_D], p[model.B_N]
    pushes[3, 3], pushes[4, 4] = p[model.F_D] * speed, p[model.F_N] * speed
    turns = speed / config["duty_speed"]
    relative = 1.0, cooling / config["duty_cooling"], turns, turns, copper / config["duty_copper"]
    where = [0, 2, 3, 4, 0]
    heats[range(5), where] = relative / config["settles_k"][where]
    np.testing.assert_allclose(around["pushes"], pushes)
    np.testing.assert_allclose(around["heats"], heats)
    np.testing.assert_allclose(around["rates"], model.system_matrix(p, square, speed))
    assert around["rise_k"] == max(rise, model.LEAST_RISE_K)


def test_a_likelihood_is_that_of_the_blocks_after_the_first():
    one, rng = train(1), np.random.default_rng(8)
    off, sums = rng.normal(0.0, 0.2, (6, 1, 3)), imm.sums_of((2e4, 200.0, 0.03, 0.08, 30.0), 16.0)
    config = one.config["imm"].copy()
    config["modes"] = 1
    own, noise = imm.started(config), one.known_motors["block_noise_k"].item()
    says = [imm.advance(config, surroundings(one, sums), y[0], noise, own) for y in off]
    assert one.likelihood(off, np.tile(sums, (6, 1))) == pytest.approx(sum(says[1:]))


def test_the_probabilities_of_a_motor_are_kept_while_it_is_parked():
    one, stopped = train(1), np.linspace(0.19, 0.01, imm.MODES)
    for speed, parked_s in ((200.0, 0.0), (0.0, 700.0)):
        one.motors["driven_mode"], one.motors["parked_s"] = stopped, parked_s
        sums = imm.sums_of((0.0, speed, 0.0, 0.0, 30.0), 16.0)
        motor = judge(one, np.full(3, 0.3), sums, np.zeros(3))
        np.testing.assert_array_equal(motor["imm"]["mode"], motor["driven_mode"])
        assert (motor["driven_mode"][0] == stopped[0]) == (speed == 0.0)


def test_behind_the_kinds_of_the_last_motor_nothing_is_written():
    one, kind = train(1), np.full(12, 7.0)
    one.motors["kind"], one.motors["step"]["offset_k"] = 1.0, [[0.0, 3.0, 0.0]]
    lib.thermal_kinds(pointer("struct thermal_motor", one.motors), 1, pointer("double", kind))
    assert kind[:11].sum() == pytest.approx(1.0 - 1e-6)
    assert kind[11] == 7.0


@pytest.mark.parametrize("held", [False, True])
def test_beside_a_step_a_fault_counts_only_if_it_is_reported(held):
    """A sensor that has stepped is named: that heat is hardly likely makes nobody doubt it."""
    one = train(1)
    one.motors["kind"][:, 2], one.motors["held"] = 0.6 if held else 0.02, held
    before = one.kinds()[0][0]
    assert before[2] == pytest.approx(0.6 if held else 0.02)
    one.motors["step"]["offset_k"] = [[0.0, 3.0, 0.0]]
    kind = one.kinds()[0][0]
    assert (kind[2] > 0.3) == held
    assert kind[6] > (0.6 if held else 0.999)
    assert side(kind) == (0 if held else -1)


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
    fleet = train(motors)
    fleet.motors["raw"][:, :, :together], fleet.motors["block"][:, :, :together] = raw, block
    fleet.motors["base_k"], fleet.motors["held"] = base, np.arange(motors) == 1
    lib.thermal_monitor_close_block(fleet.pointer)
    middle, off, odds = (fleet.motors[name] for name in ("middle_k", "off_k", "bursts"))
    want = np.nanmedian(block, axis=2)
    want[2, 1] = np.nan
    np.testing.assert_array_equal(middle, want)
    u = want - base
    for m in range(motors):
        others = [n for n in range(motors) if n not in (m, 1)]
        np.testing.assert_allclose(off[m], u[m] - np.nanmedian(u[others], axis=0), atol=1e-12)
    far = (np.abs(raw - np.nanmedian(raw, axis=2)[:, :, None]) > monitor.FAR_K).sum(axis=2)
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
