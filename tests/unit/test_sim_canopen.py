"""The simulated inverter as a CANopen node, seen through frames."""

import struct
from itertools import pairwise

import pytest

from dbc.e2e import protect
from dbc.frame import Frame
from sim.canopen_sdo import EDS, OBJECTS, SdoServer
from sim.simulation import Simulation
from tests.simrun import FD_FILE, TICK, codec, run, scenario

BOOT, PREOP, OPERATIONAL, STOPPED = 0x00, 0x7F, 0x05, 0x04


def build(*, self_start=False, path=None, **table):
    return Simulation(
        scenario(**table), codec(path=path) if path else codec(), self_start=self_start
    )


def nmt(t_ns, command, node):
    return Frame(t_ns, 0, bytes([command, node]))


def sdo(node, *data):
    return Frame(0, 0x600 + node, bytes(data) + bytes(8 - len(data)))


def ask(simulation, frame, now):
    """One request, the answers within 10 ms."""
    answers = simulation.step([frame], now)
    return [f for f in answers if f.can_id == 0x580 + (frame.can_id & 0x7F)]


def upload(simulation, node, index, sub, now):
    (answer,) = ask(simulation, sdo(node, 0x40, index & 0xFF, index >> 8, sub), now)
    return answer.data


def states(frames, node):
    return [f.data[0] for f in frames if f.can_id == 0x700 + node]


def test_boots_and_stays_pre_operational():
    out = run(build(), 1.0)
    assert {f.can_id for f in out} == {0x701, 0x702, 0x703}
    assert states(out, 1) == [BOOT] + [PREOP] * 9
    beats = [f.t_ns for f in out if f.can_id == 0x702][1:]
    assert all(abs(b - a - 100_000_000) < 1_000_000 for a, b in pairwise(beats))


def test_self_start_goes_operational():
    out = run(build(self_start=True), 0.5)
    assert states(out, 1)[1:] == [OPERATIONAL] * 4
    assert {0x181, 0x281, 0x381} <= {f.can_id for f in out}


def test_nmt_start_is_node_addressed():
    simulation = build()
    run(simulation, 0.2)
    out = simulation.step([nmt(0, 1, 2)], 300_000_000)
    assert {f.can_id for f in out if f.can_id & 0x780 == 0x180} == {0x182}
    out += simulation.step([], 500_000_000)
    assert states(out, 2)[-1] == OPERATIONAL
    assert states(out, 1)[-1] == PREOP


def test_nmt_stop_preop_reset_and_broadcast():
    simulation = build(self_start=True)
    run(simulation, 0.225, 5_000_000)  # between two samples: nothing is in flight
    now = 225_000_000
    seen = []
    for command in (2, 128, 1, 129, 1, 130):
        now += 200_000_000
        out = simulation.step([nmt(0, command, 0)], now)
        seen.append((states(out, 3), any(f.can_id == 0x183 for f in out)))
    assert seen[0] == ([STOPPED] * 2, False)
    assert seen[1] == ([PREOP] * 2, False)
    assert seen[2] == ([OPERATIONAL] * 2, True)
    # A reset boots again: with self-start it is back in Operational at once.
    assert seen[3][0][0] == BOOT
    assert seen[3][0][-1] == OPERATIONAL
    assert seen[5][0][0] == BOOT


def test_reset_without_self_start_ends_pre_operational():
    simulation = build()
    run(simulation, 0.1)
    out = simulation.step([nmt(0, 1, 0)], 300_000_000)
    assert states(out, 1)[-1] == OPERATIONAL
    out = simulation.step([nmt(0, 129, 1)], 600_000_000)
    assert states(out, 1) == [BOOT, PREOP, PREOP]
    assert states(out, 2)[-1] == OPERATIONAL


def test_malformed_and_foreign_frames_do_nothing():
    simulation = build()
    run(simulation, 0.1)
    noise = [
        Frame(0, 0, b""), Frame(0, 0, b"\x01"), nmt(0, 77, 1), nmt(0, 1, 99),
        Frame(0, 0x601, b"\x40"), Frame(0, 0x601, bytes(8), 2), Frame(0, 0, b"\x01\x01", 4),
        Frame(0, 0x123, bytes(8)), Frame(0, 0x604, bytes(8)),
    ]  # fmt: skip
    out = simulation.step(noise, 400_000_000)
    assert states(out, 1) == [PREOP] * 3
    assert {f.can_id for f in out} == {0x701, 0x702, 0x703}


