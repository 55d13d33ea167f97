"""A gateway on a real bus through what happens in years: links that go, programs that die or hang.

The drives run in another process, and somebody else reads the flags (`observer.py`). A tenth of
each count by default, all of it with `--counts full` (`make campaign`). Times are random by
`--campaign-seed`, which every failure names.
"""

import signal
import subprocess
import time
from contextlib import contextmanager

import can
import pytest

from gateway.core.inbox import ELECTRICAL
from tests.hil.observer import GOOD, await_stop, end_process
from tests.hil.site import open_site

pytestmark = [pytest.mark.vcan, pytest.mark.slow, pytest.mark.thorough]

DOWNS, DELETIONS, KILLS, STOPS, SILENCES = 500, 200, 200, 200, 200
LONGEST_AGE_S = 0.1
"""Every electrical message is stale after it: three cycles of 20 ms and a tick, and some room."""
LONGEST_GOOD_S = 0.5
"""No flag says good on what is older: ten times its limit (R01)."""
FIRST_FRAMES = 5
MOST_LATE = 2
"""Flags of a start that may be decided too late to be sent."""


@pytest.fixture
def site(vcan, stable, request):
    with open_site(vcan, stable, request.config) as site:
        yield site


@contextmanager
def round_of(site, what, number):
    """Says which round failed, and that the gateway is as it was."""
    try:
        yield
        site.check_alive()
    except AssertionError as failure:
        said = (site.folder / "gateway.txt").read_text()[-2000:]
        pytest.fail(f"{what} {number} (see --campaign-seed): {failure}\nthe gateway said: {said}")


def away_s(rng):
    """How long something is away: often just a blink, else longer than anything stays fresh."""
    return rng.uniform(0.0, 0.05) if rng.random() < 0.25 else rng.uniform(LONGEST_AGE_S, 0.6)


def test_the_link_goes_down_and_up(site):
    site.run()
    site.drive()
    seen = site.observer()
    back = []
    for k in range(site.count(DOWNS)):
        with round_of(site, "down", k):
            seen.until(seen.all_good, "every drive adheres")  # so it is not deaf either
            seen.watch(site.rng.uniform(0.0, 0.2))
            away = away_s(site.rng)
            site.vcan.link("down")
            seen.forget()
            time.sleep(away)
            site.vcan.link("up")
            back.append(seen.until_flags(1))
            if away >= LONGEST_AGE_S:
                assert GOOD not in seen.flags[0].flags, f"good on stale data: {seen.flags[0]}"
    seen.close()
    site.note_times("link down and up", back)


def test_the_interface_is_deleted_and_made_again(site):
    site.run()
    site.drive()
    seen = site.observer()
    back = []
    for k in range(site.count(DELETIONS)):
        with round_of(site, "deletion", k):
            seen.until(seen.all_good, "every drive adheres")
            seen.watch(site.rng.uniform(0.0, 0.2))
            seen.close()
            away = away_s(site.rng)
            name = site.vcan.name
            site.vcan.link("delete")
            time.sleep(away)
            subprocess.run(["ip", "link", "add", name, "mtu", "72", "type", "vcan"], check=True)
            seen = site.observer()  # is there before the first frame
            site.vcan.link("up")
            back.append(seen.until_flags(1))
            if away >= LONGEST_AGE_S:
                assert GOOD not in seen.flags[0].flags, f"good on stale data: {seen.flags[0]}"
    seen.close()
    site.note_times("interface deleted and made again", back)


