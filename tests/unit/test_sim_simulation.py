import math
from itertools import pairwise

import numpy as np
import pytest

from dbc.codec import Codec
from dbc.e2e import crc_ok
from dbc.frame import BRS, FD
from dbc.spec import Validity
from sim.ground_truth import COLUMNS
from sim.scenario import find
from sim.simulation import Simulation
from tests.dbc_text import with_cycles
from tests.simrun import FD_FILE, codec, run, scenario, values

TIED = {"sensors": {"current_noise_var": 0.0, "temperature_noise_k": 0.0}}


def lossy(**table):
    events = [
        {"at_s": 0.2, "kind": "frame_loss", "depth": 0.3},
        {"at_s": 0.2, "kind": "corrupt", "depth": 0.2, "drive": 2},
        {"at_s": 0.3, "for_s": 0.2, "drive": 1, "kind": "adhesion_loss", "depth": 0.7},
    ]
    return scenario(event=events, **table)


@pytest.mark.parametrize("path", [None, FD_FILE])
def test_same_seed_same_bytes_however_time_is_cut(path):
    c = codec(path=path) if path else codec()
    want = run(Simulation(lossy(seed=4), c), 0.6)
    assert want == run(Simulation(lossy(seed=4), c), 0.6)
    for tick in (1_000_000, 3_300_000, 200_000_000):
        got = run(Simulation(lossy(seed=4), c), 0.6, tick)
        assert got == want[: len(got)]
        assert len(got) > len(want) - 20
    assert want != run(Simulation(lossy(seed=5), c), 0.6)


def test_truth_does_not_depend_on_how_time_is_cut():
    rows = []
    for tick in (2_000_000, 100_000_000):
        simulation = Simulation(lossy(), codec())
        run(simulation, 0.6, tick)
        rows.append(simulation.truth_rows())
    assert rows[0] == rows[1]
    assert [r.t_s for r in rows[0][:6]] == [0.01] * 3 + [0.02] * 3
    assert [r.drive for r in rows[0][:3]] == [1, 2, 3]


def test_messages_keep_their_cycle_and_count_it():
    out = run(Simulation(scenario(), codec()), 1.0)
    for name, cycle_ms in (("PhaseCurrents", 2), ("StatorVoltages", 2), ("Motion", 10),
                           ("Status", 100), ("Temperatures", 100)):  # fmt: skip
        for node in (1, 2, 3):
            spec = codec().by_name[f"Drive{node}_{name}"]
            mine = [f for f in out if f.can_id == spec.can_id]
            assert abs(len(mine) - 1000 / cycle_ms) <= 1
            counters = [f.data[1] & 15 for f in mine]
            assert all((b - a) % 16 == 1 for a, b in pairwise(counters))
            assert all(crc_ok(spec, f.data) for f in mine)
            assert all(f.flags == 0 for f in mine)
            # Counter k belongs to the instant k cycles after the start; the stamp follows it.
            delay = [f.t_ns / 1e6 - cycle_ms * (k + 1) for k, f in enumerate(mine)]
            assert min(delay) > 0.1
            assert max(delay) < 2.0
    assert all(a.t_ns < b.t_ns for a, b in pairwise(out))


def test_cycle_times_come_from_the_dbc(tmp_path):
    cycles = {base + node: 4 for node in range(1, 17) for base in (0x180, 0x280)}
    slow = with_cycles(codec().path, tmp_path / "slow.dbc", cycles)
    out = run(Simulation(scenario(), codec(path=slow)), 0.4)
    assert abs(sum(f.can_id == 0x181 for f in out) - 100) <= 1
    assert abs(sum(f.can_id == 0x281 for f in out) - 100) <= 1


