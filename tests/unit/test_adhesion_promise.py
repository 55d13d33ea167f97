"""`[adhesion] false_alarms_per_1000_h`: the promise, what it measures, and what follows from it."""

import math
import tomllib
from types import SimpleNamespace

import numpy as np
import pytest

from dbc.frame import MS, SECOND
from estimators.adhesion_promise import LATEST_MS, STEP_MS, promise_of
from estimators.tolerance import STORED
from gateway import cli
from gateway.core.codes import Flag
from gateway.hil.fitting import fitting
from gateway.hil.pytest.bench import HilBench, scenario_of
from gateway.settings.config import ConfigError, load, parse
from gateway.study.adhesion_promise import splits
from gateway.study.fault_free import Evidence, largest


@pytest.mark.parametrize("rate", [2000.0, 12000.0])
@pytest.mark.parametrize("draw", [
    lambda rng, n: rng.geometric(0.5, n) * 10, lambda rng, n: rng.integers(0, 4, n) * 30,
], ids=["long tail", "ties"])  # fmt: skip
def test_of_twenty_calibrations_nineteen_keep_the_rate(draw, rate):
    rng, broken, n = np.random.default_rng(8), 0, 200
    share = -math.expm1(-rate / 60_000)
    everything = np.sort(draw(rng, 200_000))
    for _ in range(600):
        promise = promise_of(n, largest(np.sort(draw(rng, n))), rate)
        assert promise.promised
        later = len(everything) - np.searchsorted(everything, promise.limit)
        broken += later / len(everything) > share
    assert broken / 600 < 0.05 + 3 * math.sqrt(0.05 * 0.95 / 600)


def test_too_few_minutes_promise_nothing_and_say_what_is_needed():
    promise = promise_of(60, [40, 0, 0], 1.0)
    assert not promise.promised
    assert promise.limit == 40 + STEP_MS
    assert promise_of(promise.needed, [40], 1.0).promised
    assert not promise_of(promise.needed - 1, [40], 1.0).promised
    assert "179744 fault-free minutes needed, 60 measured" in str(promise)
    least = math.nextafter(promise.least * (1 + 1e-9), math.inf)
    assert promise_of(60, [40], least).promised


def test_evidence_that_lasts_longer_than_a_flag_may_wait_promises_nothing():
    promise = promise_of(10_000, [LATEST_MS, 0], 20.0)
    assert (promise.promised, promise.limit) == (False, LATEST_MS)
    assert "lasted for 500 ms and more" in str(promise)
    assert promise_of(10_000, [LATEST_MS - STEP_MS], 20.0).promised


def told(evidence, now_ms, *states):
    state = np.array(states).reshape(-1, 1)
    status = SimpleNamespace(drives={"flag": {"state": state}})
    evidence.follow_flags(SimpleNamespace(now_ns=now_ms * MS, status=status))


def test_the_longest_evidence_of_each_minute_over_logs_joined_end_to_end():
    evidence = Evidence()
    evidence.begin_log(5 * SECOND)
    told(evidence, 6_000, Flag.BAD, Flag.GOOD)
    told(evidence, 6_040, Flag.GOOD, Flag.BAD)
    told(evidence, 6_050, Flag.GOOD, Flag.BAD)
    told(evidence, 6_110, Flag.GOOD, Flag.UNKNOWN)
    evidence.end_log(65 * SECOND)
    evidence.begin_log(0)
    told(evidence, 59_500, Flag.BAD, Flag.BAD)
    evidence.end_log(59_900 * MS)
    assert evidence.longest_ms.tolist() == [70], "the second minute is not whole"
    evidence.begin_log(0)
    evidence.end_log(61 * SECOND)
    assert evidence.longest_ms.tolist() == [70, 400, 0]
    assert largest(evidence.longest_ms) == [400, 70, 0]
    assert len(largest(np.arange(100))) == STORED


