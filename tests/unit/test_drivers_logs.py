"""The log is bounded, whatever the bus does."""

import io
import json
import logging
import os
import subprocess
import sys
from datetime import datetime, timedelta
from pathlib import Path

import pytest

from dbc.codec import bind
from dbc.frame import MS, SECOND, Frame
from gateway.core.gateway import Gateway
from gateway.io import log_setup as logs
from gateway.io.canopen_node import CanopenNode
from gateway.io.live import Stop, run_live
from gateway.io.outputs import Outputs
from gateway.io.realtime import Ticker
from gateway.io.service import Manager, Overseer
from gateway.io.transport import LinkState, SendResult
from gateway.settings.config import parse
from tests.buses import Bus, Clock
from tests.programs import gateway


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def written(clock):
    """What a handler with the limit lets through of everything that is logged."""
    stream = io.StringIO()
    handler = logging.StreamHandler(stream)
    handler.addFilter(logs.Limited(clock.seconds))
    root = logging.getLogger()
    level = root.level
    root.addHandler(handler)
    root.setLevel(logging.DEBUG)
    yield stream
    root.setLevel(level)
    root.removeHandler(handler)


def test_a_place_in_the_code_has_ten_lines_a_minute(clock, written):
    log = logging.getLogger("storm")
    for k in range(1000):
        log.warning("frame %d is bad", k)
        clock.sleep(0.01)
    log.warning("another place")
    clock.sleep(60.0)
    for _ in range(2):
        for k in range(2):
            log.warning("100 %% of %d", k) if k else log.warning("else")
    lines = written.getvalue().splitlines()
    assert lines[:11] == [f"frame {k} is bad" for k in range(10)] + ["another place"]
    assert len(lines) == 15


def test_what_was_left_out_is_said_with_the_next_line(clock, written):
    log = logging.getLogger("storm")
    for k in range(25):
        clock.sleep(60.0 if k == 24 else 0.0)
        log.warning("100 %% of %d", k)
    lines = written.getvalue().splitlines()
    assert len(lines) == 11
    assert lines[-1] == "100 % of 24 (14 more suppressed)"


def test_what_nobody_has_told_of_is_counted():
    limit = logs.Limited(lambda: 0.0)
    record = logging.LogRecord("a", logging.INFO, "a.py", 1, "text", (), None)
    assert [limit.filter(record) for _ in range(13)] == [True] * 10 + [False] * 3
    assert limit.suppressed() == 3


class Storm(Bus):
    """Everything goes wrong in every tick, and never the same way twice."""

    tick = 0

    def waiting_frames(self):
        self.tick += 1
        k = self.tick
        self.status.state = LinkState.DOWN if k % 2 else LinkState.UP
        self.status.note = f"vcan0 is bad in way {k}"
        return [Frame(k, 0x181, bytes((k % 256, *range(7)))), Frame(k, 0x1A0, b"\x00" * 8),
                Frame(k, 0x000, b"\x80\x00"), Frame(k, 0x080 + 1, b"\x01" * 3),
                *(Frame(k, 0x700 + n, b"\x7f") for n in (1, 2, 3))]  # fmt: skip

    def send(self, frame):
        kinds = (SendResult.FAILED, SendResult.FULL, SendResult.DOWN, SendResult.REFUSED)
        return self.status.count(kinds[self.tick % 4])


