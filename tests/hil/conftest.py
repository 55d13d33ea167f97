"""Tests marked `vcan` run where SocketCAN is real, and are reported here one by one.

A test run collects them as usual. At the first one a second pytest starts in a network
namespace or in user-mode-linux (`gateway.hil.vcan`), once, with all selected vcan tests; it writes
every report as a line, and each test here waits for its lines and passes them on as its own.
"""

import json
import os
import shlex
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from gateway.hil.vcan.job import Job
from gateway.hil.vcan.ways import way
from tests.hil.inside import environment
from tests.hil.stable import Stable

SILENCE_S = 1300.0
"""Longest time without any report before the inner run is given up."""
INNER_TIMEOUT_S = 1200
"""Limit of one test inside."""
LONG = 10
"""Both are so many times longer where the campaign runs in full."""
OWN_CLOCK = "the wall clock is set only where it is not the machine's own"
MAY_BE_SKIPPED = (OWN_CLOCK,)
"""Reasons for which a test may be skipped where SocketCAN is required.

That the machine stalled in every attempt is none: what is not proved has failed there."""


class Inside:
    """Plugin of the inner run: every report as one line of JSON."""

    def __init__(self, config, path):
        self._config = config
        self._file = path.open("a", encoding="utf-8")

    def pytest_runtest_logreport(self, report):
        data = self._config.hook.pytest_report_to_serializable(config=self._config, report=report)
        self._file.write(json.dumps(data, default=str) + "\n")
        self._file.flush()


class Outside:
    """Plugin of the outer run: starts the inner one and hands out its reports."""

    def __init__(self, config):
        self._config = config
        self._job = None
        self._directory = None
        self._read = 0
        self._reports = {}

    def reports(self, item):
        """The inner run's reports of a test; one failed report if there are none."""
        reason = way().reason
        if reason:
            return [self._not_here(item, reason)]
        directory = self._started(item.session)
        heard = time.monotonic()
        while True:
            ended = (directory / "done").exists() or (self._job and not self._job.running())
            if self._take_in(directory):
                heard = time.monotonic()
            found = self._reports.get(item.nodeid, [])
            if found and found[-1].when == "teardown":
                if self._config.getoption("--require-vcan"):
                    oblige(found)
                return found
            if ended and not (directory / "output").exists():
                return [self._not_here(item, self._told(directory, "did not start"))]
            if ended:
                return [_verdict(item, "failed", self._told(directory, "ended without a result"))]
            if time.monotonic() - heard > SILENCE_S * self._patience():
                if self._job is not None:
                    self._give_up()
                return [_verdict(item, "failed", self._told(directory, "fell silent"))]
            time.sleep(0.05)

    def _patience(self):
        return LONG if self._config.getoption("--counts") == "full" else 1

    def _not_here(self, item, reason):
        outcome = "failed" if self._config.getoption("--require-vcan") else "skipped"
        return _verdict(item, outcome, " ".join(reason.splitlines()[-2:]))

    def _started(self, session):
        """Directory of the inner run; started by whoever comes first (also of xdist workers)."""
        if self._directory is not None:
            return self._directory
        base = self._config._tmp_path_factory.getbasetemp()
        shared = hasattr(self._config, "workerinput")
        self._directory = (base.parent if shared else base) / "vcan"
        try:
            self._directory.mkdir()
            first = True
        except FileExistsError:
            first = False
        if first:
            log = str(self._directory / "warm.log")
            simulate = ("sim", "healthy", "--duration", "0.05", "-o", log)
            subprocess.run([sys.executable, "-m", "gateway", *simulate], check=True)
            wanted = [item.nodeid for item in session.items if item.get_closest_marker("vcan")]
            command = shlex.join(self._command(wanted))
            self._job = Job([command], self._directory, environment(self._directory))
        return self._directory

    def _command(self, wanted):
        assert self._directory is not None
        limit = INNER_TIMEOUT_S * self._patience()
        return [
            *(sys.executable, "-m", "pytest", "-v", "--color=no", "-p", "no:cacheprovider"),
            *("-p", "no:xdist", "-p", "no:randomly", "-o", f"timeout={limit}"),
            *("--counts", self._config.getoption("--counts")),
            *("--campaign-seed", str(self._config.getoption("--campaign-seed"))),
            *("--rootdir", str(self._config.rootpath), "--basetemp", f"{self._directory}/tmp"),
            *("-c", str(self._config.inipath)),
            *("--vcan-inside", f"{self._directory}/reports"),
            *wanted,
        ]

    def _take_in(self, directory):
        """Read the complete lines that are new."""
        path = directory / "reports"
        if not path.is_file():
            return False
        with path.open("rb") as file:
            file.seek(self._read)
            text = file.read()
        complete = text[: text.rfind(b"\n") + 1]
        self._read += len(complete)
        for line in complete.splitlines():
            report = self._config.hook.pytest_report_from_serializable(
                config=self._config, data=json.loads(line)
            )
            if isinstance(report.longrepr, list):  # JSON has no tuples; reasons of skips are
                report.longrepr = tuple(report.longrepr)
            self._reports.setdefault(report.nodeid, []).append(report)
        return bool(complete)

    def _told(self, directory, what):
        tail = self._job.tail() if self._job else "see the worker that started it"
        return f"the run inside ({directory}) {what}:\n{tail}"

    def pytest_unconfigure(self):
        if self._job is None:
            return
        # Other xdist workers may still wait for reports of the run that this one started.
        limit = time.monotonic() + SILENCE_S
        while hasattr(self._config, "workerinput") and self._job.running():
            if time.monotonic() > limit:
                break
            time.sleep(0.1)
        self._give_up()

    def _give_up(self):
        self._job.stop()
        (self._directory / "done").touch()