def test_sdo_reads_identity_and_process_data():
    simulation = build(self_start=True)
    out = run(simulation, 0.51)
    now = 520_000_000
    assert upload(simulation, 2, 0x1018, 4, now) == bytes([0x43, 0x18, 0x10, 4, 2, 0, 0, 0])
    name = upload(simulation, 2, 0x1008, 0, now + TICK)
    assert name[0] & 0xE0 == 0x40
    last = [f for f in out if f.can_id == 0x482][-1]
    raw = int.from_bytes(last.data, "little") >> 16 & 0xFFF
    answer = upload(simulation, 2, 0x2004, 4, now + 2 * TICK)
    assert struct.unpack("<H", answer[4:6])[0] == raw


def test_sdo_sees_signed_values_and_works_before_operational():
    simulation = build(load={"torque_nm": -18.0})
    run(simulation, 0.21)
    answer = upload(simulation, 1, 0x2005, 5, 220_000_000)
    assert struct.unpack("<h", answer[4:6])[0] == pytest.approx(-180, abs=3)


def test_sdo_aborts():
    simulation = build()
    run(simulation, 0.1)
    now = 110_000_000

    def code(frame, at):
        (answer,) = ask(simulation, frame, at)
        assert answer.data[0] == 0x80
        return struct.unpack("<I", answer.data[4:])[0]

    assert code(sdo(1, 0x40, 0x00, 0x50, 0), now) == 0x06020000
    assert code(sdo(1, 0x40, 0x18, 0x10, 9), now + TICK) == 0x06090011
    assert code(sdo(1, 0x2B, 0x00, 0x18, 5, 1, 0), now + 2 * TICK) == 0x06010002
    # Nothing is answered in Stopped.
    simulation.step([nmt(0, 2, 1)], now + 3 * TICK)
    assert ask(simulation, sdo(1, 0x40, 0x18, 0x10, 4), now + 4 * TICK) == []


def test_heartbeat_time_can_be_written():
    simulation = build()
    run(simulation, 0.1)
    (answer,) = ask(simulation, sdo(1, 0x2B, 0x17, 0x10, 0, 50, 0), 110_000_000)
    assert answer.data[0] == 0x60
    out = simulation.step([], 1_110_000_000)
    assert len(states(out, 1)) == 20
    assert len(states(out, 2)) == 10
    (answer,) = ask(simulation, sdo(1, 0x2B, 0x17, 0x10, 0, 0, 0), 1_120_000_000)
    assert answer.data[0] == 0x60
    assert states(simulation.step([], 2_120_000_000), 1) == []
    assert states(simulation.step([nmt(0, 129, 1)], 3_120_000_000), 1) == [BOOT]


def test_emcy_on_a_known_fault_and_its_reset():
    event = {"at_s": 0.3, "for_s": 0.4, "drive": 2, "kind": "overheating", "value": 100.0}
    simulation = build(self_start=True, event=[event])
    out = run(simulation, 1.0)
    emcy = [f for f in out if 0x081 <= f.can_id <= 0x083]
    assert [f.can_id for f in emcy] == [0x082, 0x082]
    assert struct.unpack("<HB", emcy[0].data[:3]) == (0x4310, 0x09)
    assert emcy[1].data == bytes(8)
    assert 0.3 <= emcy[0].t_ns * 1e-9 < 0.312
    assert 0.7 <= emcy[1].t_ns * 1e-9 < 0.712


@pytest.mark.parametrize("kind", ["sensor_stuck", "sensor_bias"])
def test_a_fault_the_drive_cannot_know_raises_no_emcy(kind):
    event = {"at_s": 0.1, "drive": 2, "kind": kind}
    if kind == "sensor_bias":
        event["value"] = 5.0
    out = run(build(self_start=True, event=[event]), 0.5)
    assert not [f for f in out if 0x081 <= f.can_id <= 0x083]


