"""Labelled trains, scores, and the benchmark of thermal methods."""

import math
import re

import numpy as np
import pytest

from gateway.cli import main
from gateway.commands import reproduce_thermal
from gateway.study.thermal_dataset import BENCH, DAYS, KINDS, SENSOR_KINDS, SIZE_K, train
from gateway.study.thermal_heat import MOTORS
from gateway.study.thermal_other import train as other_train
from gateway.study.thermal_report import FIGURES, PRINTED, Outcome, markdown, rows, verdict
from gateway.study.thermal_scores import (
    COLUMNS,
    Diagnosis,
    Truth,
    cells,
    mean,
    score_alarms,
    spread,
    table_of,
)
from gateway.study.thermal_trials import FIT_RUNS, REPORTING, UNDECIDED, Trial, confused, trials


def effect_of(run, kind):
    """(K, 3) of a fault while it lasts, K: there is none before, elsewhere or in other motors."""
    fault = run.fault
    assert fault is not None
    assert not run.effect[: fault.begin].any()
    assert not np.delete(run.effect, fault.motor, axis=1).any()
    own = np.abs(run.effect[fault.begin : fault.end, fault.motor])
    assert own.max() > 1.0
    if kind in SENSOR_KINDS:
        assert not np.delete(own, fault.point, axis=1).any()
    return own


@pytest.mark.parametrize("base", [DAYS, BENCH])
@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_is_where_and_when_it_is_said_to_be(base, kind):
    run = train(4, base, kind, 2)
    fault, own = run.fault, effect_of(run, kind)
    if kind not in SENSOR_KINDS and base is DAYS:
        # Of the size drawn, at the mean duty.
        assert own.mean(axis=0).max() == pytest.approx(fault.size_k, rel=0.35)
        assert SIZE_K[0] <= fault.size_k <= SIZE_K[1]


