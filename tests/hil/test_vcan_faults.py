"""What a bus does to a gateway that runs: corruption by the kernel, other senders, a clock that
steps, frames of another kind. The counts are a tenth of what `--counts full` does.
"""

import itertools
import os
import re
import signal
import subprocess
import time
from collections import Counter, deque
from contextlib import contextmanager

import can
import pytest

from dbc.e2e import protect
from dbc.frame import Frame
from gateway.core.gateway import Gateway
from gateway.io.socketcan import SocketCan
from gateway.io.transport import EMCY_ID, HEARTBEAT_ID, SendResult
from gateway.settings.config import parse
from tests.hil.chain import TICK_NS, wait_for
from tests.hil.observer import GOOD, PATIENCE_S, await_stop, end_process
from tests.hil.site import open_site

pytestmark = [pytest.mark.vcan, pytest.mark.slow]

PATTERNS, PHASES = 60, 60
CURRENTS = 0x181
STALE, CORRUPTED, SEQUENCE, OVERRUN, INTRUDER = 2, 3, 4, 9, 10
OF_A_STALL = (STALE, SEQUENCE, OVERRUN)
"""Reasons beside the one that is tested, where the drives or the gateway stood still as well."""
FLAGS = 20
"""Flags that are looked at, at least."""
OWN, BATCH = 1_000_000, 200
YOUNGEST_S, OLDEST_S, TOGETHER = 0.02, 0.12, 6
"""Two senders are there if so many frames of each were heard between so long ago."""
ATTEMPTS = 20
"""A machine that stands still changes flags, too; a fault of ours does so every time."""


@pytest.fixture
def site(vcan, stable, request):
    with open_site(vcan, stable, request.config) as site:
        yield site


def test_a_gateways_own_frames_are_no_intruder(site):
    """Sent while the same socket is read, and heard by somebody else (R10)."""
    codec, name = site.used.codec, site.vcan.name
    bus, other = SocketCan(name), SocketCan(name)
    for each in (bus, other):
        each.open()
    gateway = Gateway(parse({"drive": [{"node": n} for n in site.used.nodes]}), codec, 0)
    gateway.integrity.watching = not bus.status.hears_itself
    assert gateway.integrity.watching
    ours = [Frame(0, m.can_id, bytes(m.length)) for m in codec.messages if m.is_gateway]
    ours += [Frame(0, identifier, bytes(8)) for identifier in (EMCY_ID, HEARTBEAT_ID)]
    ids = itertools.cycle(ours)
    rounds = site.count(OWN) // BATCH
    for k in range(rounds):
        sent = [bus.send(next(ids)) for _ in range(BATCH)]
        assert set(sent) == {SendResult.SENT}
        other.receive()
        gateway.step(bus.receive(), (k + 1) * TICK_NS)
        assert not gateway.integrity.intruder
    assert rounds * BATCH == site.count(OWN)
    wait_for(lambda: not other.receive().size and other.status.received >= site.count(OWN), "all")
    assert other.status.received == site.count(OWN)
    assert gateway.inbox.counts["own"] == 0
    # The same frames of somebody else are found at once.
    other.send(ours[0])
    ticks = itertools.count(rounds + 1)

    def found():
        gateway.step(bus.receive(), next(ticks) * TICK_NS)
        return gateway.integrity.intruder

    wait_for(found, "another sender")
    for each in (bus, other):
        each.close()


def cangw(rule):
    subprocess.run(["cangw", *rule.split()], check=True, stdout=subprocess.DEVNULL)


def handled():
    """Frames that the rule with a modification has let pass."""
    listed = subprocess.run(["cangw", "-L"], capture_output=True, text=True, check=False).stdout
    (line,) = [line for line in listed.splitlines() if "-m XOR" in line]
    found = re.search(r"# (\d+) handled (\d+) dropped", line)
    assert found is not None, line
    assert found[2] == "0", line
    return int(found[1])


