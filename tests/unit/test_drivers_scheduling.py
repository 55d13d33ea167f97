"""Real-time priority, locked memory, and what `check` says of the machine, with a cure."""

import os
import resource
import socket

import pytest

from gateway.io import interface_settings as settings
from gateway.io import scheduling
from gateway.io.links import Facts
from gateway.io.wire import BusState
from gateway.settings.config import ConfigError
from tests.programs import printed

REAL = """
import os, threading
from gateway.settings.config import ConfigError
from gateway.io.scheduling import be_ordinary, be_realtime, is_realtime
try:
    be_realtime(10)
except ConfigError as error:
    assert not is_realtime()
    print("refused", error)
else:
    kinds = []
    one = threading.Thread(target=lambda: kinds.append(os.sched_getscheduler(0)))
    one.start(), one.join()
    reset = bool(os.sched_getscheduler(0) & os.SCHED_RESET_ON_FORK)
    print("real", is_realtime(), reset, kinds == [os.SCHED_OTHER])
    be_ordinary()
    print("ordinary", not is_realtime())
"""

GIVEN = """
import os
from gateway.io import scheduling
try:
    os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(10))
except OSError as error:
    print("refused", error)
else:
    def refuse(*given):
        raise SystemExit("asked for a priority")
    os.sched_setscheduler = refuse
    scheduling.use_given()
    print(scheduling.described())
    scheduling.be_realtime(50)
    print(scheduling.described())
"""


def test_what_was_given_from_outside_is_used_and_not_asked_for():
    lines = printed(GIVEN)
    if lines[0].startswith("refused"):
        assert os.geteuid() != 0
        pytest.skip("this user may not have a real-time priority")
    for line in lines:
        assert line.startswith("SCHED_FIFO 10 reset on fork, ")
        assert int(line.split()[-3]) > 0, "MiB locked"
    assert len(lines) == 2


def test_an_ordinary_start_is_described():
    assert scheduling.described().startswith("SCHED_OTHER 0, ")


def test_a_thread_started_later_never_inherits_the_priority():
    lines = printed(REAL)
    if lines[0].startswith("refused"):
        said = "\n".join(lines)
        assert "CAP_SYS_NICE" in said or "ulimit -l" in said
    else:
        assert lines == ["real True True True", "ordinary True"]


def test_what_the_kernel_refuses_is_said_with_its_cure(monkeypatch):
    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with pytest.raises(ConfigError, match=r"SCHED_FIFO 50 refused.*CAP_SYS_NICE"):
        scheduling.be_realtime(50)
    assert not scheduling.is_realtime()


@pytest.mark.parametrize("priority", [0, 100, -1])
def test_a_priority_that_is_none_is_refused(priority):
    with pytest.raises(ConfigError, match=f"priority {priority} is not 1 to 99"):
        scheduling.be_realtime(priority)
    assert not scheduling.is_realtime()


CAN0 = Facts(3, True, "can", BusState.ACTIVE, 100, 500_000, 0, 10)


def proc(tmp_path, most):
    file = tmp_path / "net/core/rmem_max"
    file.parent.mkdir(parents=True)
    file.write_text(f"{most}\n")
    return tmp_path


@pytest.mark.parametrize(
    ("most", "privileged", "cured"),
    [(212_992, False, True), (212_992, True, False), (8 << 20, False, False)],
)
def test_the_receive_buffer(tmp_path, most, privileged, cured):
    found = settings.receive_buffer(proc(tmp_path, most), privileged=privileged)
    assert f"{most >> 10} KiB" in found.found
    assert bool(found.cure) is cured
    assert not cured or found.cure == "sysctl -w net.core.rmem_max=8388608"


def test_a_machine_without_proc_is_told(tmp_path):
    assert "cannot be read" in settings.receive_buffer(tmp_path).found


def test_rights_that_are_missing_are_named(monkeypatch):
    monkeypatch.setattr(settings.os, "geteuid", lambda: 1000)
    monkeypatch.setattr(resource, "getrlimit", lambda which: (0, 0))
    assert "rtprio 50" in settings.priority().cure
    assert settings.memory_lock().found == "at most 0 KiB"
    assert "LimitMEMLOCK" in settings.memory_lock().cure
    unlimited = (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
    monkeypatch.setattr(resource, "getrlimit", lambda which: unlimited)
    assert not settings.priority().cure
    assert not settings.memory_lock().cure


def test_a_good_link_needs_nothing():
    (only,) = settings.link_findings("can0", CAN0, 500_000, 0)
    assert only.found == "can, up, queue 10, 500000 bit/s, restart-ms 100, active"
    assert not only.cure


def test_a_bad_link_is_cured_line_by_line():
    bad = CAN0._replace(up=False, restart_ms=0, queue=1000, bitrate=250_000)
    first, *rest = settings.link_findings("can0", bad, 500_000, 0)
    assert first.cure == "ip link set can0 up"
    problems = [line.found for line in rest]
    assert problems[0].startswith("restart-ms is 0")
    assert "1000 frames of others" in problems[1]
    assert problems[2] == "bitrate is 250000, the gateway is configured for 500000"
    assert all(line.cure.startswith("ip link set can0") for line in rest)
    assert not any(line.found.startswith("can0:") for line in rest)


def test_a_kernel_without_can_says_what_to_do(monkeypatch):
    def refuse(*_):
        raise OSError(97, "Address family not supported by protocol")

    monkeypatch.setattr(socket, "socket", refuse)
    (only,) = settings.link("can0")
    assert "no SocketCAN in this kernel" in only.found
    assert "modprobe can_raw" in only.cure
