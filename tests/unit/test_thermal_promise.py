"""A stated rate of thermal false alarms: its limit, what is promised, where it is printed."""

import math

import numpy as np
import pytest

from estimators.thermal.model_method import learn
from estimators.thermal.monitor import RAISE, ThermalMonitor, followed
from estimators.thermal.promise import CERTAIN, STORED, Hours, hourly, hours_of, promise_of
from gateway.cli import main
from gateway.settings import calibration
from gateway.settings.calibration import to_toml
from gateway.settings.config import ConfigError, parse
from gateway.study.calibrating import Learner, Sample
from tests.unit.test_heatside import NODES, cells
from tests.unit.test_thermal_monitor_order import FLEET, MOTORS, train

ONE_IN_TWENTY = -1000.0 * math.log(0.95)
"""False alarms in 1000 h, of which an hour has one with a probability of 5 %."""


def hours(number, largest=(6.0, 5.0, 4.0)):
    return Hours(number, largest)


def odds(promise):
    return math.log(promise.limit / (1.0 - promise.limit))


@pytest.mark.parametrize(("number", "kth"), [(59, 1), (92, 1), (93, 2), (123, 2), (124, 3)])
def test_the_limit_is_the_tolerance_limit_of_the_tables(number, kth):
    """Wilks 1941: 59, 93 and 124 samples for 95 % of a population with a confidence of 95 %."""
    promise = promise_of(hours(number), ONE_IN_TWENTY)
    assert promise.promised
    assert odds(promise) == pytest.approx(hours(number).largest[kth - 1])
    assert (promise.needed, promise.blocks) == (59, number)
    assert promise_of(hours(59), promise.least).promised == (promise.least >= ONE_IN_TWENTY)


def test_with_too_few_hours_nothing_is_promised_and_the_limit_goes_on_from_the_largest():
    promise = promise_of(hours(58), ONE_IN_TWENTY)
    assert not promise.promised
    assert odds(promise) == pytest.approx(6.0, abs=0.03)
    less = promise_of(hours(58), ONE_IN_TWENTY / 100.0)
    assert odds(less) == pytest.approx(6.0 + math.log(100.0), abs=0.05)
    text = str(less)
    assert "not promised: 5841 fault-free hours needed, 58 measured" in text
    assert "can promise 51.7 at best" in text
    even = promise_of(hours(58, (-20.0,)), ONE_IN_TWENTY / 100.0)
    assert odds(even) == pytest.approx(math.log(100.0), abs=0.05), "even odds at least"


def test_hours_with_a_fault_for_certain_promise_nothing():
    promise = promise_of(hours(90, (CERTAIN, 1.0)), ONE_IN_TWENTY)
    assert not promise.promised
    assert "too many of the 90 fault-free hours" in str(promise)
    assert promise.limit < 1.0
    assert promise_of(hours(93, (CERTAIN, 1.0)), ONE_IN_TWENTY).promised, "one of them is allowed"
    assert odds(promise_of(hours(400, (9.0,)), ONE_IN_TWENTY)) == pytest.approx(9.0), "stored: one"


def test_no_limit_is_below_the_usual_one_and_few_hours_are_stored():
    found = hours_of(np.linspace(-9.0, 1.0, 400))
    assert found.number == 400
    assert len(found.largest) == STORED
    assert found.largest[0] == 1.0
    promise = promise_of(found, 1000.0)
    assert promise.limit == RAISE
    assert "promised by 400 fault-free hours; limit 0.900000" in str(promise)


HOUR = 3600