def test_a_train_is_a_pure_function_and_its_motors_stay():
    first, again = train(7, BENCH, "bearing", 1), train(7, BENCH, "bearing", 1)
    for mine, theirs in zip(first[:8], again[:8], strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert first.fault == again.fault
    other = train(7, BENCH, None, 2)
    assert not np.array_equal(other.speed, first.speed)
    ratio = first.current_square[100] / first.current_square[100, 0]
    busy = np.flatnonzero(other.current_square[:, 0])[0]
    np.testing.assert_allclose(other.current_square[busy] / other.current_square[busy, 0], ratio)
    assert first.temperature.shape == (BENCH.samples, MOTORS, 3)


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_of_the_other_world_is_where_it_is_said_to_be(kind):
    run = other_train(9, BENCH, kind, 6)
    own = effect_of(run, kind)
    if kind not in SENSOR_KINDS:
        assert own.max() == pytest.approx(run.fault.size_k, rel=0.1)
    again = other_train(9, BENCH, kind, 6)
    np.testing.assert_array_equal(run.temperature, again.temperature)


def test_trains_of_the_other_world_differ_in_structure():
    runs = [other_train(seed, BENCH, None) for seed in range(10)]
    assert len({run.temperature.shape[1] for run in runs}) >= 4, "1 to 16 motors"
    assert all(np.isfinite(run.temperature).all() for run in runs)
    assert all(run.temperature.max() < 180.0 for run in runs), "as warm as motors in service"
    with pytest.raises(ValueError, match="bench"):
        other_train(0, DAYS, None)


def test_heat_called_a_sensor_is_confused():
    healthy = score_alarms(np.zeros(20), 0.0, truth(np.zeros(20), motor=-1))
    found = [
        Trial(1, "bearing", "model", healthy, {"sensor_bias": 10, "bearing": 60, UNDECIDED: 20}),
        Trial(1, "sensor_bias", "model", healthy, {"intermittent": 30}),
    ]
    assert confused(found) == (pytest.approx(0.1), pytest.approx(20 / 120))


def truth(faulty, effect=None, motor=1):
    faulty = np.array(faulty, dtype=bool)
    effect = np.where(faulty, 5.0, 0.0) if effect is None else np.array(effect)
    return Truth(faulty, effect, motor, int(np.argmax(faulty)), 10.0)


def test_scores_by_hand():
    statistic = np.array([0.0, 2.0, 0.0, np.nan, 0.0, 3.0, 4.0, 5.0, 0.0, 0.0])
    t = truth([0, 0, 0, 0, 1, 1, 1, 1, 0, 0], [0, 0, 0, 0, 1.0, 5, 5, 5, 1.5, 0])
    diagnosis = Diagnosis(
        np.array([0, 2, 0, 0, 0, 1, 1, 2, 0, 0]), np.array([0, 0, 0, 0, 0, 1, 0, 1, 0, 0]) > 0
    )
    s = score_alarms(statistic, 1.0, t, diagnosis)
    assert s.accuracy == 0.8
    assert s.fpr == pytest.approx(1 / 6)
    assert s.fnr == 0.25
    assert s.graced_fnr == 0.0, "nobody can know while the effect is 1 K"
    assert s.graced_fpr == pytest.approx(1 / 5)
    assert s.delay_s == 10.0
    assert s.found == 1.0
    assert s.motor_right == pytest.approx(2 / 3)
    assert s.kind_right == pytest.approx(2 / 3)
    assert s.best_accuracy == 0.9
    assert s.episodes == pytest.approx(1 / (6 * 10.0 / 86_400.0))


def test_accuracy_lies_between_and_hindsight_is_never_worse():
    """Why the paper's 94.4 / 2.75 / 4.44 cannot be: accuracy is a mean of 1 - FPR and 1 - FNR."""
    rng = np.random.default_rng(0)
    for _ in range(200):
        faulty = rng.random(60) < rng.uniform(0.1, 0.9)
        if faulty.all() or not faulty.any():
            continue
        s = score_alarms(np.round(rng.normal(size=60) + faulty, 1), 0.5, truth(faulty))
        low, high = sorted((1.0 - s.fpr, 1.0 - s.fnr))
        assert low - 1e-12 <= s.accuracy <= high + 1e-12
        assert s.best_accuracy >= s.accuracy
    assert not 1.0 - 0.0444 <= 0.944 <= 1.0 - 0.0275


def test_a_healthy_run_has_no_misses():
    s = score_alarms(np.zeros(20), 0.0, truth(np.zeros(20), motor=-1))
    assert s.accuracy == 1.0
    assert s.fpr == 0.0
    assert all(math.isnan(v) for v in (s.fnr, s.found, s.delay_s, s.best_fnr))
    both = mean([s, score_alarms(np.ones(20), 0.0, truth([0] * 10 + [1] * 10))])
    assert both.fnr == 0.0, "the mean of the runs that have one"
    assert spread([s, s]).accuracy == 0.0
    line = cells("model", "none", [s])
    assert line[:4] == ["model", "none", "1", "100.0"]
    assert table_of(COLUMNS, [line]).count("\n") == 2


@pytest.mark.parametrize("seeds", [(1,), pytest.param((1, 3), marks=pytest.mark.thorough)])
def test_the_model_beats_the_papers_method(seeds):
    """Development seeds: the whole chain from train to score."""
    kinds = ("overheating", "sensor_bias", "none")
    found = [t for seed in seeds for t in trials(seed, "days", kinds, ("model", "paper_causal"))]
    assert len(found) == len(seeds) * len(kinds) * 2
    by = {m: mean(t.score for t in found if t.method == m) for m in ("model", "paper_causal")}
    assert by["model"].accuracy > 0.95
    assert by["model"].accuracy > by["paper_causal"].accuracy + 0.05
    assert by["model"].motor_right > 0.95
    assert by["model"].kind_right > 0.5, "hours apart a sensor that reads high is seldom named"
    diagnosis = [(t.kind, name) for t in found for name, n in t.named.items() if n]
    assert ("overheating", "overheating") in diagnosis
    assert not [pair for pair in diagnosis if pair[1] not in (pair[0], UNDECIDED)]
    assert FIT_RUNS["days"] == 1


def test_the_command(capsys, tmp_path):
    words = [
        "evaluate", "thermal", "--seeds", "2", "--kind", "bearing", "--method", "model", "dpca",
    ]  # fmt: skip
    assert main([*words, "-o", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "| model | bearing | 1 |" in out
    assert "| dpca | bearing | 1 |" in out
    # Confusion of all kinds, then of each.
    assert re.search(r"\| model \| [\d.]+ \| [\d.]+ \|\n\| bearing \| [\d.]+ \|", out)
    assert out.strip() in (tmp_path / "evaluation.md").read_text()


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["--seeds", "1000-1001"], "kept for reporting"),
        (["--seeds", "x"], "none of development"),
        (["--seeds", "1", "--kind", "flood"], "no kind 'flood'"),
        (["--seeds", "1", "--method", "luck"], "no method 'luck'"),
        (["--seeds", "1", "--world", "other"], "add --base bench"),
    ],
)
def test_wrong_words_are_explained(capsys, words, hint):
    assert main(["evaluate", "thermal", *words]) == 2
    assert hint in " ".join(capsys.readouterr().err.split())
    assert REPORTING.start == 1000


