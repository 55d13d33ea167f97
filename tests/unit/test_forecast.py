"""`check --forecast`: what it says of losses, against the core and against simulated runs."""

import numpy as np
import pytest
from _traction_core import ffi, lib

from bench.forecast import Run, measured_ms
from dbc.codec import bind
from estimators import load_response
from gateway.cli import main
from gateway.hil import forecast_table
from gateway.hil.forecast import Forecast
from gateway.hil.forecast_table import Cell
from gateway.settings.config import parse

BENCH = {"R_s": 0.28, "L_s": 3.465e-3, "psi_pm": 0.1989, "pole_pairs": 4, "J": 0.04,
         "I_rated": 25.0, "T_rated": 30.0}  # fmt: skip
SPEED = 100.0
"""rad/s electrical."""


def made(drives=3, motor="bench", **sections):
    nodes = [{"node": k, "motor": motor} for k in range(1, drives + 1)]
    config = parse({"drive": nodes, **sections})
    return config, bind(config.dbc_path, config.nodes)


def forecast(config, codec, torque=0.6, w_e=SPEED):
    return Forecast(config, codec, w_e / config.motors[config.drive[0].motor].pole_pairs, torque)


def slower(config, codec, cycle_ns):
    run = Run(0, config, codec, SPEED, 0.6, 0.5, 3.0, 0.0)
    return config, run.with_cycle(cycle_ns).codec


def median_ms(config, codec, loss, torque=0.6, w_e=SPEED):
    return np.median(forecast(config, codec, torque, w_e).delays_ms(0, loss))


def test_the_observer_of_the_core_answers_a_step_of_the_load_as_forecast():
    J, period, load_rate, var = 0.04, 0.01, 800.0, 1e-3
    of = load_response.observer(J, 0.0, load_rate, (var, 0.0), 0.0, period, 64)
    answer = load_response.answer(of)
    state = ffi.new("struct load_observer *")
    m = ffi.new("struct mechanics *", {"J": J, "B": 0.0, "speed_var": var, "load_rate": load_rate})
    w, torque = 50.0, 10.0
    lib.load_observer_init(state, w, torque, m)
    for _ in range(200):
        lib.load_observer_update(state, w, torque, period, m)
    e = answer.within[0]
    for _ in range(6):
        w -= period / J  # 1 Nm more than the torque
        lib.load_observer_update(state, w, torque, period, m)
        assert state.T_L - torque == pytest.approx(1.0 - e[-1], abs=0.02)
        e = answer.A @ e


def test_a_filter_that_cannot_observe_the_load_has_no_answer():
    of = load_response.observer(0.04, 0.0, 800.0, (1e-3, 0.0), 0.0, 0.01, 16)
    with pytest.raises(ValueError, match="cannot be observed"):
        load_response.answer(of._replace(H=np.zeros((1, 2))))


@pytest.mark.parametrize(
    ("drives", "motor", "dbc", "w_e", "loss"),
    [
        (3, "bench", "traction.dbc", 100.0, 0.3),
        (2, "traction_350kw", "traction_fd.dbc", 150.0, 0.5),
        (3, "traction_350kw", "traction.dbc", 450.0, 0.8),  # by the load observer
        (1, "bench", "traction.dbc", 100.0, 1.0),  # by its own spin-up
    ],
)
def test_the_forecast_agrees_with_simulated_runs(drives, motor, dbc, w_e, loss):
    config, codec = made(drives, motor, dbc={"file": dbc})
    runs = [Run(7000 + k, config, codec, w_e, 0.6, loss, 3.0 + 0.0137 * k, 0.5) for k in range(5)]
    measured = np.median([measured_ms(run) for run in runs])
    assert median_ms(config, codec, loss, w_e=w_e) == pytest.approx(measured, rel=0.3)


def test_a_noisier_sensor_and_a_slower_bus_need_a_larger_loss():
    quiet = made(3, "traction_350kw")
    noisy = made(3, "traction_350kw", estimator={"current_noise_var": 2e-2})
    slow = slower(*quiet, 8_000_000)

    def smallest(config, codec):
        made = forecast(config, codec)
        delays = {loss: made.delays_ms(0, loss) for loss in (1.0, 0.5, 0.3, 0.2, 0.15)}
        return Cell((1,), "", 0.0, 0.6, delays).smallest(50.0) or 2.0

    assert smallest(*quiet) < smallest(*slow)
    assert smallest(*quiet) < smallest(*noisy)


