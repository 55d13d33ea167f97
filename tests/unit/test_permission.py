"""Who may send what: every identifier, every way to run, every channel."""

import random

import pytest

from dbc.codec import bind
from dbc.frame import BRS, ERROR, EXTENDED, FD, REMOTE, Frame
from gateway.core.gateway import Gateway
from gateway.io.bus import open_transport
from gateway.io.canopen_node import CanopenNode
from gateway.io.outputs import Outputs
from gateway.io.permission import Mode, allowed, drives_only
from gateway.io.transport import Guarded, SendResult
from gateway.settings.config import ConfigError, parse, shipped_dbc
from tests.buses import Bus

FLAGS = {0x1A0: 8, 0x2A0: 8, 0x3A0: 8, 0x4A0: 8}
SERVICE = {0x720: 1, 0x0A0: 8}
DRIVES = {0x400 + n: 8 for n in (1, 3)} | {0x500 + n: 8 for n in (1, 3)}
AUTH = {0x320: 8}
CREEP = {0x300 + n: 8 for n in (1, 3)}
OWN = FLAGS | SERVICE | DRIVES
EXTENDED_IDS = 10_000


def config(**sections):
    return parse({"drive": [{"node": 1}, {"node": 3}], **sections})


@pytest.fixture(scope="module")
def codec():
    return bind(shipped_dbc("traction.dbc"), (1, 3))


def drives_send(codec):
    out = {}
    for n in (1, 3):
        out |= {base + n: 8 for base in (0x180, 0x280, 0x380, 0x1C0, 0x480, 0x080, 0x580)}
        out[0x700 + n] = 1
    return out


CASES = {
    "run": (Mode.RUN, {}, OWN, set()),
    "run, authenticated": (Mode.RUN, {"authentication": {}}, OWN | AUTH, set()),
    "run, creep": (Mode.RUN, {"adhesion": {"send_creep": True}}, OWN | CREEP, set()),
    "run, master": (Mode.RUN, {"canopen": {"nmt_master": True}}, OWN, {1, 3}),
    "hil": (Mode.HIL, {}, OWN, {1, 3}),
    "listen": (Mode.LISTEN, {"canopen": {"nmt_master": True}}, {}, set()),
    "sim": (None, {}, None, set()),
}


def allow_of(name, codec):
    mode, sections, *_ = CASES[name]
    return drives_only(codec, (1, 3)) if mode is None else allowed(mode, config(**sections), codec)


@pytest.mark.parametrize("name", CASES)
def test_every_identifier_length_and_kind_in_every_mode(name, codec):
    *_, lengths, started = CASES[name]
    expected = drives_send(codec) if lengths is None else lengths
    allow = allow_of(name, codec)
    for can_id in range(0x800):
        for length in (*range(9), 12, 64):
            frame = Frame(0, can_id, bytes(length))
            assert allow.permits(frame) == (expected.get(can_id) == length), frame
            for flags in (REMOTE, ERROR, FD, FD | BRS, EXTENDED):
                assert not allow.permits(frame._replace(flags=flags)), (frame, flags)
    starts = {n for n in range(256) if allow.permits(Frame(0, 0, bytes((1, n))))}
    assert starts == started
    others = [(command, n) for command in range(256) if command != 1 for n in range(256)]
    assert not any(allow.permits(Frame(0, 0, bytes(pair))) for pair in others)


@pytest.mark.parametrize("name", CASES)
def test_no_extended_identifier_ever(name, codec):
    allow = allow_of(name, codec)
    rng = random.Random(name)
    ids = [rng.getrandbits(29) for _ in range(EXTENDED_IDS)] + list(range(0x800))
    lengths = (0, 1, 2, 8)
    assert not any(
        allow.permits(Frame(0, can_id, bytes(lengths[k % 4]), EXTENDED))
        for k, can_id in enumerate(ids)
    )


