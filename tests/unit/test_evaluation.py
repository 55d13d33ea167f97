"""Judging detectors: counts on hand-made tracks, and the whole command on a seed or two."""

import csv
import math

import numpy as np
import pytest

from dbc.frame import Frame
from gateway.cli import main
from gateway.core.codes import Flag
from gateway.reports.scoring import Score, Truth, everyone, quantile, score_flag
from gateway.settings.config import ConfigError
from gateway.study.evaluation import (
    LEVELS,
    Estimates,
    GatewayOutput,
    listen,
    measure,
    pooled,
    reliability,
    roc,
)
from gateway.study.evaluation_runs import Plan, evaluate, fitted, one_run, record, seeds_of
from gateway.study.scenarios_family import DEVELOPMENT, REPORTING, draw
from tests.simrun import Flags, codec

T = np.arange(300) / 100


def truth(*losses, depth=1.0, cuts=()):
    """300 rows every 10 ms; losses, and times in which a drive cuts: (first row, last row + 1)."""
    lost = np.zeros(300, bool)
    for first, last in losses:
        lost[first:last] = True
    cut = np.zeros(300, bool)
    for first, last in cuts:
        cut[first:last] = True
    return Truth(T, lost, np.where(lost, depth, 0.0), cut)


def flags(*raised, otherwise=Flag.GOOD):
    out = np.full(300, int(otherwise))
    for first, last in raised:
        out[first:last] = Flag.BAD
    return out


def test_a_flag_that_stays_while_the_drive_gives_torque_back_is_false_and_counted_by_itself():
    score = score_flag(truth((100, 150), cuts=[(150, 170)]), T, flags((100, 180)))
    assert (score.false_positive, score.cut) == (27, 17)
    assert score.f1 < score.uncut_f1 < 1.0
    alike = score_flag(truth((100, 150)), T, flags((100, 180)))
    assert (alike.cut, alike.uncut_f1) == (0, alike.f1)


def test_a_perfect_flag_with_30_ms_delay():
    score = score_flag(truth((100, 150)), T, flags((103, 153)))
    assert score == Score(
        true_positive=45, good=195, healthy=195, delays_ms=(pytest.approx(30.0),),
        abrupt_ms=(pytest.approx(30.0),), train_s=pytest.approx(1.95),
    )  # fmt: skip
    assert (score.f1, score.precision, score.recall) == (1.0, 1.0, 1.0)


def test_false_alarms_are_stretches_that_touch_no_loss():
    # Before the start counts, late clearing and an early start within the edge; two are false.
    raised = flags((10, 20), (60, 70), (98, 149), (149, 170), (200, 205), (299, 300))
    score = score_flag(truth((100, 150)), T, raised)
    assert score.alarms == 3
    assert score.false_positive == 10 + 17 + 5 + 1
    assert score.precision == pytest.approx(45 / (45 + 33))
    assert score.alarms_per_hour == pytest.approx(3 * 3600 / 1.95)


def test_adhering_later_than_100_ms_after_each_onset_is_dangerous_and_unknown_is_not():
    two = truth((100, 150), (200, 250))
    late = score_flag(two, T, flags())  # of each loss 1.11 to 1.47 s of 1.03 to 1.47 s
    assert (late.dangerous, late.false_negative) == (2 * 37, 2 * 45)
    assert late.dangerous_share == pytest.approx(37 / 45)
    assert score_flag(two, T, flags((110, 150), (210, 250))).dangerous == 0
    assert score_flag(two, T, flags(otherwise=Flag.UNKNOWN)).dangerous == 0
    assert score_flag(truth(), T, flags()).dangerous_share == 0.0


def test_unknown_counts_as_not_raised_and_is_reported():
    score = score_flag(truth((100, 150)), T, flags(otherwise=Flag.UNKNOWN))
    assert (score.true_positive, score.false_negative, score.false_positive) == (0, 45, 0)
    assert (score.f1, score.good_share, score.unknown_share) == (0.0, 0.0, 1.0)
    assert (score.missed, score.losses, score.delays_ms) == (1, 1, ())
    always = score_flag(truth((100, 150)), T, flags(otherwise=Flag.BAD))
    assert always.false_positive == always.healthy > 0


def test_shallow_stretches_are_left_out_and_short_ones_are_edges():
    # Grows over half a second; below 20 % for the first 100 ms.
    slow = truth((100, 200))
    slow.depth[100:150] = np.linspace(0.02, 1.0, 50)
    missed = score_flag(slow, T, flags())
    counted = slow.counted(T)
    assert not counted[98:112].any()
    assert counted[112:198].all()
    assert missed.false_negative == 198 - 112
    assert missed.healthy == (98 - 50) + (300 - 203)
    # The same within 20 ms changes nothing beside the usual 30 ms.
    quick = truth((100, 200))
    quick.depth[100:102] = 0.1
    assert quick.counted(T)[103:198].all()
    # A rail that carries nearly all is neither a loss nor a miss.
    nearly = score_flag(truth((100, 200), depth=0.1), T, flags((100, 200)))
    assert (nearly.losses, nearly.true_positive, nearly.false_positive, nearly.alarms) == (0,) * 4