@pytest.fixture(scope="module")
def reproduced(tmp_path_factory):
    """Table and figures of one train; the whole command does twenty."""
    folder, steps = tmp_path_factory.mktemp("paper"), []
    outcome = reproduce_thermal.reproduce(folder, steps.append, trains=1)
    assert len(steps) == 2 + reproduce_thermal.STEPS
    return folder, outcome


@pytest.mark.parametrize(("ours", "word"), [
    ({m: 0.01 * printed[0] for m, printed in PRINTED.items()}, "Table 2 is reproduced"),
    ({m: 0.8 - 0.01 * k for k, m in enumerate(PRINTED)}, "Table 2 is not reproduced"),
])  # fmt: skip
def test_the_report_begins_with_its_verdict_on_the_papers_order(ours, word):
    healthy = score_alarms(np.zeros(20), 0.0, truth([0] * 10 + [1] * 10))
    scores = {method: [healthy._replace(accuracy=share)] for method, share in ours.items()}
    text = verdict(Outcome("overheating", [1000], {"days": scores}, ["lstm"]))
    assert word in text
    best = max((m for m in ours if m != "lstm"), key=ours.get)
    place = 1 + sum(PRINTED[m] > PRINTED[best] for m in PRINTED if m != "lstm")
    first = {"paper": "the paper's method", "dpca": "DPCA"}[best]
    assert f"in brackets: {first} ({place}), " in text
    assert "LSTM" not in text, "it did not run"
    assert "confounded" in text


@pytest.mark.thorough
def test_the_paper_reproduced(reproduced):
    tmp_path, outcome = reproduced
    for name in FIGURES:
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000
        assert "<svg" in (tmp_path / f"{name}.svg").read_text()[:2000]
    text = (tmp_path / "report.md").read_text()
    assert text == markdown(outcome)
    assert verdict(outcome) in text[: text.index("## Table 2")]
    assert "94.4 / 2.75 / 4.44, 1.24" in text
    assert "between 95.56 and 97.25" in text
    page = (tmp_path / "report.html").read_text()
    assert page.count("data:image/svg+xml;base64") == len(FIGURES)
    assert "<title>Paper thermal, reproduced</title>" in page
    assert "| readings, no filter |" in text
    table = {row[0]: row for row in rows(outcome)}
    ours = float(table["calibrated model and hypotheses (the product's)"][1].split()[0])
    causal = float(table["the paper's method, causal"][1].split()[0])
    assert ours > causal
    for table in (tmp_path / "table2_days.md").read_text().strip().split("\n\n"):
        assert table in text


@pytest.mark.thorough
def test_what_was_stopped_behind_its_first_base_comes_out_the_same(reproduced, tmp_path):
    """What is done is not done again."""
    folder, outcome = reproduced
    lines = (folder / "trains.jsonl").read_text().splitlines(keepends=True)
    assert len(lines) == len(reproduce_thermal.BASES)
    (tmp_path / "trains.jsonl").write_text(lines[0] + lines[1][:99])
    shown = []
    again = reproduce_thermal.reproduce(
        tmp_path, lambda _step: None, trains=1, resume=True, show=shown.append
    )
    for method, scores in outcome.scores["days"].items():
        np.testing.assert_array_equal(again.scores["days"][method], scores)
    assert len(shown) == 2
    timeless = [s._replace(seconds=0.0) for s in again.scores["bench"]["model"]]
    assert timeless == [s._replace(seconds=0.0) for s in outcome.scores["bench"]["model"]]
    for name in FIGURES:
        first, second = (p / f"{name}.svg" for p in (folder, tmp_path))
        assert first.read_bytes() == second.read_bytes()


VARIANTS = ("paper", "paper_causal", "paper_sound", "paper_mixed", "paper_ukf", "paper_acting")


@pytest.fixture(scope="module")
def together():
    return {found.method: found for found in trials(5, "days", ["bearing"], VARIANTS)}


@pytest.mark.parametrize("name", [
    pytest.param(name, marks=[pytest.mark.thorough] * (k > 0)) for k, name in enumerate(VARIANTS)
])  # fmt: skip
def test_variants_that_share_states_score_as_each_does_alone(together, name):
    (alone,) = trials(5, "days", ["bearing"], [name])
    assert together[name].score._replace(seconds=0.0) == alone.score._replace(seconds=0.0)
    assert name == "paper" or together[name].score != together["paper"].score
