"""A scenario on a real bus, without the bus: what is judged, and how it ends."""

import os
import re
import signal
from argparse import Namespace
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree as ET

import pytest

from dbc.codec import bind
from dbc.frame import MS, SECOND
from gateway.cli import main
from gateway.core.gateway import Gateway
from gateway.hil import buses as hilbus
from gateway.hil.bench import Outcome
from gateway.hil.buses import bus_arguments, run_on_real_bus
from gateway.io.endings import Ended, raised
from gateway.io.realtime import Ticker
from gateway.reports.expectations import Verdict
from gateway.reports.reporting import Reporting, leave
from gateway.reports.truth import HEADER
from gateway.settings.config import parse
from sim.scenario import parse_text
from sim.simulation import Simulation
from tests.buses import Bus

pytestmark = pytest.mark.usefixtures("loaded_frozen")
LATE_NS = 200 * MS
"""The drives' program takes this long until it is on the bus."""
SCENARIO = """
title = "nothing happens"
seed = 1
duration_s = 1
drives = 2
[[expect]]
flag = "adhesion"
is = "good"
drive = "all"
within_ms = 500
[[expect]]
flag = "comm"
is = "bad"
never = true
"""


class World(Bus):
    """Drives, their process, the bus and its clock; the drives leave when the scenario ends."""

    def __init__(self, scenario, codec):
        super().__init__()
        self.now_ns = 0
        self.ended_ns = LATE_NS + round(scenario.duration_s * SECOND)
        self.terminated = False
        self.returncode = 0
        self.words = []
        self._simulation = Simulation(scenario, codec, self_start=False)

    def sleep(self, seconds):
        self.now_ns += round(seconds * SECOND)

    def waiting_frames(self):
        if not LATE_NS <= self.now_ns <= self.ended_ns:
            return []
        frames = self._simulation.step(self.sent, self.now_ns - LATE_NS)
        self.sent = []
        self.status.received += len(frames)
        return [f._replace(t_ns=f.t_ns + LATE_NS) for f in frames]

    def start(self, words):
        """The drives' process; of the truth it leaves one row."""
        self.words = words
        if "--truth" in words:
            path = Path(words[words.index("--truth") + 1])
            path.write_text(f"{','.join(HEADER)}\n0.010,1,2.5,0,9.5,0,1,0\n")
        return self

    def poll(self):
        """The process is gone a while after its last frame."""
        return 0 if self.now_ns > self.ended_ns + 100 * MS else None

    def terminate(self):
        self.terminated = True

    def wait(self, timeout):
        assert timeout > 0
        return 0


@pytest.fixture
def run(monkeypatch):
    def run(
        world, scenario, config, codec,
        left = None, progress = float,
    ):  # fmt: skip
        monkeypatch.setattr(
            hilbus, "Ticker", lambda period: Ticker(period, lambda: world.now_ns, world.sleep)
        )
        monkeypatch.setattr(hilbus, "open_present", lambda *_: world)
        monkeypatch.setattr(hilbus, "subprocess", SimpleNamespace(Popen=world.start))
        return run_on_real_bus(
            Namespace(), "nothing", scenario, config, codec, left, progress=progress
        )

    return run


def two_drives():
    """Scenario, configuration and codec."""
    scenario = parse_text(SCENARIO, "nothing")
    config = parse({"drive": [{"node": 1}, {"node": 2}]})
    return scenario, config, bind(config.dbc_path, config.nodes)


def test_time_starts_with_the_drives_and_their_leaving_is_not_judged(run):
    scenario, config, codec = two_drives()
    world = World(scenario, codec)
    shown = []
    outcome = run(world, scenario, config, codec, progress=shown.append)
    assert outcome.passed, outcome.verdicts
    assert shown == list(range(int(scenario.duration_s) + 1))
    assert outcome.gateway.view is not None
    assert outcome.gateway.view.comm == 2  # it was said, after the end
    assert world.now_ns < world.ended_ns + 200 * MS
    assert not world.terminated


class Interrupted(World):
    """Half-way through a signal comes."""

    number = signal.SIGINT

    def poll(self):
        if LATE_NS + 500 * MS < self.now_ns < LATE_NS + 520 * MS:
            os.kill(os.getpid(), self.number)
        return super().poll()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_run_that_a_signal_ends_has_no_verdict(run, number):
    scenario, config, codec = two_drives()
    world = Interrupted(scenario, codec)
    world.number = number
    with raised(), pytest.raises(Ended) as ended:
        run(world, scenario, config, codec)
    assert ended.value.number == number
    assert world.terminated