def test_abrupt_losses_take_half_within_20_ms():
    gentle = truth((100, 200))
    gentle.depth[100:110] = np.linspace(0.0, 1.0, 10)
    assert score_flag(gentle, T, flags((104, 200))).abrupt_ms == ()
    assert score_flag(truth((100, 200), depth=0.4), T, flags((104, 200))).abrupt_ms == ()
    assert score_flag(truth((100, 200), depth=0.6), T, flags((104, 200))).abrupt_ms == (
        pytest.approx(40.0),
    )


def test_a_loss_that_lasts_to_the_end_has_no_second_edge():
    score = score_flag(truth((250, 300)), T, flags((250, 300)))
    assert (score.true_positive, score.false_negative, score.losses) == (47, 0, 1)


def test_scores_add_up():
    one = score_flag(truth((100, 150)), T, flags((103, 153)))
    two = score_flag(truth((100, 150)), T, flags((60, 62)))
    both = one.plus(two)
    assert both.healthy == one.healthy + two.healthy
    assert both.delays_ms == one.delays_ms
    assert (both.missed, both.losses, both.alarms) == (1, 2, 1)
    assert both.f1 == pytest.approx(2 * 45 / (2 * 45 + 2 + 45))


def test_quantiles():
    assert quantile((), 0.5) == math.inf
    assert quantile((3.0, 1.0, 2.0), 0.5) == 2.0
    assert quantile(tuple(range(10)), 0.9) == 9
    assert quantile((5.0,), 0.9) == 5.0


def test_all_together_is_where_everyone_is_lost():
    both = everyone([truth((100, 150)), truth((120, 170), depth=0.5)])
    assert both.losses() == [(120, 150)]
    assert both.depth[130] == 0.5


def test_roc_of_a_perfect_and_a_blind_detector():
    levels = np.zeros((2, LEVELS), int)
    levels[0, 0], levels[1, 200] = 70, 30
    assert roc(levels).area == 1.0
    levels[:] = 1
    assert roc(levels).area == pytest.approx(0.5)
    curve = roc(levels)
    assert (curve.true_rate[0], curve.true_rate[-1]) == (0.0, 1.0)
    assert (curve.threshold[1], curve.threshold[-1]) == (1.0, 0.0)
    assert np.all(np.diff(curve.true_rate) >= 0.0)
    levels[1] = 0
    assert math.isnan(roc(levels).area)


def test_roc_is_the_share_at_or_above_each_threshold():
    rng = np.random.default_rng(1)
    levels = rng.integers(0, 20, (2, LEVELS))
    curve = roc(levels)
    for k in (1, 50, 120, 201):
        above = np.arange(LEVELS) / 200 >= curve.threshold[k] - 1e-12
        assert curve.true_rate[k] == pytest.approx(levels[1, above].sum() / levels[1].sum())
        assert curve.false_rate[k] == pytest.approx(levels[0, above].sum() / levels[0].sum())


def test_reliability_bins_and_error():
    levels = np.zeros((2, LEVELS), int)
    levels[:, 30] = 85, 15  # said 15 %, true 15 %
    levels[:, 180] = 50, 50  # said 90 %, true 50 %
    levels[1, 200] = 100  # said 100 %, true 100 %: with the 90 % in the last bin
    found = reliability(levels)
    assert found.frames.tolist() == [0, 100, 0, 0, 0, 0, 0, 0, 0, 200]
    assert found.predicted[1] == pytest.approx(0.15)
    assert found.true[1] == pytest.approx(0.15)
    assert found.predicted[9] == pytest.approx(0.95)
    assert found.true[9] == pytest.approx(0.75)
    assert found.error == pytest.approx(0.2 * 200 / 300)
    assert math.isnan(reliability(np.zeros((2, LEVELS), int)).error)


class Row:
    def __init__(self, k, drive, lost, load=10.0):
        self.t_s, self.drive, self.lost, self.load_nm = k / 100, drive, lost, load
        self.depth = float(lost)


def test_measure_reads_probability_load_and_common_mode():
    rows = [Row(k, d, 100 <= k < 150) for k in range(300) for d in (1, 2)]
    chance = np.where((T >= 1.0) & (T < 1.5), 0.9, 0.1)
    chance[200:210] = np.nan
    load = np.full(300, 11.0)
    load[:50] = 99.0  # before the start counts
    load[100:103] = 99.0  # an edge
    load[250:] = np.nan
    output = GatewayOutput(
        T,
        np.column_stack([flags((103, 153)), flags((103, 153))]),
        flags((106, 150)),
        (Estimates(T, chance, load),) * 2,
    )
    found = measure(rows, output, (1, 2))
    assert found.flags.true_positive == 90
    assert found.flags.train_s == pytest.approx(1.95)
    assert (found.common.delays_ms, found.common.f1) == ((pytest.approx(60.0),), 84 / 87)
    assert found.levels[1, 180] == 90
    assert found.levels[0, 20] == 2 * (195 - 10)
    assert found.load_rmse_nm == pytest.approx(1.0)
    assert pooled([found, found]).levels[1, 180] == 180
    alone = measure([r for r in rows if r.drive == 1], output, (1,))
    assert alone.common == Score()