def test_error_register_is_readable():
    event = {"at_s": 0.1, "drive": 1, "kind": "cooling_loss", "depth": 1.0}
    simulation = build(event=[event])
    run(simulation, 0.2)
    assert upload(simulation, 1, 0x1001, 0, 210_000_000)[4] == 0x09
    assert upload(simulation, 2, 0x1001, 0, 220_000_000)[4] == 0


def test_tpdo_parameters_follow_the_dbc():
    simulation = build()
    run(simulation, 0.1)
    now = 110_000_000
    cobs, timers = [], []
    for k in range(5):
        cobs.append(struct.unpack("<I", upload(simulation, 3, 0x1800 + k, 1, now)[4:])[0])
        timers.append(struct.unpack("<H", upload(simulation, 3, 0x1800 + k, 5, now + TICK)[4:6])[0])
        now += 2 * TICK
    assert cobs == [0x183, 0x283, 0x383, 0x483, 0x1C3]
    assert timers == [2, 2, 10, 100, 100]
    fd = build(path=FD_FILE)
    run(fd, 0.1)
    assert struct.unpack("<I", upload(fd, 3, 0x1800, 1, 110_000_000)[4:])[0] == 0x80000183


def _mapped(maps, number):
    """(object, bits) of a PDO in order."""
    return [(v.index, v.subindex, v.length) for v in maps[number].map]


def _node(number=2):
    specs = {kind: codec().by_name[f"Drive{number}_{kind}"] for kind in OBJECTS.values()}
    node = SdoServer(number, specs, lambda _kind: None, lambda: 0, lambda _ms: None).node
    node.tpdo.read(from_od=True)
    node.rpdo.read(from_od=True)
    return node, specs


@pytest.mark.parametrize(("number", "kind"), list(enumerate(OBJECTS.values(), 1)))
def test_tpdo_mapping_gives_the_bytes_of_the_codec(number, kind):
    """For all five TPDOs: filling the library's PDO by its mapping equals codec and protection."""
    node, specs = _node()
    spec = specs[kind]
    pdo = node.tpdo[number]
    assert pdo.cob_id == spec.can_id
    numbers = {"Quality": 1, "Ia": -12.34, "Ib": 0.02, "Ic": 12.32, "Ualpha": -99.9, "Ubeta": 3.1,
               "Udc": 299.6, "Speed": -239.5, "ElectricalAngle": 359.99, "Torque": -17.9,
               "Irms": 12.5, "TorqueCommand": -18.1, "State": 2, "FaultCode": 0xABC,
               "Tstator": 93.4, "Tde": -40.0, "Tnde": 300.0, "Tambient": None}  # fmt: skip
    mine = {s.name: numbers[s.name] for s in spec.signals if s.name in numbers}
    payload = codec().encode(spec, mine)
    protect(spec, payload, 11)
    data = int.from_bytes(payload, "little")
    for k, signal in enumerate(spec.signals):
        raw = data >> signal.start & ((1 << signal.length) - 1)
        if signal.is_signed and raw >> signal.length - 1:
            raw -= 1 << signal.length
        pdo.map[k].raw = raw
    assert bytes(pdo.data) == bytes(payload)


def test_rpdo_mappings_have_the_layout_of_the_dbc():
    node, _ = _node()
    want = {
        2: "Drive2_Adhesion", 3: "Drive2_Thermal", 4: "Drive2_Estimate", 5: "Gateway_Adhesion",
        6: "Gateway_Faults",
    }  # fmt: skip
    for number, name in want.items():
        spec = codec().by_name[name]
        assert node.rpdo[number].cob_id == spec.can_id
        at, places = 0, []
        for index, _sub, length in _mapped(node.rpdo, number):
            if index != 0x2100:
                places.append((at, length))
            at += length
        assert at == 64
        assert places == [(s.start, s.length) for s in spec.signals]


def test_dictionary_has_an_object_for_every_signal():
    node, specs = _node()
    for index, kind in OBJECTS.items():
        record = node.object_dictionary[index]
        assert record.name == kind
        for k, signal in enumerate(specs[kind].signals, 1):
            assert record[k].name == signal.name
            if signal.offset == 0:
                assert record[k].factor == pytest.approx(signal.scale)
                assert record[k].unit == signal.unit
    assert {0x1000, 0x1001, 0x1014, 0x1017, 0x1018, 0x1200} <= set(node.object_dictionary)
    assert EDS.is_file()