@pytest.fixture(scope="module")
def known():
    runs = [train(1), train(2)]
    for run in runs:
        run.temperature[len(run.at) // 2 :, 1, 1] -= 6.0
    return learn(FLEET, runs)


def watched(known, record):
    """Per block: the largest log odds of a motor that is judged, and whether any is reported."""
    monitor, out = ThermalMonitor(known, 1.0), []
    for judged in followed(monitor, record):
        if judged:
            p = monitor.motors["fault_probability"].max()
            out.append((p, monitor.held.any()))
    return np.array(out).T


def hot(k=2 * HOUR):
    """From the middle on, one motor slowly warms."""
    record = train(3, k)
    record.temperature[k // 2 :, 1, 1] -= 6.0
    record.temperature[k // 2 :, 2] += np.minimum(np.arange(k // 2) / 600.0, 4.0)[:, None]
    return record


def test_what_is_reported_is_what_exceeds_the_limit(known):
    record = hot()
    peaks = hourly(ThermalMonitor(known, 1.0), record)
    assert len(peaks) == 2
    assert peaks[0] < peaks[1]
    for limit, reported in ((0.95, True), (1.0, False)):
        p, held = watched(known._replace(raise_probability=limit), record)
        assert held.any() == reported
        first = np.argmax(p > limit) if (p > limit).any() else len(p)
        assert not held[:first].any()
        assert held[first:].any() == reported
    half = len(p) // 2
    for hour, part in zip(peaks, (p[:half], p[half:]), strict=True):
        top = part.max()
        assert hour == pytest.approx(min(math.log(top / max(1.0 - top, 1e-30)), CERTAIN), abs=1e-2)


def test_a_step_is_certain_and_a_motor_that_is_not_judged_counts_for_nothing(known):
    record = train(3, HOUR)
    assert hourly(ThermalMonitor(known, 1.0), record).tolist() == [CERTAIN]
    covered = np.full((MOTORS, 2), 0.95)
    covered[1] = 0.5
    known = known._replace(coverage=known.coverage._replace(covered=covered))
    assert hourly(ThermalMonitor(known, 1.0), record)[0] < CERTAIN
    assert len(hourly(ThermalMonitor(known, 1.0), train(3, HOUR - 1))) == 0, "whole hours only"


def learner(lengths):
    """Fault-free logs of so many seconds, of motors that are their model."""
    made = Learner((1, 2, 3, 4), 5.0, promises=True)
    for seed, length in enumerate(lengths):
        made.begin()
        record = train(seed, length)
        record.temperature[length // 2 :, 1, 1] -= 6.0
        ones = np.ones(MOTORS)
        made.seconds[-1] += [
            Sample(record.temperature[k], record.current_square[k], ones * record.speed[k],
                   ones * record.ambient[k])
            for k in range(length)
        ]  # fmt: skip
    made.means[-1], made.samples = [record.temperature], 1000
    return made


def test_the_last_log_gives_hours_and_no_model():
    made = learner([2400, HOUR])
    found = made.finish(1.5)
    assert found.heat.held_back_h == 1
    assert found.heat.largest_log_odds == made.hours.largest
    assert made.fits[0].t_s[-1] < 2400, "held back of the first log"
    for lengths in ([2400], [2400, HOUR - 1]):
        with pytest.raises(ConfigError, match="needs two logs or more"):
            learner(lengths).finish(1.5)


@pytest.fixture
def config(tmp_path):
    """A configuration's folder and text; the calibration has 12 hours."""

    def written(rate, found=None):
        (tmp_path / "c.toml").write_text(to_toml(found or cells()))
        path = tmp_path / "train.toml"
        path.write_text(
            '[thermal]\ncalibration = "c.toml"\n'
            + (f"false_alarms_per_1000_h = {rate}\n" if rate else "")
            + "".join(f"[[drive]]\nnode = {node}\n" for node in NODES)
        )
        return path

    return written


def measured():
    heat = cells().heat.model_copy(update={"held_back_h": 12, "largest_log_odds": (3.5, -1.25)})
    return cells().model_copy(update={"heat": heat})


def test_hours_are_stored_and_a_stated_rate_moves_the_limit(config):
    path = config(None, measured())
    found = calibration.load(path.parent / "c.toml", NODES, 5.0)
    assert (found.heat.held_back_h, found.heat.largest_log_odds) == (12, (3.5, -1.25))
    assert found.checksum() != cells().checksum()
    assert found.known(NODES).raise_probability == RAISE
    assert calibration.promise_lines(found) == []
    promising = found.promising(300.0)
    assert promising.promise.promised
    limit = promising.known(NODES).raise_probability
    assert math.log(limit / (1.0 - limit)) == pytest.approx(3.5)
    assert promising.checksum() == found.checksum()


def test_without_a_model_nothing_is_promised_and_the_reason_is_named():
    with pytest.raises(ConfigError, match="has no thermal model"):
        cells().model_copy(update={"heat": None}).promising(300.0)
    with pytest.raises(ConfigError, match="no held-back fault-free hours"):
        cells().promising(300.0)


def test_check_replay_and_run_print_what_is_promised(config, capsys, pytestconfig):
    path = config(1, measured())
    assert main(["check", str(path), "--no-timing"]) == 0
    words = "1 false alarms in 1000 h not promised: 2996 fault-free hours needed, 12 measured"
    assert words in capsys.readouterr().out
    log = str(pytestconfig.rootpath / "tests" / "golden" / "loss.log.gz")
    main(["replay", log, "--config", str(path)])
    assert f"promise: thermal: {words}" in capsys.readouterr().out
    live = ["run", "-i", "virtual", "-c", "promise", "--quiet", "--duration", "0.05"]
    assert main([*live, "--config", str(path)]) == 0
    assert f"promise: thermal: {words}" in capsys.readouterr().out
    path = config(None, measured())
    main(["replay", log, "--config", str(path)])
    assert "promise" not in capsys.readouterr().out


def test_a_rate_without_hours_or_of_another_method_is_refused(config, capsys):
    assert main(["check", str(config(1)), "--no-timing"]) == 2
    assert "with one more log" in capsys.readouterr().err.replace("\n", " ")
    with pytest.raises(ConfigError, match="method 'maisd' has no such limit"):
        parse({"thermal": {"method": "maisd", "false_alarms_per_1000_h": 1.0}})
    stated = {"thermal": {"false_alarms_per_1000_h": 1.0}}
    assert parse(stated).hash24() != parse({}).hash24()
    with pytest.raises(ConfigError, match=r"expected 0\.001 to 1000"):
        parse({"thermal": {"false_alarms_per_1000_h": 0}})


def test_a_rate_is_checked_on_trains(capsys, tmp_path):
    words = ["evaluate", "thermal", "--limit-hours", "2", "--false-alarms"]
    more = ["500", "--judged-hours", "2", "--seeds", "3", "-o", str(tmp_path)]
    assert main([*words, *more, "--base", "bench"]) == 0
    out = capsys.readouterr().out
    assert "| 3 | extrapolated |" in out
    assert "kept in 1 of 1 trains" in out
    assert "6 of 6" in out
    assert out.strip() in (tmp_path / "promise.md").read_text()
    for wrong, hint in (
        (more, "add --base bench"),
        (["500", "--base", "bench", "--seeds", "0", "--world", "other"], "one motor each"),
        (["500", "--base", "bench", "--judged-hours", "1"], "which a run has, or more"),
        (["500", "--base", "bench", "--judged-hours", "inf"], "which a run has, or more"),
        (["500", "--base", "bench", "--method", "model"], "takes no --kind, --method"),
        (["0", "--base", "bench"], "expected 0.001"),
    ):
        assert main([*words, *wrong]) == 2
        assert hint in " ".join(capsys.readouterr().err.split())