def test_listen_decodes_what_the_gateway_sends():
    c = codec()
    estimate = c.by_name["Drive2_Estimate"]
    frames = [Flags().frame(10_000_000, Adhesion1=1, Adhesion2=2, Adhesion3=3, CommonMode=2)]
    frames += [
        Frame(20_000_000, estimate.can_id, bytes(c.encode(estimate, values)))
        for values in (
            {"Health": 2, "LoadTorque": 12.5, "LossProbability": 40.0},
            {"Health": 1, "LoadTorque": 12.5, "LossProbability": None},
        )
    ]
    output = listen(frames, c, (1, 2, 3))
    assert output.t_s.tolist() == [0.01]
    assert output.flags.tolist() == [[Flag.GOOD, Flag.BAD, Flag.UNKNOWN]]
    assert output.common.tolist() == [Flag.BAD]
    np.testing.assert_array_equal(output.estimates[1].probability, [0.4, np.nan])
    np.testing.assert_array_equal(output.estimates[1].load_nm, [12.5, np.nan])
    assert len(output.estimates[0].t_s) == 0


def test_seeds_for_tuning_and_reporting_are_apart():
    assert not set(DEVELOPMENT) & set(REPORTING)
    assert seeds_of("development") == tuple(DEVELOPMENT)
    assert seeds_of("reporting") == tuple(REPORTING)
    assert seeds_of("7-9") == (7, 8, 9)
    assert seeds_of("7") == (7,)
    for wrong in ("1000-1001", "990-1000", "1059", "9-7", "x", "", "-3", "1-", "1-2-3"):
        with pytest.raises(ConfigError):
            seeds_of(wrong)


def test_a_recording_serves_every_detector_and_repeats():
    plan = Plan(("n2",), ("vb", "median"), (3,))
    first = one_run(plan, "n2", 3)
    again = one_run(plan._replace(detectors=("median",)), "n2", 3)
    assert len(first) == 2
    assert first[1].flags == again[0].flags
    np.testing.assert_array_equal(first[1].levels, again[0].levels)
    assert first[0].flags.losses == 1
    assert first[0].flags.f1 > 0.9
    assert first[0].load_rmse_nm < 2.0


def test_the_configuration_keeps_the_data_sheet():
    scenario = draw("large", 0)
    config, c = fitted(Plan((), ("vb",), ()), "vb", scenario)
    motor = config.motors[config.drive[0].motor]
    assert (motor.T_rated, motor.pole_pairs) == (796.0, 2)
    assert len(config.nodes) == scenario.drives
    assert len(record(scenario.model_copy(update={"duration_s": 0.05}), config, c).blocks) == 6


def test_processes_give_the_same_in_the_same_order():
    plan = Plan(("n1",), ("vb",), (0, 1))
    seen = []
    alone = evaluate(plan, 1, lambda: seen.append("run"), lambda name, _s: seen.append(name))
    assert seen == ["run", "run", "n1"]
    both = evaluate(plan, 2)
    assert [run.flags for run in alone[0].runs] == [run.flags for run in both[0].runs]


def test_the_command_end_to_end(tmp_path, capsys):
    words = ["evaluate", "--seeds", "2", "--family", "n2", "healthy_rough", "--detector", "vb",
             "nonsense", "-o", str(tmp_path / "out")]  # fmt: skip
    assert main(words) == 0
    out, err = capsys.readouterr()
    lines = out.splitlines()
    assert [line.split(" | ")[0] for line in lines[2:]] == ["| n2", "| healthy_rough"]
    assert "left out: nonsense: no such detector" in " ".join(err.split())
    assert "n2: " in err
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {
        "evaluation.md", "evaluation.csv", "runs.csv", "roc.csv", "reliability.csv", "roc.png",
        "roc.svg", "reliability.png", "reliability.svg",
    }  # fmt: skip
    assert out.strip() in (tmp_path / "out" / "evaluation.md").read_text()
    with (tmp_path / "out" / "evaluation.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["family"] for row in rows] == ["n2", "healthy_rough"]
    assert rows[0]["losses"] == "1"
    assert rows[1]["F1"] == ""
    assert float(rows[1]["unknown %"]) + float(rows[1]["adhering %"]) <= 100.0
    with (tmp_path / "out" / "runs.csv").open() as file:
        assert [row["seed"] for row in csv.DictReader(file)] == ["2", "2"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--family", "nonsense"], "no family 'nonsense'; there are single, majority"),
        (["--motor", "nonsense"], "no motor 'nonsense'"),
        (["--motor", "large", "--family", "n1"], "no [motor.large]"),
        (["--seeds", "1000-1001"], "kept for reporting"),
        (["--detector", "nonsense"], "no such detector"),
        (["--dbc", "nonsense.dbc", "--family", "n1"], "nonsense.dbc"),
    ],
)
def test_what_cannot_be_evaluated_is_said_in_one_line(words, message, capsys):
    assert main(["evaluate", *words]) == 2
    err = capsys.readouterr().err.strip().splitlines()
    assert len(err) == 1
    assert message in err[0]