class Imitator:
    """Sends drive 1's currents as well: the same values, well protected, its counter elsewhere."""

    def __init__(self, site):
        self._spec = site.used.drives[CURRENTS]
        only = [{"can_id": CURRENTS, "can_mask": 0x7FF, "extended": False}]
        self._bus = can.Bus(
            interface="socketcan",
            channel=site.vcan.name,
            can_filters=only,
            receive_own_messages=True,
        )
        self._own_kernel = site.vcan.own_kernel
        self._heard = []

    def speak(self, seconds, offset, found):
        """For so long and until it is found, one frame for each of the drive's, once heard."""
        while self._bus.recv(0) is not None:
            pass
        self._heard.clear()
        sent = deque(maxlen=4)
        end = time.monotonic() + seconds
        latest = end + PATIENCE_S
        with before_the_drives(self._own_kernel):
            while (now := time.monotonic()) < end or not found():
                assert now < latest, f"{offset} ahead: not found"
                message = self._bus.recv(0.05)
                if message is None:
                    continue
                of_drive = bytes(message.data) not in sent
                self._heard.append((message.timestamp, of_drive))
                if of_drive:
                    data = bytearray(message.data)
                    protect(self._spec, data, (data[1] & 0x0F) + offset)
                    message.data = data
                    sent.append(bytes(data))
                    self._bus.send(message)

    def shared_the_bus(self, t_s):
        """Whether the drive and this one were both heard several times just before.

        If the machine let one of them wait, what the two counters do may look like one sender's.
        """
        senders = [
            of_drive for heard_s, of_drive in self._heard if YOUNGEST_S < t_s - heard_s < OLDEST_S
        ]
        return min(senders.count(True), senders.count(False)) >= TOGETHER

    def close(self):
        self._bus.shutdown()


@contextmanager
def before_the_drives(own_kernel):
    """Before the drives and after the gateway, where all of them share one processor."""
    if not own_kernel:
        yield
        return
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(15))
    try:
        yield
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def reasons_of(seen):
    """Reasons of the flags since `forget`."""
    seen.take()
    return {said.reason for said in seen.flags}


def first_of(seen):
    """What the frames since `forget` say of drive 1."""
    seen.take()
    return {said.flags[0] for said in seen.flags}


def test_frames_that_the_kernel_corrupts_are_never_used(site):
    """One to three flipped bits anywhere in drive 1's currents, header included."""
    way = f"-s {site.vcan.second} -d {site.vcan.name} -e"
    clean = f"{way} -f {CURRENTS:X}:7FF"
    cangw(f"-A {way} -f {CURRENTS:X}~7FF")
    cangw(f"-A {clean}")
    site.run()
    site.drive(site.vcan.second)
    seen = site.observer()
    corrupted = 0
    for _ in range(site.count(PATTERNS)):
        seen.until(seen.all_good, "every drive adheres")
        bits = sum(1 << bit for bit in site.rng.sample(range(64), site.rng.randint(1, 3)))
        flip = f"{clean} -m XOR:D:0.0.{bits.to_bytes(8, 'big').hex().upper()}"
        cangw(f"-A {flip}")
        cangw(f"-D {clean}")
        seen.forget()
        seen.until(lambda: first_of(seen) - {GOOD}, f"doubt after XOR {bits:016x}")
        seen.until(lambda: seen.flags[-1].reason == CORRUPTED, f"reason of XOR {bits:016x}")
        seen.forget()
        seen.watch(site.rng.uniform(0.2, 0.5))
        seen.until_flags(FLAGS)
        assert GOOD not in first_of(seen), f"XOR {bits:016x}: good on corrupted currents"
        reasons = Counter(said.reason for said in seen.flags)
        assert reasons.keys() <= {CORRUPTED, *OF_A_STALL}, f"XOR {bits:016x}: {reasons}"
        assert reasons[CORRUPTED] > reasons.total() / 2, f"XOR {bits:016x}: {reasons}"
        end_process(site.drives, signal.SIGSTOP)  # while it is counted
        await_stop(site.drives)
        corrupted += handled()
        cangw(f"-D {flip}")
        cangw(f"-A {clean}")
        end_process(site.drives, signal.SIGCONT)
        site.check_alive()
    assert site.kill(site.drives, signal.SIGTERM) == 128 + signal.SIGTERM
    assert site.kill(site.gateway, signal.SIGTERM) == 0
    summary = (site.folder / "gateway.txt").read_text()
    counted = re.search(r"\berror (\d+)", summary)
    assert counted is not None, summary
    site.note("frames corrupted by the kernel", frames=corrupted, counted=int(counted[1]))
    assert corrupted == int(counted[1])
    seen.close()