def oblige(reports):
    """What was skipped has failed: there is SocketCAN, but not all that the tests need of it."""
    for report in reports:
        reason = str(report.longrepr)
        if report.skipped and not any(allowed in reason for allowed in MAY_BE_SKIPPED):
            report.outcome = "failed"
            report.longrepr = f"may not be skipped with --require-vcan: {reason}"


def _verdict(item, outcome, text):
    where = (str(item.path), item.location[1] or 0, f"Skipped: {text}")
    return pytest.TestReport(
        nodeid=item.nodeid,
        location=item.location,
        keywords=dict.fromkeys(item.keywords, 1),
        outcome=outcome,
        longrepr=where if outcome == "skipped" else text,
        when="setup" if outcome == "skipped" else "call",
    )


@pytest.hookimpl(trylast=True)
def pytest_configure(config):
    inside = config.getoption("--vcan-inside")
    if inside:
        config.pluginmanager.register(Inside(config, Path(inside)), "vcan-inside")
    else:
        config.pluginmanager.register(Outside(config), "vcan-outside")


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item, nextitem):
    outside = item.config.pluginmanager.get_plugin("vcan-outside")
    if outside is None or item.get_closest_marker("vcan") is None:
        return None
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for report in outside.reports(item):
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    # Nothing was set up here, but what earlier tests share with this one may have to go.
    item.session._setupstate.teardown_exact(nextitem)
    return True


@dataclass
class Vcan:
    """Two virtual CAN interfaces that carry CAN FD, and what people do to them."""

    name: str = "vcan0"
    second: str = "vcan1"
    own_kernel: bool = os.environ.get("VCAN_INSIDE") == "uml"
    """True in user-mode-linux: clocks and modules are not those of the machine."""
    _started: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def link(self, action, name="", mtu=72):
        """`up`, `down`, `create` (and up) or `delete` an interface; the first one by default."""
        name = name or self.name
        commands = {
            "up": [f"link set {name} up"],
            "down": [f"link set {name} down"],
            "create": [f"link add {name} type vcan", f"link set {name} mtu {mtu} up"],
            "delete": [f"link delete {name}"],
        }
        for command in commands[action]:
            subprocess.run(["ip", *command.split()], check=True)

    def send(self, *texts, name=""):
        """Frames by can-utils, such as `181#0102`, `181#R`, `181##1AA` (FD)."""
        for text in texts:
            subprocess.run(["cansend", name or self.name, text], check=True)

    def record(self, path, name="", count=0):
        """`candump -L` into a file, listening on return; ends after `count` frames, if given.

        What it has not read when it is terminated is lost: leave it a quiet moment first.
        """
        name = name or self.name
        before = self.listeners(name)
        limit = ("-n", str(count)) if count else ()
        with path.open("wb") as file:
            process = self.start("candump", "-L", *limit, name, stdout=file)
        while self.listeners(name) == before:
            time.sleep(0.01)
        return process

    def listeners(self, name=""):
        """Number of sockets that receive everything from an interface."""
        text = Path("/proc/net/can/rcvlist_all").read_text(encoding="ascii")
        return sum(line.split()[:1] == [name or self.name] for line in text.splitlines())

    def start(self, *command, **options):
        """A process that is ended with the test."""
        self._started.append(subprocess.Popen(command, **options))
        return self._started[-1]

    def stop_all(self):
        """End what `start` started."""
        for process in self._started:
            process.terminate()
        for process in self._started:
            process.wait(timeout=60)
            for pipe in (process.stdin, process.stdout, process.stderr):
                if pipe is not None:
                    pipe.close()


@pytest.fixture
def vcan(request):
    """Fresh `vcan0` and `vcan1`, up; both are gone afterwards."""
    assert request.config.getoption("--vcan-inside"), (
        "mark tests that use `vcan` with the mark vcan"
    )
    bus = Vcan()
    for name in (bus.name, bus.second):
        bus.link("create", name)
    try:
        yield bus
    finally:
        bus.stop_all()
        for name in (bus.name, bus.second):
            subprocess.run(["ip", "link", "delete", name], check=False, capture_output=True)


@pytest.fixture
def own_clock(vcan):
    """Only in a kernel of our own: setting the wall clock would set that of the machine."""
    if not vcan.own_kernel:
        pytest.skip(OWN_CLOCK)


@pytest.fixture(scope="session")
def stable():
    """Where programs start without seconds of imports."""
    stable = Stable()
    yield stable
    stable.close()