def test_drives_that_fail_give_no_verdict(run):
    scenario, config, codec = two_drives()
    world = World(scenario, codec)
    world.returncode = 2
    with pytest.raises(ChildProcessError, match="exit code 2"):
        run(world, scenario, config, codec)


def test_the_report_of_a_bus_has_its_timing_and_ends_with_the_scenario(run, tmp_path):
    scenario, config, codec = two_drives()
    left = Reporting(tmp_path / "s", config, codec)
    (tmp_path / "s" / "truth.csv").write_text("of another run\n")
    outcome = run(World(scenario, codec), scenario, config, codec, left)
    left.close()
    kept = left.run(scenario.title, [], inside="s/", verdicts=outcome.verdicts)
    leave(tmp_path, scenario.title, [kept], single=True)
    text = (tmp_path / "report.md").read_text()
    assert "| frame to flag |" in text
    assert "(s/timing.svg)" in text
    assert "virtual clock" not in text
    assert f"**Passed: {len(outcome.verdicts)} of {len(outcome.verdicts)} expectations" in text
    assert left.trace.span_s == 1.0
    assert left.truth is not None
    assert left.truth.nodes == {1}
    assert not list(left.intervals.other_bad()), "the drives' leaving is not the scenario's"
    assert "lateness" in (tmp_path / "s" / "timing.csv").read_text()
    assert (tmp_path / "report.html").read_text().count("data:image/svg+xml") == 4


class Slow(World):
    """The drives' process wakes every 30 ms and sends what was due since then."""

    def waiting_frames(self):
        if self.now_ns // (10 * MS) % 3:
            return []
        frames = super().waiting_frames()
        return [
            f._replace(t_ns=self.now_ns - (len(frames) - k) * 1000) for k, f in enumerate(frames)
        ]


class Standing(World):
    """The gateway's process stands still for five ticks, once."""

    def sleep(self, seconds):
        super().sleep(seconds)
        if LATE_NS + 500 * MS <= self.now_ns < LATE_NS + 510 * MS:
            self.now_ns += 50 * MS


@pytest.mark.parametrize(
    ("kind", "why"),
    [(World, ""), (Slow, "the drives' samples came up to .* ms late"),
     (Standing, "the gateway missed 5 ticks")],
)  # fmt: skip
def test_a_machine_that_cannot_keep_up_is_noticed(run, kind, why):
    scenario, config, codec = two_drives()
    outcome = run(kind(scenario, codec), scenario, config, codec)
    assert re.fullmatch(why, outcome.overload)
    assert outcome.inconclusive == (bool(why) and not outcome.passed)


@pytest.mark.parametrize(
    ("held", "overload", "code", "kind"),
    [(True, "", 0, ""), (False, "", 1, "failure"), (True, "late", 0, ""),
     (False, "late", 3, "error")],
)  # fmt: skip
def test_what_fails_on_such_a_machine_is_inconclusive(
    monkeypatch, tmp_path, capsys,
    held, overload, code, kind,
):  # fmt: skip
    def run(_o, _n, scenario, config, codec, _l, *, progress):
        progress(1.0)
        return Outcome(
            scenario, [Verdict("flag", held, "seen")], Gateway(config, codec, 0), overload
        )

    monkeypatch.setattr(hilbus, "run_on_real_bus", run)
    junit = tmp_path / "j.xml"
    assert main(["hil", "healthy", "-i", "virtual", "--junit", str(junit)]) == code
    printed = capsys.readouterr().out
    assert ("inconclusive, this machine could not keep up: late" in printed) == (code == 3)
    suite = ET.parse(junit).getroot()[0]
    counts = {each: int(suite.get(f"{each}s", 0)) for each in ("failure", "error")}
    assert counts == {each: int(each == kind) for each in counts}
    assert [case.tag for case in suite.iter() if case.tag in counts] == [kind] * bool(kind)


def test_bus_options_are_handed_on():
    options = Namespace(interface="socketcan", channel="vcan0", bitrate=None, fd=True)
    assert bus_arguments(options) == ["-i", "socketcan", "-c", "vcan0", "--fd"]
    assert bus_arguments(Namespace(data_bitrate=5_000_000)) == ["--data-bitrate", "5000000"]
    assert bus_arguments(Namespace(fd=False)) == []