def test_a_second_sender_of_a_drives_identifiers_is_found(site):
    """In another process, right by itself, at any distance of the counters but the nearest.

    It is found every time; that nothing is good meanwhile is judged where both were heard.
    """
    imitator = Imitator(site)
    site.run()
    site.drive()
    seen = site.observer()
    judged = []
    phases, latest = 0, time.monotonic() + 4 * PATIENCE_S
    while phases < site.count(PHASES) or (
        len(judged) <= 10 * phases and not site.vcan.own_kernel and time.monotonic() < latest
    ):
        phases += 1
        seen.until(seen.all_good, "every drive adheres")
        seen.watch(site.rng.uniform(0.0, 0.02))
        offset = site.rng.randint(3, 13)
        seen.forget()
        imitator.speak(site.rng.uniform(0.4, 0.9), offset, lambda: SEQUENCE in reasons_of(seen))
        site.check_alive()
        judged += [(offset, said) for said in seen.flags if imitator.shared_the_bus(said.t_s)]
    good = [each for each in judged if each[1].flags[0] == GOOD]
    assert not good, (len(good), len(judged), good[:9])
    assert len(judged) > 10 * phases or site.vcan.own_kernel
    site.note("second senders", times=phases, flags=len(judged), good=len(good))
    seen.close()
    imitator.close()


@pytest.mark.usefixtures("own_clock")
def test_a_step_of_the_clock_changes_no_flag(site):
    site.run()
    site.drive()
    seen = site.observer()
    changed = []
    for _ in range(ATTEMPTS):
        seen.until(seen.all_good, "every drive adheres")
        seen.watch(0.5)
        seen.forget()
        started, real = time.monotonic(), time.time()
        try:
            for step_s in (3600, -3600, 0):
                passed = time.monotonic() - started
                time.clock_settime(time.CLOCK_REALTIME, real + passed + step_s)
                seen.watch(0.5)
                seen.until_flags(50)
        finally:
            time.clock_settime(time.CLOCK_REALTIME, real + time.monotonic() - started)
        other = [said for said in seen.flags if set(said.flags) != {GOOD}]
        if not other:
            break
        changed.append(str(other[0]))
    else:
        pytest.fail(f"flags changed each time: {changed}")
    site.check_alive()
    seen.close()


def test_an_intruder_is_told_for_good_where_flags_shall_go_on(vcan, stable, request):
    with open_site(vcan, stable, request.config, '[bus]\non_intruder = "go_on"\n') as site:
        site.run()
        site.drive()
        seen = site.observer()
        seen.until(seen.all_good, "every drive adheres")
        second = site.another_gateway()
        seen.until(lambda: seen.flags[-1].reason == INTRUDER, "an intruder")
        assert site.kill(second) == -signal.SIGKILL
        seen.forget()
        seen.until(
            lambda: seen.flags and seen.flags[-1].reason == INTRUDER, "the same of the first"
        )
        seen.forget()
        seen.watch(2.0)
        seen.until_flags(51)
        assert {said.reason for said in seen.flags} == {INTRUDER}
        assert not [said for said in seen.flags if GOOD in said.flags]
        site.check_alive()
        seen.close()
