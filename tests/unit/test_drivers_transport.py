"""Allow-list, guard and the factory that picks a transport."""

import argparse

import pytest
from can.cli import add_bus_arguments

from dbc.codec import bind
from dbc.frame import BRS, ERROR, EXTENDED, FD, REMOTE, Frame
from gateway.io.bus import bus_options, open_transport
from gateway.io.pythoncan import PythonCan
from gateway.io.transport import Allow, Guarded, LinkState, SendResult, monotonic_stamp
from gateway.settings.config import ConfigError, shipped_dbc
from tests.buses import Bus, frames_of

ALLOW = Allow({0x1A0: (8, False), 0x501: (64, True), 0x720: (1, False)}, started=(1, 2))

GOOD = [
    Frame(0, 0x1A0, bytes(8)),
    Frame(0, 0x501, bytes(64), FD | BRS),
    Frame(0, 0x720, b"\x05"),
    Frame(0, 0x000, b"\x01\x02"),
]
BAD = [
    Frame(0, 0x1A1, bytes(8)), Frame(0, 0x1A0, bytes(7)), Frame(0, 0x1A0, bytes(8), FD),
    Frame(0, 0x1A0, bytes(8), EXTENDED), Frame(0, 0x1A0, bytes(8), ERROR),
    Frame(0, 0x1A0, b"", REMOTE, "", 8), Frame(0, 0x501, bytes(64)), Frame(0, 0x000, b"\x01\x00"),
    Frame(0, 0x000, b"\x01\x03"), Frame(0, 0x000, b"\x02\x01"), Frame(0, 0x000, b"\x81\x01"),
    Frame(0, 0x000, b"\x01\x01", FD), Frame(0, 0x000, b"\x01\x01\x00"), Frame(0, 0x601, bytes(8)),
    Frame(0, 0x080, b""),
]  # fmt: skip


@pytest.mark.parametrize("frame", GOOD)
def test_allowed_frames_pass(frame):
    inner = Bus()
    assert Guarded(inner, ALLOW).send(frame) is SendResult.SENT
    assert inner.sent == [frame]


@pytest.mark.parametrize("frame", BAD)
def test_everything_else_is_refused_and_counted(frame):
    inner = Bus()
    guarded = Guarded(inner, ALLOW)
    assert guarded.send(frame) is SendResult.REFUSED
    assert inner.sent == []
    assert guarded.status.tx_refused == 1
    assert f"{frame.can_id:03X}#" in guarded.status.note


def test_spam_on_every_identifier_lets_nothing_else_out():
    inner = Bus()
    guarded = Guarded(inner, ALLOW)
    for flags in (0, EXTENDED, REMOTE, ERROR, FD, FD | BRS):
        for can_id in range(0x800):
            for length in (0, 1, 2, 8, 64):
                guarded.send(Frame(0, can_id, bytes(length), flags))
    assert {f.can_id for f in inner.sent} == {0x1A0, 0x501, 0x720}


def test_broadcast_nmt_cannot_even_be_configured():
    with pytest.raises(ValueError, match="broadcast"):
        Allow({}, started=(0, 1))
    with pytest.raises(ValueError, match="broadcast"):
        Allow({0x000: (2, False)})


@pytest.mark.parametrize("file", ["traction.dbc", "traction_fd.dbc"])
def test_the_list_of_a_dbc_is_the_gateways_own_messages_for_its_drives(file):
    codec = bind(shipped_dbc(file), (1, 2, 3))
    allow = Allow.from_codec(codec, (1, 3))
    allowed = {
        can_id
        for can_id in range(0x800)
        for length in range(65)
        for flags in (0, FD)
        if allow.permits(Frame(0, can_id, bytes(length), flags))
    }
    own = {0x1A0, 0x2A0, 0x3A0, 0x4A0, 0x720, 0x0A0}
    assert allowed == own | {0x501, 0x503, 0x401, 0x403}
    assert Allow.from_codec(codec, (1, 3), authenticated=True).permits(Frame(0, 0x320, bytes(8)))
    master = Allow.from_codec(codec, (1, 3), nmt_master=True)
    assert [n for n in range(128) if master.permits(Frame(0, 0, bytes((1, n))))] == [1, 3]


def test_the_guard_passes_everything_but_sending_through():
    inner = Bus()
    guarded = Guarded(inner, ALLOW)
    guarded.open()
    assert frames_of(guarded) == []
    guarded.close()
    assert inner.calls == ["open", "receive", "close"]
    assert guarded.status is inner.status


def test_stamps_move_only_between_the_last_read_and_now():
    assert monotonic_stamp(stamp_ns=990, real_ns=1000, now_ns=500, bound_ns=100) == 490
    assert monotonic_stamp(stamp_ns=0, real_ns=1000, now_ns=500, bound_ns=100) == 400
    assert monotonic_stamp(stamp_ns=5000, real_ns=1000, now_ns=500, bound_ns=100) == 500


def parsed(*arguments):
    parser = argparse.ArgumentParser()
    add_bus_arguments(parser)
    return parser.parse_args(arguments)


def test_options_are_python_cans_own():
    options = bus_options(
        parsed("-i", "virtual", "-c", "x", "--fd", "--bus-kwargs", "rx_queue_size=7")
    )
    assert options == {"interface": "virtual", "channel": "x", "fd": True, "rx_queue_size": 7}


def test_the_factory_opens_python_can_for_other_interfaces():
    transport = open_transport(parsed("-i", "virtual", "-c", "factory"))
    assert isinstance(transport, PythonCan)
    assert transport.status.state is LinkState.UP
    transport.close()
    guarded = open_transport({"interface": "virtual", "channel": "factory"}, ALLOW)
    assert isinstance(guarded, Guarded)
    assert guarded.send(Frame(0, 0x601, bytes(8))) is SendResult.REFUSED
    guarded.close()


def test_environment_names_the_interface(monkeypatch):
    monkeypatch.setenv("CAN_INTERFACE", "virtual")
    monkeypatch.setenv("CAN_CHANNEL", "from-env")
    transport = open_transport(parsed())
    assert isinstance(transport, PythonCan)
    assert transport.channel == "from-env"
    transport.close()


def test_no_interface_is_one_clear_line(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    for name in ("CAN_INTERFACE", "CAN_CHANNEL", "CAN_CONFIG"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(ConfigError, match="name one with -i and -c"):
        open_transport({})
    with pytest.raises(ConfigError, match="warp"):
        open_transport({"interface": "warp", "channel": "0"})


def test_socketcan_needs_a_channel(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("CAN_CHANNEL", raising=False)
    with pytest.raises(ConfigError, match="socketcan needs a channel: name one"):
        open_transport({"interface": "socketcan"})


@pytest.mark.parametrize("words", [["sim", "wet_one", "--duration", "1"], ["hil", "wet_one"]])
def test_simulated_drives_without_their_bus_are_an_error(words, monkeypatch, refused):
    def absent(**_options):
        raise OSError("the library was not found.")

    monkeypatch.setattr("can.Bus", absent)
    said = refused(*words, "-i", "pcan", "-c", "PCAN_USBBUS1")
    assert "bus: PCAN_USBBUS1 is not there: the library was not found; connect it" in said


def test_socketcan_takes_no_foreign_options():
    with pytest.raises(ConfigError, match="local_loopback: not an option of socketcan"):
        open_transport(
            {"interface": "socketcan", "channel": "vcan0", "bus_kwargs": {"local_loopback": 1}}
        )