def test_volt_seconds_are_exact_and_fd_tells_the_same_story():
    classic = run(Simulation(scenario(**TIED), codec()), 0.5)
    fd_codec = codec(path=FD_FILE)
    fd = run(Simulation(scenario(**TIED), fd_codec), 0.5)
    spec = fd_codec.by_name["Drive2_Samples"]
    frames = [f for f in fd if f.can_id == spec.can_id]
    assert all(f.flags == FD | BRS and len(f.data) == 64 for f in frames)
    rows = values(fd, "Drive2_Samples", fd_codec)
    assert [r["SampleIndex"] for r in rows] == [8 * k for k in range(len(rows))]
    volts = np.array([[(r[f"Ualpha_{k}"], r[f"Ubeta_{k}"]) for k in range(8)] for r in rows])
    means = volts.reshape(-1, 2)[: 16 * (len(rows) // 2)].reshape(-1, 16, 2).mean(axis=1)
    told = np.array([(r["Ualpha"], r["Ubeta"]) for r in values(classic, "Drive2_StatorVoltages")])
    n = min(len(means), len(told))
    np.testing.assert_allclose(told[:n], means[:n], atol=0.125 + 0.051)
    amps = np.array([(r["Ia_7"], r["Ib_7"]) for r in rows])[1::2]
    told = np.array([(r["Ia"], r["Ib"]) for r in values(classic, "Drive2_PhaseCurrents")])
    np.testing.assert_allclose(told[:n], amps[:n], atol=0.025 + 0.011)


def test_numbers_on_the_wire_are_those_of_the_truth():
    simulation = Simulation(scenario(**TIED), codec())
    out = run(simulation, 1.0)
    truth = [r for r in simulation.truth_rows() if r.drive == 3]
    motion = values(out, "Drive3_Motion")
    for row, told in zip(truth, motion, strict=False):
        assert told["Speed"] == pytest.approx(row.speed_rad_s * 30 / math.pi, abs=0.26)
        assert told["ElectricalAngle"] == pytest.approx(math.degrees(row.angle_rad), abs=0.006)
    for told in values(out, "Drive3_PhaseCurrents"):
        assert told["Ia"] + told["Ib"] + told["Ic"] == pytest.approx(0.0, abs=0.031)
        assert told["Quality"] == 1
    status = values(out, "Drive3_Status")[-1]
    i_q = 18.0 / (1.5 * 4 * 0.1989)
    assert status["Irms"] == pytest.approx(i_q / math.sqrt(2), rel=0.01)
    assert status["State"] == 2
    assert truth[-1].load_nm == pytest.approx(18.0, abs=0.1)


def test_initial_angles_are_unknown_and_speed_is_rolling():
    simulation = Simulation(scenario(), codec())
    run(simulation, 0.01)
    first = simulation.truth_rows()
    assert len({round(r.angle_rad, 3) for r in first}) == 3
    assert all(r.speed_rad_s == pytest.approx(25.0, rel=0.01) for r in first)
    simulation = Simulation(scenario(motion={"start": "standstill", "angle_rad": 1.0}), codec())
    run(simulation, 0.01)
    assert all(abs(r.speed_rad_s) < 5.0 for r in simulation.truth_rows())


def test_lost_is_about_the_trains_demand():
    events = [
        {"at_s": 0.3, "for_s": 0.2, "drive": 1, "kind": "adhesion_loss", "depth": 0.2},
        {"at_s": 0.4, "for_s": 0.2, "drive": 2, "kind": "rail", "value": "leaves"},
    ]
    simulation = Simulation(scenario(event=events), codec())
    run(simulation, 1.0)
    lost = np.array([r.lost for r in simulation.truth_rows()]).reshape(-1, 3)
    times = (np.arange(len(lost)) + 1) * 0.01
    assert times[lost[:, 0] == 1] == pytest.approx(np.arange(0.30, 0.495, 0.01))
    slipping = times[lost[:, 1] == 1]
    assert 0.4 <= slipping[0] <= 0.42
    assert 0.59 <= slipping[-1] <= 0.62
    assert not lost[:, 2].any()
    # Wet rail carries 18 Nm: no loss although the creep is higher.
    wet = Simulation(scenario(load={"rail": "wet"}), codec())
    run(wet, 1.0)
    assert not any(r.lost for r in wet.truth_rows())


def test_disturbance_of_a_preset_load_is_a_loss():
    item = {"drive": 2, "at_s": 0.2, "for_s": 0.2, "amplitude_nm": 10.0}
    load = {"kind": "preset", "torque_nm": 20.0, "disturbance": [item]}
    simulation = Simulation(scenario(load=load), codec())
    run(simulation, 0.5)
    rows = [r for r in simulation.truth_rows() if r.drive == 2]
    assert min(r.load_nm for r in rows) == pytest.approx(10.0, abs=0.1)
    assert [r.t_s for r in rows if r.lost] == pytest.approx(np.arange(0.2, 0.395, 0.01))


def test_silence_takes_everything_and_gives_it_back():
    event = {"at_s": 0.3, "for_s": 0.3, "drive": 2, "kind": "silent"}
    out = run(Simulation(scenario(event=[event]), codec()), 1.0)
    nodes = [(f.t_ns * 1e-9, f.can_id & 0x3F) for f in out]
    assert not [t for t, n in nodes if n == 2 and 0.302 < t < 0.6]
    assert [t for t, n in nodes if n == 2 and t > 0.6]
    before = [f for f in out if f.can_id == 0x182 and f.t_ns < 302_000_000][-1]
    after = next(f for f in out if f.can_id == 0x182 and f.t_ns > 600_000_000)
    missing = round((after.t_ns - before.t_ns) / 2e6)
    assert ((after.data[1] - before.data[1]) & 15) == missing % 16


def test_loss_and_corruption_have_the_rates_asked_for():
    events = [
        {"at_s": 0.0, "drive": 1, "kind": "frame_loss", "depth": 0.2},
        {"at_s": 0.0, "drive": 2, "kind": "corrupt", "depth": 0.1},
    ]
    out = run(Simulation(scenario(event=events), codec()), 4.0)
    count = {n: sum(f.can_id == 0x180 + n for f in out) for n in (1, 2, 3)}
    assert count[1] / count[3] == pytest.approx(0.8, abs=0.03)
    assert count[2] == count[3]
    spec = codec().by_name["Drive2_PhaseCurrents"]
    bad = sum(not crc_ok(spec, f.data) for f in out if f.can_id == spec.can_id)
    assert bad / count[2] == pytest.approx(0.1, abs=0.025)
    whole = codec().by_name["Drive3_PhaseCurrents"]
    assert all(crc_ok(whole, f.data) for f in out if f.can_id == whole.can_id)


def readings(events, seconds, name, **table):
    simulation = Simulation(scenario(event=events, **table), codec())
    out = run(simulation, seconds)
    spec = codec().by_name[name]
    rows = [codec().decode(spec, f.data) for f in out if f.can_id == spec.can_id]
    return rows, simulation.truth_rows()


def test_temperature_sensor_faults():
    events = [
        {"at_s": 1.0, "drive": 1, "kind": "sensor_bias", "value": 5.0, "sensor": "drive_end"},
        {"at_s": 1.0, "drive": 1, "kind": "sensor_stuck"},
        {"at_s": 1.0, "drive": 1, "kind": "sensor_lost", "sensor": "ambient"},
    ]
    rows, truth = readings(events, 3.0, "Drive1_Temperatures", traffic="slow")
    early, late = rows[:9], rows[10:]
    step = np.mean([r["Tde"].value for r in late]) - np.mean([r["Tde"].value for r in early])
    assert step == pytest.approx(5.0, abs=0.2)
    assert len({r["Tstator"].raw for r in late}) == 1
    assert len({r["Tstator"].raw for r in early}) > 1
    assert {r["Tambient"].validity for r in late} == {Validity.NOT_AVAILABLE}
    assert {r["Tambient"].validity for r in early} == {Validity.VALID}
    end = [r for r in truth if r.drive == 1][-1]
    assert end.true_effect_k == pytest.approx(5.0, abs=0.1)
    assert {r.fault_class for r in truth if r.drive == 2} == {1}


def test_current_sensor_faults():
    events = [
        {"at_s": 0.2, "for_s": 0.2, "kind": "sensor_bias", "value": 3.0, "sensor": "current"},
        {"at_s": 0.5, "for_s": 0.1, "kind": "sensor_stuck", "sensor": "current"},
        {"at_s": 0.7, "for_s": 0.1, "kind": "sensor_lost", "sensor": "current"},
    ]
    rows, _ = readings(events, 1.0, "Drive1_PhaseCurrents", **TIED)
    total = np.array([sum(r[k].value for k in ("Ia", "Ib", "Ic")) for r in rows])
    time = (np.arange(len(rows)) + 1) * 2e-3
    np.testing.assert_allclose(total[time < 0.199], 0.0, atol=0.04)
    np.testing.assert_allclose(total[(time > 0.201) & (time < 0.399)], 3.0, atol=0.04)
    frozen = {rows[k]["Ia"].raw for k in np.flatnonzero((time > 0.501) & (time < 0.599))}
    assert len(frozen) == 1
    for k in np.flatnonzero((time > 0.701) & (time < 0.799)):
        assert {rows[k][n].validity for n in ("Ia", "Ib", "Ic")} == {Validity.NOT_AVAILABLE}


def test_currents_beyond_the_range_are_saturated():
    rows, _ = readings([], 0.2, "Drive1_PhaseCurrents", sensors={"current_range_a": 10.0})
    seen = {r["Ia"].validity for r in rows}
    assert seen == {Validity.VALID, Validity.SATURATED}


@pytest.mark.parametrize(
    ("event", "number", "signal"),
    [
        ({"kind": "overheating", "value": 300.0}, 2, "Tstator"),
        ({"kind": "cooling_loss", "depth": 1.0}, 3, "Tnde"),
        ({"kind": "bearing", "depth": 1.0}, 4, "Tde"),
        ({"kind": "bearing", "depth": 1.0, "sensor": "non_drive_end"}, 4, "Tnde"),
    ],
)
def test_thermal_faults_are_seen_and_told(event, number, signal):
    event = {"at_s": 1.0, "drive": 2, **event}
    table = {"traffic": "slow", "load": {"torque_nm": 28.0}}
    rows, truth = readings([event], 30.0, "Drive2_Temperatures", **table)
    before, after = (np.mean([r[signal].value for r in part]) for part in (rows[:9], rows[-5:]))
    end = truth[-2]
    assert (end.drive, end.fault_class) == (2, number)
    assert end.true_effect_k > 0.1
    assert after - before == pytest.approx(end.true_effect_k, abs=0.5)
    status, _ = readings([event], 2.0, "Drive2_Status", **table)
    assert status[-1]["FaultCode"].value == number
    assert status[0]["FaultCode"].value == 0


def test_slow_traffic_has_no_fast_messages():
    out = run(Simulation(scenario(traffic="slow"), codec()), 2.0)
    assert {f.can_id & 0x780 for f in out} == {0x380, 0x480, 0x180, 0x700}
    assert not [f for f in out if f.can_id in (0x181, 0x281)]
    full = run(Simulation(scenario(), codec()), 2.0)
    for name in ("Irms", "TorqueCommand"):
        a = values(out, "Drive1_Status")[-1][name]
        assert a == pytest.approx(values(full, "Drive1_Status")[-1][name], rel=0.02)


def test_thermal_start():
    first = {}
    for start in ("equilibrium", "ambient", 70.0):
        table = {"start": start, "ambient_c": 30.0}
        out = run(Simulation(scenario(thermal=table, traffic="slow"), codec()), 0.2)
        first[start] = values(out, "Drive1_Temperatures")[0]["Tstator"]
    assert first["ambient"] == pytest.approx(30.0, abs=2.5)
    assert first[70.0] == pytest.approx(70.0, abs=1.5)
    assert first["equilibrium"] > 45.0


def test_start_time_and_node_numbers():
    nodes = (4, 9)
    given = scenario(nodes=list(nodes), event=[{"at_s": 0.1, "drive": 9, "kind": "silent"}])
    base = run(Simulation(given, codec(nodes)), 0.3)
    simulation = Simulation(given, codec(nodes), start_ns=10**18)
    shifted = []
    for k in range(1, 31):
        shifted += simulation.step((), 10**18 + k * 10_000_000)
    assert [f._replace(t_ns=f.t_ns - 10**18) for f in shifted] == base
    assert {f.can_id & 0x3F for f in base} == {4, 9}
    assert not [f for f in base if f.can_id & 0x3F == 9 and f.t_ns > 102_000_000]
    assert {r.drive for r in simulation.truth_rows()} == {4, 9}
    assert simulation.step((), 10**18) == []


def test_what_cannot_be_simulated_is_refused():
    every = codec()
    fewer = Codec(every.path, [m for m in every.messages if m.node != 2], every.digest)
    with pytest.raises(ValueError, match="no messages of drive 2"):
        Simulation(scenario(), fewer)


def test_a_full_bus_drops_what_comes_too_late():
    simulation = Simulation(scenario(bus={"bitrate": 250_000}), codec())
    out = run(simulation, 0.5)
    assert all(a.t_ns < b.t_ns for a, b in pairwise(out))
    free = Simulation(scenario(bus={"bitrate": 0}), codec())
    assert len(run(free, 0.5)) > len(out) + 100


def test_another_motor():
    simulation = Simulation(scenario(motor={"name": "large"}, load={"torque_nm": 80.0}), codec())
    out = run(simulation, 1.0)
    assert simulation.truth_rows()[-1].load_nm == pytest.approx(80.0, abs=0.5)
    assert values(out, "Drive1_StatorVoltages")[-1]["Udc"] == pytest.approx(560.0, abs=8.0)


def test_creep_and_train_speed_are_those_of_the_wheel_and_the_train():
    """Leaves, no limiter: the wheel runs away from the train, which its speed does not show."""
    world = Simulation(find("runaway_sudden"), codec())
    rows = [row for row in run(world, 4.0) and world.truth_rows() if row.drive == 1]
    assert abs(rows[90].creep) < 0.01
    assert max(row.creep for row in rows) > 0.1
    for row in rows[:90]:
        wheel_m_s = row.speed_rad_s * world._plant.train.wheel_radius_m
        assert wheel_m_s == pytest.approx(row.train_speed_m_s * (1 + row.creep), rel=0.02)


def test_truth_as_text():
    simulation = Simulation(scenario(), codec())
    run(simulation, 0.01)
    text = simulation.truth_rows()[0].text()
    assert text[:2] == ("0.010", "1")
    assert len(text) == len(COLUMNS)
    assert text[-3] == "0"
    assert abs(float(text[-2])) < 0.01 < float(text[-1])
    assert float(text[2]) == pytest.approx(25.0, rel=0.01)