def test_one_half_sets_the_time_and_the_other_is_judged():
    times = np.array([0] * 380 + [30] * 19 + [400])
    found = splits(times, 20_000.0)
    assert {one.minutes for one in found} == {200}
    assert all(one.promise.promised and one.kept for one in found)
    assert {one.promise.limit for one in found} <= {10, 40}
    assert any(one.alarms for one in found), "the rate allows some"


def test_the_two_keys_need_each_other_and_times_descend():
    for keys in (
        {"false_alarms_per_1000_h": 5.0},
        {"fault_free": {"minutes": 9, "longest_ms": [0]}},
    ):
        with pytest.raises(ConfigError, match="calibrate --adhesion"):
            parse({"adhesion": keys})
    wrong = {"minutes": 9, "longest_ms": [10, 20]}
    with pytest.raises(ConfigError, match="which must descend"):
        parse({"adhesion": {"false_alarms_per_1000_h": 5.0, "fault_free": wrong}})


def test_a_loss_is_flagged_no_sooner_than_the_promise_allows():
    measured = {"minutes": 10_000, "longest_ms": [120, 60]}
    given = {"false_alarms_per_1000_h": 20.0, "fault_free": measured}
    scenario, delays = scenario_of({}, "promise"), []
    for adhesion in ({}, given):
        config, codec = fitting(None, scenario)
        own = config.adhesion.model_validate(adhesion)
        bench = HilBench(scenario, config.model_copy(update={"adhesion": own}), codec)
        bench.settle()
        bench.inverter.lose_adhesion(drive=2, depth=1.0)
        delays.append(bench.flags.expect_lost(drive=2, within_ms=400))
    assert delays[0] <= 30
    assert delays[1] == pytest.approx(delays[0] + 130, abs=10)


def test_calibrate_prints_what_was_measured_and_replay_the_promise(tmp_path, capsys, refused):
    short, log, config = (tmp_path / name for name in ("short.log", "one.log", "own.toml"))
    assert cli.main(["sim", "healthy", "--duration", "3", "-o", str(short)]) == 0
    assert "less than a minute" in refused("calibrate", "--adhesion", short)
    assert cli.main(["sim", "healthy", "--duration", "61", "-o", str(log)]) == 0
    capsys.readouterr()
    assert cli.main(["calibrate", "--adhesion", str(log), str(short)]) == 0
    said = capsys.readouterr()
    assert "state false_alarms_per_1000_h" in said.err
    measured = tomllib.loads(said.out)["fault_free"]
    assert measured == {"minutes": 1, "longest_ms": [0]}
    rows = "".join(f"[[drive]]\nnode = {n}\n" for n in (1, 2, 3))
    config.write_text(f"{rows}[adhesion]\nfalse_alarms_per_1000_h = 60000\n{said.out}")
    assert load(config).adhesion.promise.needed == 3
    assert cli.main(["calibrate", "--adhesion", str(log), "--config", str(config)]) == 0
    assert "3 fault-free minutes needed, 1 measured" in capsys.readouterr().err
    assert cli.main(["replay", str(short), "--config", str(config)]) == 0
    assert "promise: adhesion: 60000 false alarms in 1000 h not promised" in capsys.readouterr().out


@pytest.mark.thorough  # how runs are split and judged: by `splits`, above
def test_evaluate_checks_a_stated_rate(capsys):
    words = ["evaluate", "--false-alarms", "60000", "--seeds", "300-314", "--family"]
    assert cli.main([*words, "healthy_rough", "--detector", "vb"]) == 0
    assert "kept in 20 of 20 splits" in capsys.readouterr().out


def test_a_rate_is_checked_for_one_detector_on_families_without_a_loss(refused):
    words = ["evaluate", "--false-alarms", "60000", "--seeds", "300", "--family"]
    assert "adhesion is lost in family 'single'" in refused(*words, "single")
    assert "0 minutes in all these runs" in refused(*words, "healthy_rough")
    assert "checks one detector" in refused(*words, "healthy_rough", "--detector", "vb", "median")
