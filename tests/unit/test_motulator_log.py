"""Waveforms made by hand on our bus: what `bench.motulator_plant` does with motulator's."""

import sys

import numpy as np
import pytest

from bench.motulator_log import HEADER, cells, judge, replay_log, write_log
from bench.motulator_plant import main
from dbc.candump.reader import Reader
from dbc.codec import bind
from gateway.core.codes import Health
from gateway.settings.config import parse
from gateway.study.evaluation import listen
from gateway.study.held_world import OtherMachine, periods
from sim.physics.plant import BENCH, DT, OUT
from tests.simrun import scenario, values

SPEED, LOAD_NM = 150.0, 18.0
"""Electrical rad/s; Nm."""
NODES = (1, 2, 3)


def quiet(**table):
    sensors = {"current_noise_var": 0.0}
    load = {"kind": "preset", "torque_nm": LOAD_NM}
    return scenario(duration_s=1.5, sensors=sensors, load=load, **table)


def steady(scenario):
    """Three drives in the steady state, from the phasors of the machine's equations.

    Over a period the mean of u = R i + L di/dt + psi de/dt is R mean(i) + (L di + psi de) / DT.
    """
    i_q = LOAD_NM / (1.5 * BENCH.pole_pairs * BENCH.psi_pm)
    t = DT * np.arange(periods(scenario) + 1)[:, None]
    e = np.exp(1j * (SPEED * t + np.array([0.3, 2.0, 4.5])))
    i = 1j * i_q * e
    mean_i = np.diff(i, axis=0) / (1j * SPEED * DT)
    u = BENCH.R_s * mean_i + np.diff(BENCH.L_s * i + BENCH.psi_pm * e, axis=0) / DT
    fixed = (300.0, LOAD_NM, SPEED / BENCH.pole_pairs, np.angle(e[1:]) % (2 * np.pi))
    rows = (i[1:].real, i[1:].imag, u.real, u.imag, *fixed, LOAD_NM, LOAD_NM)
    out = np.stack([np.broadcast_to(column, u.shape) for column in rows], axis=2)
    assert out.shape == (periods(scenario), 3, OUT)
    return out


@pytest.mark.parametrize("dbc", ["traction.dbc", "traction_fd.dbc"])
def test_log_of_given_waveforms_is_tracked(tmp_path, dbc):
    run = quiet()
    config = parse({"dbc": {"file": dbc}})
    codec = bind(config.dbc_path, NODES)
    truth = write_log(OtherMachine(run, codec, steady(run)), tmp_path / "run.log")
    sent = replay_log(tmp_path / "run.log", config, codec)
    for node in NODES:
        last = values(sent, f"Drive{node}_Estimate", codec)[-1]
        assert last["Health"] == Health.TRACKING
        assert last["LoadTorque"] == pytest.approx(LOAD_NM, abs=0.5)
    judged = judge(truth, sent, codec)
    flags = judged.measured.flags
    assert (flags.losses, flags.alarms, flags.false_positive) == (0, 0, 0)
    assert np.all(listen(sent, codec, NODES).flags[-1] == 1)
    assert judged.healthy_rmse_nm == pytest.approx(judged.measured.load_rmse_nm)
    assert judged.healthy_rmse_nm < 0.5


def test_frames_decode_to_the_waveforms(tmp_path):
    run = quiet()
    codec = bind(parse({}).dbc_path, NODES)
    rows = steady(run)
    write_log(OtherMachine(run, codec, rows), tmp_path / "run.log")
    frames = list(Reader(tmp_path / "run.log", strict=True))
    currents = values(frames, "Drive2_PhaseCurrents", codec)
    voltages = values(frames, "Drive2_StatorVoltages", codec)
    assert len(currents) == len(voltages) == round(run.duration_s / 0.002) - 1
    per = 16  # periods of 125 us in 2 ms
    ends = rows[per - 1 :: per, 1][: len(currents)]
    volts = rows[:, 1, 2:4].reshape(-1, per, 2).mean(axis=1)[: len(currents)]
    half = np.sqrt(3.0) / 2.0
    for frame, end in zip(currents, ends, strict=True):
        assert frame["Ia"] == pytest.approx(end[0], abs=0.0101)
        assert frame["Ib"] == pytest.approx(-0.5 * end[0] + half * end[1], abs=0.0101)
        assert frame["Ic"] == pytest.approx(-0.5 * end[0] - half * end[1], abs=0.0101)
    for frame, mean in zip(voltages, volts, strict=True):
        assert [frame["Ualpha"], frame["Ubeta"]] == pytest.approx(mean.tolist(), abs=0.0501)
        assert frame["Udc"] == pytest.approx(300.0)
    motion = values(frames, "Drive2_Motion", codec)[-1]
    assert motion["Speed"] == pytest.approx(SPEED / 4 * 30 / np.pi, abs=0.25)
    status = values(frames, "Drive2_Status", codec)[-1]
    assert status["TorqueCommand"] == pytest.approx(LOAD_NM, abs=0.05)


def test_loss_in_the_scenario_is_in_the_truth_and_not_in_steady_waveforms(tmp_path):
    """Truth is the scenario's: a machine that shows nothing of the loss makes a missed one."""
    loss = {"at_s": 0.9, "for_s": 0.4, "drive": 2, "kind": "adhesion_loss", "depth": 0.8}
    run = quiet(event=[loss])
    config = parse({})
    codec = bind(config.dbc_path, NODES)
    truth = write_log(OtherMachine(run, codec, steady(run)), tmp_path / "run.log")
    judged = judge(truth, replay_log(tmp_path / "run.log", config, codec), codec)
    assert (judged.measured.flags.losses, judged.measured.flags.missed) == (1, 1)
    both = judged.plus(judged)
    assert both.measured.flags.missed == 2
    line = cells(("by hand", "single", "traction.dbc"), 2, both)
    assert len(line) == len(HEADER)
    assert line[HEADER.index("missed")] == "2"
    assert line[HEADER.index("delay ms")] == "-"


def test_waveforms_that_end_too_soon(tmp_path):
    run = quiet()
    simulation = OtherMachine(run, bind(parse({}).dbc_path, NODES), steady(run)[:800])
    with pytest.raises(ValueError, match="800 rows"):
        write_log(simulation, tmp_path / "run.log")


def test_without_motulator_it_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "motulator.drive.model", None)
    assert main(["--seeds", "0"]) == 2
    said = capsys.readouterr().err.strip()
    assert "pip install -e .[verify]" in said
    assert "\n" not in said