@pytest.mark.usefixtures("loaded_frozen")
def test_a_storm_of_everything_is_a_few_lines_a_minute(clock, written):
    minutes = 1
    storm, stop = Storm(), Stop()
    config = parse({})
    core = Gateway(config, bind(config.dbc_path, config.nodes), clock.now)
    node = CanopenNode(config.nodes, nmt_master=True)
    # Nobody listens there: being unable to tell is a line of the log as well.
    manager = Manager("/nowhere/notify", SECOND)
    overseer = Overseer(Outputs(core.outbox.specs.values()), manager, "vcan0", 0)

    def on_tick(seen):
        overseer.completed(seen)
        if seen.tick >= minutes * 6000:
            stop()

    ticker = Ticker(10 * MS, clock, clock.sleep)
    run_live(core, storm, node, ticker, stop=stop, on_tick=on_tick)
    lines = written.getvalue().splitlines()
    causes = (
        "bus is", "another node sends", "another NMT master", "is not started", "watchdog not fed",
        "transmit queue is full", "cannot be notified",
    )  # fmt: skip
    for cause in causes:
        of = [line for line in lines if cause in line]
        assert 1 <= len(of) <= logs.MOST * (minutes + 1), cause
    assert storm.tick > 6000 * minutes
    assert len(lines) <= len(causes) * logs.MOST * (minutes + 1)
    assert any("more suppressed" in line for line in lines)


def test_lines_for_the_journal_carry_their_level():
    made = logs.Marked(logging.Formatter("%(name)s: %(message)s"))

    def line(level, text):
        return made.format(logging.LogRecord("bus", level, "", 1, text, (), None))

    assert line(logging.INFO, "up") == "<6>bus: up"
    assert line(logging.WARNING, "down") == "<4>bus: down"
    assert line(logging.ERROR, "a\nb") == "<3>bus: a\n<3>b"


def test_a_line_of_json_has_everything():
    def line(level, text, args=(), **more):
        record = logging.LogRecord("bus", level, "x.py", 1, text, args, more.pop("exc_info", None))
        vars(record).update(more)
        text = logs.Json().format(record)
        assert "\n" not in text
        return json.loads(text)

    got = line(logging.WARNING, 'a "b"\n%s', ("ä",), drive=2, t_s=1.5, where=Path("/x"))
    assert datetime.fromisoformat(got.pop("time")).utcoffset() == timedelta(0)
    assert got == {
        "level": "warning", "logger": "bus", "message": 'a "b"\nä', "drive": 2, "t_s": 1.5,
        "where": "/x",
    }  # fmt: skip
    try:
        raise ValueError("why")
    except ValueError:
        got = line(logging.ERROR, "broken", exc_info=sys.exc_info())
    assert got["traceback"].endswith("ValueError: why")


@pytest.mark.parametrize("form", ["--log-format=json", "--log-format json", "--log-f json"])
def test_the_log_of_a_verb_as_json(form):
    words = ["run", "-v", "-i", "virtual", "-c", "x", "--quiet", "--duration", "0.05"]
    done = gateway(*words, *form.split())
    assert done.returncode == 0
    lines = [json.loads(line) for line in done.stderr.splitlines() if line.startswith("{")]
    assert "configuration " in " ".join(line["message"] for line in lines)
    # An error where the machine is so busy that a tick comes too late to be sent.
    assert "info" in {line["level"] for line in lines}
    late = "watchdog not fed in this tick"
    others = [line for line in lines if not line["message"].startswith(late)]
    assert {line["level"] for line in others} <= {"info", "warning"}
    assert not [line for line in done.stderr.splitlines() if line.startswith(("INFO", "WARNING"))]


def test_an_error_ends_a_log_of_json_with_a_line_of_json():
    done = gateway("check", "no-such.toml", "--log-format", "json")
    assert done.returncode == 2
    got = json.loads(done.stderr)
    assert got["level"] == "error"
    assert "no-such.toml" in got["message"]


@pytest.mark.parametrize("journal", [True, False])
def test_stderr_is_the_journal_only_where_systemd_says_so(journal):
    read, write = os.pipe()
    there = os.fstat(write)
    inode = there.st_ino if journal else there.st_ino + 1
    program = (
        "import logging\nfrom gateway.io import log_setup as s\ns.begin(20)\nlogging.info('hi')"
    )
    subprocess.run(
        [sys.executable, "-c", program], stderr=write, check=True,
        env={**os.environ, "JOURNAL_STREAM": f"{there.st_dev}:{inode}"},
    )  # fmt: skip
    os.close(write)
    with os.fdopen(read) as pipe:
        assert pipe.read() == ("<6>root: hi\n" if journal else "INFO root: hi\n")