def test_a_smaller_loss_takes_longer_and_a_tiny_one_is_never_found():
    made_forecast = forecast(*made())
    ms = [np.median(made_forecast.delays_ms(0, loss)) for loss in (1.0, 0.4, 0.15)]
    assert ms == sorted(ms)
    assert ms[0] < ms[-1]
    assert np.isinf(np.median(made_forecast.delays_ms(0, 0.02)))


def test_a_longer_debounce_is_a_longer_delay():
    base = median_ms(*made(), 0.3)
    later = median_ms(*made(adhesion={"raise_ms": 60, "raise_severe_ms": 60}), 0.3)
    assert later == pytest.approx(base + 60.0, abs=15.0)


@pytest.mark.parametrize("detector", ["vb", "median"])
def test_any_detector_has_a_forecast(detector):
    config, codec = made(adhesion={"detector": detector})
    assert 10.0 < median_ms(config, codec, 0.8) < 100.0


def test_a_loss_counts_only_if_all_larger_ones_are_found():
    late, soon = np.full(10, 90.0), np.full(10, 20.0)
    assert Cell((1,), "", 0, 1.0, {1.0: soon, 0.5: late, 0.3: soon}).smallest(50) == 1.0
    assert Cell((1,), "", 0, 1.0, {1.0: late, 0.5: soon}).smallest(50) is None


def test_a_speed_without_an_observable_rotor_says_so(monkeypatch):
    monkeypatch.setattr(forecast_table, "SPEEDS", (0.05, 0.1))
    monkeypatch.setattr(forecast_table, "LOSSES", (1.0,))
    found = forecast_table.cells(*made(), 900.0, lambda: None)
    for cell in found[:2]:
        assert cell.problem == "19 rad/s electrical is below min_speed_rad_s = 20"
        assert cell.smallest(200) is None
    for cell in found[2:]:
        assert cell.smallest(200) == 1.0


def test_the_verb_prints_a_table_and_writes_files(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(forecast_table, "SPEEDS", (0.1, 1.0))
    path = tmp_path / "train.toml"
    path.write_text("[[drive]]\nnode = 1\n[[drive]]\nnode = 2\n")
    assert main(["check", str(path), "--no-timing", "--forecast", "1500", "-o", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "drives 1, 2, motor bench" in out
    assert "A smaller loss is found later or never" in out
    assert out.count(" rpm ") == 4
    rows = (tmp_path / "forecast.csv").read_text().splitlines()
    assert rows[0].startswith("drives,motor,speed_rpm,")
    assert len(rows) > 20
    assert "</svg>" in (tmp_path / "forecast.svg").read_text()


def test_an_impossible_motor_says_so(tmp_path, capsys):
    motor = "\n".join(f"{key} = {value}" for key, value in BENCH.items())
    motor = motor.replace("I_rated = 25.0", "I_rated = 2000.0").replace("30.0", "2400.0")
    drives = "".join(f'[[drive]]\nnode = {k}\nmotor = "x"\n' for k in (1, 2))
    path = tmp_path / "train.toml"
    path.write_text(f"{drives}[motor.x]\n{motor.replace('J = 0.04', 'J = 1.0')}\n")
    assert main(["check", str(path), "--no-timing", "--forecast", "1500"]) == 2
    out, err = capsys.readouterr()
    assert "drive 1 needs 2011 A, but Ia in the DBC ends at 655 A" in out
    assert "drive 1 needs 2011 A" in err


@pytest.mark.parametrize("words", [["--forecast", "fast"], ["--forecast", "0"], ["-o", "folder"]])
def test_wrong_options_are_refused(words, tmp_path):
    path = tmp_path / "train.toml"
    path.write_text("")
    try:
        code = main(["check", str(path), *words])
    except SystemExit as stop:
        code = stop.code
    assert code == 2
