"""A motor that turns without current: no model holds for it, neither at work nor at calibration."""

import numpy as np
import pytest

from estimators.thermal.model_method import ModelMethod, Watching
from estimators.thermal.monitor import ThermalMonitor, followed
from estimators.thermal.record import cut_out, of_driven_motors
from gateway.cli import main
from tests import slow_record
from tests.unit.test_thermal_monitor import HOUR, ILL, MOTORS, known, train, watched

__all__ = ["known"]
OUT = HOUR // 2


def idle(record, when, apart_k=0.0):
    """Motor ILL without current; its winding's reading is off by so much."""
    square, temperature = record.current_square.copy(), record.temperature.copy()
    square[when, ILL] = 0.0
    temperature[when, ILL, 0] += apart_k
    return record._replace(current_square=square, temperature=temperature)


@pytest.mark.parametrize(
    ("until", "warm"), [(OUT + 300, OUT + 580), (OUT + HOUR, OUT + HOUR + 2700)]
)
def test_it_is_judged_after_as_long_a_drive_as_it_was_cut_out_and_at_most_45_minutes(
    known, until, warm
):
    record = idle(train(21, warm + HOUR // 2), slice(OUT, until), -12.0)
    monitor, states = ThermalMonitor(known, 1.0), []
    for _ in followed(monitor, record):
        motors = monitor.motors
        out = monitor.currents["cut_out"]
        states.append((out.copy(), motors["judged"].copy(), motors["held"].copy()))
    out, judged, held = (np.array(part) for part in zip(*states, strict=True))
    others = np.arange(MOTORS) != ILL
    assert not out[:, others].any()
    assert not held.any()
    assert not out[:OUT, ILL].any()
    assert np.flatnonzero(out[:, ILL])[0] - OUT == 19, "twenty samples without current"
    assert out[OUT + 20 : until, ILL].all()
    assert not out[until + 5 :, ILL].any()
    assert not judged[OUT + 20 : warm, ILL].any()
    assert judged[warm + 2 * monitor.block, ILL] > 0
    assert judged[-1, others].min() > len(record.at) // monitor.block - 2


@pytest.mark.parametrize("kind", [None, "overheating", "bearing_de"])
def test_driven_again_it_is_not_suspected_and_its_own_fault_is_found(known, kind):
    """While it warms up, it differs from its model by up to 4 K; a fault begins an hour later."""
    again = OUT + HOUR
    onset = again + HOUR
    since = np.clip((np.arange(3 * HOUR + OUT) - again) / 2700.0, 0.0, 1.0)
    error = np.zeros((len(since), MOTORS, 3))
    error[:, ILL] = 4.0 * np.sin(np.pi * since)[:, None]
    record = train(23, len(since), kind, 10.0, onset, error)
    held = watched(known, idle(record, slice(OUT, again), -12.0))[1]
    assert not held[:onset].any()
    assert not np.delete(held, ILL, axis=1).any()
    assert held[onset + HOUR // 4 :, ILL].all() == (kind is not None)
    assert held[:, ILL].any() == (kind is not None)


def test_where_no_motor_is_driven_none_is_cut_out(known):
    record = train(22, k=HOUR // 2)
    record.current_square[200:] *= 1e-4
    record.current_square[200:, ILL] = 0.0
    monitor = ThermalMonitor(known, 1.0)
    assert not any(monitor.currents["cut_out"].any() for _ in followed(monitor, record))


def test_of_its_share_it_is_not_cut_out_and_below_it_is(known):
    monitor, square = ThermalMonitor(known, 1.0), np.full(MOTORS, 4e4)
    monitor.config["cut_out"]["share"] = 0.25
    for share, out in ((0.25, False), (0.24, True)):
        square[ILL] = share * 4e4
        for _ in range(600):
            monitor.add_sample(np.full((MOTORS, 3), 40.0), square, square * 0.0, square * 0.0)
        assert monitor.currents["cut_out"].tolist() == [out and m == ILL for m in range(MOTORS)]
    square[ILL] = np.nan
    monitor.add_sample(np.full((MOTORS, 3), 40.0), square, square * 0.0, square * 0.0)
    assert monitor.currents["cut_out"][ILL], "unknown, it stays what it was"


def test_from_exactly_the_least_current_on_nothing_is_known_of_the_others(known):
    """And only motors of the train are looked at."""
    monitor, square = ThermalMonitor(known, 1.0), np.zeros(MOTORS)
    monitor.config["cut_out"]["weight"], monitor.record["motor_count"] = 1.0, MOTORS - 1
    for more, out in ((1.0, False), (1.001, True)):
        square[:1], square[-1] = more * monitor.config["cut_out"]["driven_square"], 4e4
        monitor.add_sample(np.full((MOTORS, 3), 40.0), square, square * 0.0, square * 0.0)
        wanted = [out and 0 < m < MOTORS - 1 for m in range(MOTORS)]
        assert monitor.currents["cut_out"].tolist() == wanted
        assert monitor.currents["square"][-1] == 0.0


@pytest.mark.parametrize("alone", [False, True], ids=["one idle", "one driven"])
@pytest.mark.parametrize("which", range(MOTORS))
def test_twenty_samples_without_current_cut_out_any_motor(known, which, alone):
    monitor = ThermalMonitor(known, 1.0)
    idles = (np.arange(MOTORS) == which) != alone
    square = np.where(idles, 0.0, 4e4)
    monitor.currents["square"] = 4e4
    for n in range(1, 25):
        monitor.add_sample(np.full((MOTORS, 3), 40.0), square, square * 0.0, square * 0.0)
        assert monitor.currents["cut_out"].tolist() == (idles & (n >= 20)).tolist()
    assert monitor.currents["square"][~idles] == pytest.approx(4e4), "the mean of what is equal"


def test_idle_samples_count_only_beside_a_motor_of_the_train_that_is_driven(known):
    monitor, square = ThermalMonitor(known, 1.0), np.zeros(MOTORS)
    monitor.record["motor_count"] = MOTORS - 1
    square[0], square[-1] = monitor.config["cut_out"]["driven_square"].item(), 4e4
    for _ in range(30):
        monitor.add_sample(np.full((MOTORS, 3), 40.0), square, square * 0.0, square * 0.0)
    assert not monitor.currents["idle"].any()
    square[0], square[-1] = 4e4, 0.0
    for _ in range(30):
        monitor.add_sample(np.full((MOTORS, 3), 40.0), square, square * 0.0, square * 0.0)
    assert (monitor.currents["idle"] > 0).tolist() == [0 < m < MOTORS - 1 for m in range(MOTORS)]


def test_of_many_that_are_cut_out_none_is_judged(known):
    """Not even where they are the most."""
    monitor, square = ThermalMonitor(known, 1.0), np.zeros(MOTORS)
    square[ILL] = 4e4
    for _ in range(100):
        monitor.add_sample(np.full((MOTORS, 3), 40.0), square, square * 0.0, square * 0.0)
    assert monitor.currents["cut_out"].tolist() == [m != ILL for m in range(MOTORS)]


def test_one_wrong_reading_cuts_out_no_motor_that_is_driven(known):
    monitor, square = ThermalMonitor(known, 1.0), np.full(MOTORS, known.duty[1] / 100.0)
    for n in range(1000):
        square[ILL] = 1e12 if n % 300 == 200 else square[0]
        monitor.add_sample(np.full((MOTORS, 3), 40.0), square, square * 0.0, square * 0.0)
        assert not monitor.currents["cut_out"].any()


def test_one_motor_is_never_cut_out(known):
    record = idle(train(23, k=400), slice(0, None))
    alone = record._replace(
        temperature=record.temperature[:, [ILL]], current_square=record.current_square[:, [ILL]]
    )
    assert not cut_out(alone).any()


def test_of_a_record_its_readings_are_left_out_and_the_others_are_not():
    record = idle(train(24, k=400), slice(0, None), 5.0)
    assert cut_out(record).tolist() == [m == ILL for m in range(MOTORS)]
    driven = of_driven_motors(record)
    assert np.isnan(driven.temperature[:, ILL]).all()
    others = np.arange(MOTORS) != ILL
    np.testing.assert_array_equal(driven.temperature[:, others], record.temperature[:, others])
    np.testing.assert_allclose(
        driven.current_square[:, ILL], record.current_square[:, others].mean(axis=1)
    )
    assert of_driven_motors(driven) is driven


@pytest.mark.parametrize("which", [0, pytest.param(2, marks=pytest.mark.thorough)])
def test_a_calibration_with_it_judges_the_driven_motor_as_one_without(which):
    """Whether the run is one of those that the model is fitted to, or is held back."""
    runs = [train(25), train(29), train(26)]
    runs[which] = idle(runs[which], slice(0, None), -12.0)
    fitted = ModelMethod().fit_runs(runs)
    assert isinstance(fitted, Watching)
    assert np.isfinite(fitted.known.noise).all()
    assert np.isfinite(fitted.known.centre).all()
    assert np.isfinite(fitted.known.coverage.covered[ILL]).all() == (which == 0)
    assert not (fitted(train(27)) > 0.0).any()
    ill = fitted.believe(train(28, kind="overheating"))
    assert ill.statistic[-HOUR:, ILL].min() > 0.0


@pytest.mark.parametrize("which", [0, 1])
def test_calibrate_says_which_motor_was_cut_out(tmp_path, capsys, which):
    """In a log that is held back its readings are not used; it must be driven in another."""
    config, logs, out = slow_record.config(tmp_path, 3), [], tmp_path / "out.toml"
    for k in range(2):
        logs.append(str(tmp_path / f"{k}.log"))
        nodes = (2,) if k == which else ()
        slow_record.write(logs[-1], config, 900, cut_out=nodes, seed=k)
    code = main(["calibrate", *logs, "--config", str(config), "-o", str(out)])
    said = capsys.readouterr()
    if which == 0:
        assert code == 2
        assert (
            "drive 2: it turned without current in every log that models are fitted to" in said.err
        )
        assert not out.exists()
    else:
        assert code == 0, said.err
        assert "drive 2 turned without current in 1 of 2 runs" in said.out
        assert "nan" not in said.out
        assert out.exists()