def test_fd_messages_are_allowed_as_fd_only():
    codec = bind(shipped_dbc("traction_fd.dbc"), (1, 3))
    allow = drives_only(codec, (1, 3))
    assert allow.permits(Frame(0, 0x181, bytes(64), FD | BRS))
    assert not allow.permits(Frame(0, 0x181, bytes(8)))
    assert not allow.permits(Frame(0, 0x182, bytes(64), FD | BRS))


def test_on_a_channel_that_is_not_named_nothing_is_opened(codec):
    allow = allowed(Mode.RUN, config(bus={"send_on": ["can0", "can2"]}), codec)
    Guarded(Bus(), allow, "can0")
    with pytest.raises(ConfigError, match=r"channel can1: \[bus\] send_on allows can0, can2"):
        Guarded(Bus(), allow, "can1")
    with pytest.raises(ConfigError, match="listen-only"):
        open_transport({"interface": "virtual", "channel": "x"}, allow)
    listening = allowed(Mode.LISTEN, config(bus={"send_on": ["can0"]}), codec)
    transport = open_transport({"interface": "virtual", "channel": "x"}, listening)
    assert transport.send(Frame(0, 0x1A0, bytes(8))) is SendResult.REFUSED
    assert transport.status.note == "", "who only listens has nothing to complain of"
    assert transport.status.silent
    transport.close()
    nowhere = allowed(Mode.RUN, config(bus={"send_on": []}), codec)
    with pytest.raises(ConfigError, match="allows none"):
        Guarded(Bus(), nowhere, "can0")


def test_a_frame_of_another_channel_is_refused(codec):
    sink = Bus()
    guarded = Guarded(sink, allowed(Mode.RUN, config(), codec), "can0")
    assert not guarded.status.silent
    flag = Frame(0, 0x1A0, bytes(8))
    assert guarded.send(flag._replace(channel="can1")) is SendResult.REFUSED
    assert guarded.send(flag._replace(channel="can0")) is SendResult.SENT
    assert guarded.send(flag) is SendResult.SENT
    assert len(sink.sent) == 2


def test_for_who_only_listens_a_refusal_is_no_fault(codec):
    """A service that listens is ready, and alive, all the same."""
    gateway = Gateway(config(), codec, 0)
    heartbeat = CanopenNode((1, 3))
    out = gateway.step([], 0) + heartbeat.step([], 0)
    refused = [SendResult.REFUSED] * len(out)
    specs = gateway.outbox.specs.values()
    assert Outputs(specs, listening=True).judge(out, refused, 0) == ""
    assert "was refused" in Outputs(specs).judge(out, refused, 0)
    failed = [SendResult.FAILED] * len(out)
    assert "was failed" in Outputs(specs, listening=True).judge(out, failed, 0)


def test_there_is_no_sdo_server_on_the_gateway(codec):
    """Every request, to it and to its drives, meets silence: no answer, no abort, no change."""
    chosen = config(canopen={"nmt_master": True})
    gateway, node = Gateway(chosen, codec, 0), CanopenNode((1, 3), nmt_master=True)
    sink = Bus()
    guarded = Guarded(sink, allowed(Mode.RUN, chosen, codec), "can0")
    quiet_gateway, quiet_node = Gateway(chosen, codec, 0), CanopenNode((1, 3), nmt_master=True)
    index = 0x1017.to_bytes(2, "little")
    for command in range(256):
        now = (command + 1) * 10_000_000
        requests = [
            Frame(now, 0x600 + n, bytes((command, *index, 0, 1, 2, 3, 4))) for n in (32, 1, 3)
        ]
        out = gateway.step(requests, now) + node.step(requests, now)
        alone = quiet_gateway.step([], now) + quiet_node.step([], now)
        assert [f.can_id for f in out] == [f.can_id for f in alone]
        for frame in out:
            assert guarded.send(frame) is SendResult.SENT
    answers = {base + n for base in (0x580, 0x600) for n in range(128)}
    assert not answers & {f.can_id for f in sink.sent}
    assert guarded.send(Frame(0, 0x5A0, bytes(8))) is SendResult.REFUSED
