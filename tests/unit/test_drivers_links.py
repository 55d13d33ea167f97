"""What netlink says of a link: answers taken apart, advice, and the thread that asks."""

import socket
import struct
import threading
import time

import pytest
from pyroute2.netlink.rtnl.ifinfmsg import ifinfmsg

from gateway.io import links
from gateway.io.links import Facts, Links, advice, facts, question
from gateway.io.wire import BusState
from tests.programs import printed

SET_UP = Facts(3, True, "can", BusState.ACTIVE, 100, 1_000_000, 5_000_000, 10)


def attribute(kind, content):
    return struct.pack("=HH", 4 + len(content), kind) + content + bytes(-len(content) % 4)


def answer(state=0, restart_ms=100, kind=b"can"):
    """RTM_NEWLINK as the kernel writes it (linux/if_link.h, linux/can/netlink.h)."""
    timing = struct.pack("=8I", 500_000, *range(7))
    data = attribute(1, timing) + attribute(4, struct.pack("=I", state))
    data += attribute(6, struct.pack("=I", restart_ms))
    info = attribute(1, kind + b"\0") + attribute(2, data)
    body = struct.pack("=BxHiII", 0, 280, 3, 0x10041, 0)
    body += attribute(3, b"can0\0") + attribute(13, struct.pack("=I", 10)) + attribute(18, info)
    return struct.pack("=IHHII", 16 + len(body), 16, 0, 1, 0) + body


@pytest.mark.parametrize(
    ("code", "state"), [(0, "active"), (1, "warning"), (2, "passive"), (3, "bus-off"), (4, None)]
)
def test_an_answer_of_a_controller(code, state):
    found = facts(answer(code))
    expected = None if state is None else BusState(state)
    assert found == Facts(3, True, "can", expected, 100, 500_000, 0, 10)


def test_a_virtual_link_has_no_controller():
    found = facts(answer(3, kind=b"vcan"))
    assert found is not None
    assert (found.kind, found.state, found.restart_ms) == ("vcan", None, 0)
    assert advice("vcan0", found) == []


def test_no_such_link_and_no_answer_are_none():
    failure = struct.pack("=IHHIIi", 36, 2, 0, 1, 0, -19) + bytes(16)
    assert facts(failure) is None
    assert facts(b"") is None


def test_the_question_is_what_the_library_reads():
    asked = ifinfmsg(question("can0"))
    asked.decode()
    assert asked["header"]["type"] == 18
    assert asked.get_attr("IFLA_IFNAME") == "can0"
    assert asked.get_attr("IFLA_EXT_MASK") == 8


@pytest.mark.parametrize(
    ("change", "cure"),
    [
        ({"restart_ms": 0}, "ip link set can0 type can restart-ms 100"),
        ({"queue": 1000}, "ip link set can0 txqueuelen 10"),
        ({"bitrate": 500_000}, "ip link set can0 type can bitrate 1000000"),
        ({"data_bitrate": 2_000_000}, "ip link set can0 type can dbitrate 5000000"),
    ],
)
def test_advice_names_the_command(change, cure):
    told = (1_000_000, 5_000_000)
    assert advice("can0", SET_UP, *told) == []
    (line,) = advice("can0", SET_UP._replace(**change), *told)
    assert line.startswith("can0: ")
    assert cure in line


def test_rates_that_nobody_named_or_knows_are_not_compared():
    assert advice("can0", SET_UP._replace(bitrate=500_000)) == []
    assert advice("can0", SET_UP._replace(bitrate=0), 1_000_000) == []


def test_a_link_of_this_machine_is_asked_for():
    """The loopback interface is everywhere; asking needs no right."""
    asker = Links("lo")
    began = time.monotonic_ns()
    assert asker.start()
    assert asker.start()  # again: nothing changes
    asked, found = asker.news()
    assert began <= asked <= time.monotonic_ns()
    assert found is not None
    assert found.ifindex == socket.if_nametoindex("lo")
    assert asker.advice() == []
    asker.hurry()
    while asker.news()[0] == asked:
        time.sleep(0.001)
    assert [t.name for t in threading.enumerate()].count("links") == 1
    asker.close()
    asker.close()
    assert "links" not in [t.name for t in threading.enumerate()]


def test_a_link_that_is_not_there():
    asker = Links("nosuchlink")
    assert asker.start()
    assert asker.news()[1] is None
    assert asker.advice() == []
    asker.close()


def test_without_netlink_nothing_is_started(monkeypatch):
    def refuse(*_):
        raise PermissionError

    monkeypatch.setattr(links.socket, "socket", refuse)
    assert not Links("lo").start()


def test_advice_is_said_once_and_again_when_it_changes(monkeypatch):
    asker = Links("can0", 500_000)
    monkeypatch.setattr(asker, "_found", (1, answer(restart_ms=0)))
    asker.news()
    assert len(asker.advice()) == 1
    assert asker.advice() == []
    monkeypatch.setattr(asker, "_found", (2, answer(restart_ms=100)))
    asker.news()
    assert asker.advice() == []
    monkeypatch.setattr(asker, "_found", (3, answer(restart_ms=0)))
    asker.news()
    assert len(asker.advice()) == 1


def test_the_library_is_loaded_at_start_and_not_before():
    """It takes as long as ten ticks; and who opens no SocketCAN should not wait for it."""
    program = """
import sys
from gateway.io import links
from gateway.io.bus import open_transport
assert not [name for name in sys.modules if name.startswith("pyroute2")]
asker = links.Links("nosuchlink")
assert asker.start()
assert "pyroute2.netlink.rtnl.ifinfmsg" in sys.modules
asker.close()
"""
    printed(program)
