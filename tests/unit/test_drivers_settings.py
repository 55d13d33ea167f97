"""What `check` says of the machine: the figures, and a cure where one is needed."""

from __future__ import annotations

import resource
import socket

import pytest

from gateway.io import interface_settings as settings
from gateway.io.links import Facts
from gateway.io.wire import BusState

CAN0 = Facts(3, True, True, "can", BusState.ACTIVE, 100, 500_000, 0, 10)


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
    assert problems[2] == "bitrate is 250000, the gateway was told 500000"
    assert all(line.cure.startswith("ip link set can0") for line in rest)
    assert not any(line.found.startswith("can0:") for line in rest)


def test_a_kernel_without_can_says_what_to_do(monkeypatch):
    def refuse(*_):
        raise OSError(97, "Address family not supported by protocol")

    monkeypatch.setattr(socket, "socket", refuse)
    (only,) = settings.link("can0")
    assert "no SocketCAN in this kernel" in only.found
    assert "modprobe can_raw" in only.cure
