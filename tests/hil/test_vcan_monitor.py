"""The monitor's source on a real bus, beside the gateway and simulated drives as processes."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

from gateway.core.codes import Flag
from gateway.io.bus import open_transport
from gateway.io.permission import Mode, allowed
from gateway.io.prepare import prepare
from gateway.monitor.model.observer import Observer
from gateway.monitor.sources import LiveSource, silently

pytestmark = pytest.mark.vcan

PATIENCE_S = 60.0
"""Loading a program takes seconds in user-mode-linux."""


def until(source, fulfilled, what):
    """Look ten times a second until it holds."""
    deadline = time.monotonic() + PATIENCE_S
    while not fulfilled(shown := source.advance(0.1)):
        assert time.monotonic() < deadline, f"{what}: not within {PATIENCE_S} s: {shown}"
        time.sleep(0.1)
    return shown


def transmitted(name):
    """Frames that this kernel has sent on an interface."""
    return int(Path(f"/sys/class/net/{name}/statistics/tx_packets").read_text("ascii"))


def test_a_monitor_sees_drives_and_gateway_and_sends_nothing(vcan):
    config, codec = prepare(None)
    bus = {"interface": "socketcan", "channel": vcan.name}
    transport = open_transport(silently(bus), allowed(Mode.LISTEN, config, codec))
    source = LiveSource(transport, Observer(codec, config), vcan.name)
    try:
        shown = source.advance(0.1)
        assert not shown.gateway.present
        assert shown.link.received == 0
        program = (sys.executable, "-m", "gateway")
        named = ("-i", "socketcan", "-c", vcan.name)
        gateway = vcan.start(*program, "run", *named, "--quiet", stdout=subprocess.DEVNULL)
        shown = until(source, lambda s: s.gateway.alive, "flags of the gateway")
        assert {row.adhesion for row in shown.drives} == {Flag.UNKNOWN}
        until(source, lambda s: s.gateway.heartbeat is not None, "its heartbeat")
        drives = vcan.start(*program, "sim", "healthy", *named, stdout=subprocess.DEVNULL)
        until(source, lambda s: all(r.stator_c is not None for r in s.drives), "temperatures")
        until(source, lambda s: all(r.state == "Operation" for r in s.drives), "state of drives")
        until(source, lambda s: s.gateway.config_hash is not None, "a configuration")
        shown = until(source, lambda s: s.lateness.total > 50, "lateness of flags")
        assert not [e for e in shown.events if "configuration" in e.text]
        drives.kill()
        drives.wait()
        silent = until(
            source, lambda s: all(r.heartbeat == "Silent" for r in s.drives), "silent drives"
        )
        assert {row.measured_speed_rad_s for row in silent.drives} == {None}
        gateway.kill()
        gateway.wait()
        gone = until(source, lambda s: not s.gateway.alive, "no flags")
        assert {row.adhesion for row in gone.drives} == {Flag.UNKNOWN}
        # Nobody else is left: whatever leaves now would be the monitor's.
        time.sleep(0.2)
        before = transmitted(vcan.name)
        for _ in range(10):
            source.advance(0.1)
        assert transmitted(vcan.name) == before
        assert transport.status.sent == 0
        vcan.link("down")
        until(source, lambda s: s.link.state == "down", "a link that is down")
    finally:
        source.close()