def test_the_gateway_is_killed(site):
    site.drive()
    seen = site.observer()
    back, late = [], 0
    for k in range(site.count(KILLS)):
        seen.forget()
        pid = site.run()
        with round_of(site, "kill", k):
            back.append(seen.until_flags(FIRST_FRAMES))
            first = seen.flags[:FIRST_FRAMES]
            assert {flag for said in first for flag in said.flags} == {0}, first
            assert 0 not in {said.reason for said in first}, first
            counters = [said.counter for said in first]
            # From 0 on, but for frames that a slow first tick has decided too late to be sent.
            assert counters[0] <= MOST_LATE, first
            assert counters == list(range(counters[0], counters[0] + FIRST_FRAMES)), first
            late += counters[0] > 0
            if site.rng.random() < 0.5:
                seen.until(seen.all_good, "every drive adheres")
            seen.watch(site.rng.uniform(0.0, 0.3))
        assert site.kill(pid) == -signal.SIGKILL
        seen.forget()
        seen.watch(0.03)
        assert seen.heard == 0, "something sends for a gateway that is dead"
    site.gateway = 0
    seen.close()
    site.note_times("gateway killed and started", back, "its fifth flag frame")
    site.note("of these starts the first flag was decided too late to be sent", times=late)


def test_the_gateway_is_stopped(site):
    """What was decided before a stop must not be said after it.

    Half of the stops come at any time, half between deciding and sending. In half of the rounds
    the drives are stopped, too, so that a flag that says good afterwards can only be an old one.
    """
    site.run()
    site.drive()
    seen = site.observer()
    back = []
    for k in range(site.count(STOPS)):
        with round_of(site, "stop", k):
            seen.until(seen.all_good, "every drive adheres")
            seen.watch(site.rng.uniform(0.0, 0.2))
            silent, between = site.rng.random() < 0.5, site.rng.random() < 0.5
            if between:
                site.trap.touch()
            else:
                end_process(site.gateway, signal.SIGSTOP)
            await_stop(site.gateway)
            if silent:
                end_process(site.drives, signal.SIGSTOP)
                await_stop(site.drives)
            seen.forget()
            seen.watch(site.rng.uniform(LONGEST_AGE_S + 0.05, 0.8))
            assert seen.heard == 0, f"{seen.heard} frames of a gateway that stands still"
            end_process(site.gateway, signal.SIGCONT)
            back.append(seen.until_flags(FIRST_FRAMES))
            if silent:
                old = [said for said in seen.flags if GOOD in said.flags]
                assert not old, f"good, said long after it was decided: {old}"
                end_process(site.drives, signal.SIGCONT)
    seen.close()
    site.note_times("gateway stopped and continued", back, "its fifth flag frame")


def test_the_drives_fall_silent(site):
    """How old a drive's last frame is, by the kernel's stamps, when its flag first says unknown."""
    electrical = [i for i, m in site.used.drives.items() if m.kind in ELECTRICAL]
    site.run()
    site.drive()
    seen = site.observer()
    only = [{"can_id": i, "can_mask": 0x7FF, "extended": False} for i in electrical]
    heard = can.Bus(interface="socketcan", channel=site.vcan.name, can_filters=only)
    age, last = [], dict.fromkeys(electrical, 0.0)

    def listen():
        while (message := heard.recv(0)) is not None:
            last[message.arbitration_id] = message.timestamp

    for k in range(site.count(SILENCES)):
        with round_of(site, "silence", k):
            seen.until(seen.all_good, "every drive adheres")
            seen.watch(site.rng.uniform(0.0, 0.2))
            listen()  # or the newest would find no room
            end_process(site.drives, signal.SIGSTOP)
            await_stop(site.drives)
            seen.forget()
            seen.until(lambda: seen.flags and GOOD not in seen.flags[-1].flags, "no flag is good")
            listen()
            seen.watch(0.05)
            for d, node in enumerate(site.used.nodes):
                # As old as the older of the two that a sample is made of.
                mine = [t for i, t in last.items() if site.used.drives[i].node == node]
                said = [flag.t_s for flag in seen.flags if flag.flags[d] != GOOD]
                good = [flag.t_s for flag in seen.flags if flag.flags[d] == GOOD]
                assert max(good, default=0.0) < min(said), (
                    f"good after unknown, and nobody sends: {seen.flags}"
                )
                # Of what was really sent: what is late is not, however slow the machine.
                assert max(good, default=0.0) - min(mine) < LONGEST_GOOD_S, seen.flags
                age.append(min(said) - min(mine))
            seen.forget()
            end_process(site.drives, signal.SIGCONT)
    heard.shutdown()
    seen.close()
    site.note_times("drives stopped", age, "first flag that says unknown")
