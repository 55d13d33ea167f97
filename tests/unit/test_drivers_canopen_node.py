"""Node 32: heartbeat, emergencies, and NMT start that only a lone master sends."""

import logging
from itertools import pairwise

import pytest
from canopen.emcy import EMCY_STRUCT, EmcyConsumer
from canopen.nmt import COMMAND_TO_STATE, NMT_COMMANDS, NMT_STATES, NmtSlave

from dbc.frame import ERROR, EXTENDED, MS, REMOTE, SECOND, Frame
from gateway.io.canopen_node import CanopenNode, GatewayError, error_register
from gateway.io.transport import Allow
from sim.canopen_ecu import CanopenNode as Drive

T0 = 77 * SECOND + 123
PRE_OPERATIONAL, OPERATIONAL = b"\x7f", b"\x05"


def heartbeat(node, state):
    return Frame(0, 0x700 + node, state)


def run(node, seconds, frames=None, t0=T0):
    """Step every 10 ms; `frames` by tick."""
    out = []
    for k in range(round(seconds * 100)):
        out += node.step((frames or {}).get(k, []), t0 + k * 10 * MS)
    return out


def test_boot_up_then_a_heartbeat_every_100_ms():
    out = run(CanopenNode(), 1.0)
    assert [f.can_id for f in out] == [0x720] * 11
    assert [f.data for f in out] == [b"\x00"] + [b"\x05"] * 10
    assert [(f.t_ns - T0) // MS for f in out[1:]] == [100 * k for k in range(10)]


def test_a_stall_gives_one_heartbeat_and_no_burst():
    node = CanopenNode()
    run(node, 0.05)
    late = node.step([], T0 + 5 * SECOND + 50 * MS)
    assert [f.data for f in late] == [b"\x05"]
    assert node.step([], T0 + 5 * SECOND + 90 * MS) == []
    assert len(node.step([], T0 + 5 * SECOND + 100 * MS)) == 1


def test_without_being_master_no_nmt_frame_is_ever_made():
    node = CanopenNode((1, 2, 3))
    frames = {k: [heartbeat(n, PRE_OPERATIONAL) for n in (1, 2, 3)] for k in range(0, 500, 10)}
    assert {f.can_id for f in run(node, 5.0, frames)} == {0x720}


def test_the_master_starts_configured_drives_one_by_one_after_listening():
    node = CanopenNode((1, 3), nmt_master=True)
    frames = {5: [heartbeat(n, PRE_OPERATIONAL) for n in (1, 2, 3)]}
    frames |= {k: [heartbeat(n, OPERATIONAL) for n in (1, 3)] for k in range(30, 300, 10)}
    out = [f for f in run(node, 3.0, frames) if f.can_id == 0x000]
    assert [f.data for f in out] == [b"\x01\x01", b"\x01\x03"]
    assert all(f.t_ns - T0 == 200 * MS for f in out)
    allow = Allow({}, started=(1, 3))
    assert all(allow.permits(f) for f in out)


def test_a_drive_that_stays_pre_operational_is_told_once_a_second():
    node = CanopenNode((4,), nmt_master=True)
    frames = {k: [heartbeat(4, PRE_OPERATIONAL)] for k in range(0, 1000, 10)}
    out = [f for f in run(node, 5.0, frames) if f.can_id == 0x000]
    assert [round((f.t_ns - T0) / SECOND, 1) for f in out] == [0.2, 1.2, 2.2, 3.2, 4.2]


@pytest.mark.parametrize("state", [b"\x00", b"\x04", b"\x05", b"", b"\x7f\x00"])
def test_only_pre_operational_drives_are_started(state):
    node = CanopenNode((1,), nmt_master=True)
    assert {f.can_id for f in run(node, 1.0, {0: [heartbeat(1, state)]})} == {0x720}


def test_another_master_ends_starting_for_good(caplog):
    node = CanopenNode((1,), nmt_master=True)
    frames = {k: [heartbeat(1, PRE_OPERATIONAL)] for k in range(0, 300, 10)}
    frames[7] = [Frame(0, 0x000, b"\x80\x00")]
    with caplog.at_level(logging.WARNING):
        out = run(node, 3.0, frames)
    assert {f.can_id for f in out} == {0x720}
    assert node.another_master
    assert caplog.text.count("another NMT master on the bus") == 1
    assert caplog.text.count("drive 1 is not started") == 3


@pytest.mark.parametrize("flags", [EXTENDED, REMOTE, ERROR])
def test_frames_that_are_no_nmt_command_do_not_stop_the_master(flags):
    node = CanopenNode((1,), nmt_master=True)
    frames = {0: [Frame(0, 0x000, b"", flags), heartbeat(1, PRE_OPERATIONAL)]}
    out = run(node, 1.0, frames)
    assert not node.another_master
    assert [f.data for f in out if f.can_id == 0x000] == [b"\x01\x01"]


def test_broadcast_is_no_drive():
    with pytest.raises(ValueError, match="broadcast"):
        CanopenNode((0, 1), nmt_master=True)


def emergencies(frames):
    consumer = EmcyConsumer()
    for frame in frames:
        if frame.can_id == 0x0A0:
            consumer.on_emcy(frame.can_id, frame.data, frame.t_ns / SECOND)
    return [(e.code, e.register) for e in consumer.log]


def test_faults_are_announced_on_change_and_reset_when_all_are_gone():
    node = CanopenNode()
    run(node, 0.1)
    node.set_errors([GatewayError.COMMUNICATION])
    out = run(node, 1.0, t0=T0 + SECOND)
    assert emergencies(out) == [(0x8130, 0x11)]
    node.set_errors({GatewayError.COMMUNICATION, GatewayError.OVERRUN})
    assert emergencies(run(node, 1.0, t0=T0 + 2 * SECOND)) == [(0x6100, 0x11)]
    node.set_errors([GatewayError.OVERRUN])
    assert emergencies(run(node, 1.0, t0=T0 + 3 * SECOND)) == []
    node.set_errors([])
    assert emergencies(run(node, 1.0, t0=T0 + 4 * SECOND)) == [(0, 0)]


def test_all_faults_at_once_come_one_per_inhibit_time():
    node = CanopenNode()
    node.set_errors(list(GatewayError))
    out = [f for f in run(node, 1.0) if f.can_id == 0x0A0]
    assert len(out) == len(GatewayError)
    assert {b.t_ns - a.t_ns for a, b in pairwise(out)} == {20 * MS}


def test_a_flapping_fault_is_bounded_by_the_inhibit_time():
    node = CanopenNode()
    out = []
    for k in range(1000):
        node.set_errors([GatewayError.SENSOR] if k % 2 else [])
        out += node.step([], T0 + k * MS)
    sent = [f for f in out if f.can_id == 0x0A0]
    assert 0 < len(sent) <= 50
    assert all(len(f.data) == 8 for f in sent)


def test_error_register_bits():
    assert error_register([]) == 0
    assert error_register([GatewayError.SENSOR]) == 0x21
    assert error_register(GatewayError) == 0xB1


def test_what_is_sent_is_what_the_library_reads():
    node = CanopenNode((4,), nmt_master=True)
    node.set_errors([GatewayError.SENSOR])
    out = run(node, 1.0, {0: [Frame(T0, 0x704, b"\x7f")]})
    assert [NMT_STATES[f.data[0]] for f in out if f.can_id == 0x720][:2] == [
        "INITIALISING", "OPERATIONAL",
    ]  # fmt: skip
    assert [tuple(f.data) for f in out if f.can_id == 0] == [(NMT_COMMANDS["OPERATIONAL"], 4)]
    [emergency] = [f for f in out if f.can_id == 0x0A0]
    assert EMCY_STRUCT.unpack(emergency.data) == (GatewayError.SENSOR, 0x21, bytes(5))


def test_a_simulated_drive_obeys_the_library_s_commands():
    for command, state in COMMAND_TO_STATE.items():
        library = NmtSlave(3, None)
        library._state = 5
        library.on_command(0, bytes((command, 3)), 0.0)
        drive = Drive(3, {}, lambda _kind: None, self_start=True)
        drive.deliver(0, bytes((command, 3)), 0)
        assert library._state == state
        # The library's stays in INITIALISING, a drive boots again.
        assert drive.state == (state or 5)
