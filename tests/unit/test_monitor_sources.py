"""Bus and log as sources: seeking equals playing, what replay wrote is seen, nothing is sent."""

import csv
import random
import threading
import time

import pytest

from dbc.frame import Frame
from dbc.frames import block_of
from gateway.cli import main
from gateway.core.codes import Flag
from gateway.io.log_file import BadLogError
from gateway.io.permission import Mode, allowed
from gateway.io.transport import Guarded, LinkState, SendResult, Status
from gateway.io.wire import BusState
from gateway.monitor import log_source, sources
from gateway.monitor.log_source import LogSource
from gateway.monitor.sources import LiveSource, silently
from gateway.reports.record import ADHESION, FAULT
from tests.monitored import TICK, config_of, play, recorded
from tests.simrun import codec, log_of

MS = 1_000_000


def source(path, **options):
    return LogSource(path, lambda: recorded().observer(**options))


def test_what_is_seen_in_a_log_is_what_replay_wrote(tmp_path):
    """The drives' log, replayed; its flags put beside the drives' frames, then looked at."""
    run = recorded()
    drives, flags, both = (tmp_path / name for name in ("drives.log", "flags.log", "both.log"))
    log_of(drives, run.drives)
    assert main(["replay", str(drives), "-o", str(flags), "--results", str(tmp_path)]) == 0
    lines = drives.read_text().splitlines() + flags.read_text().splitlines()
    both.write_text("\n".join(sorted(lines, key=lambda line: line[: line.index(")")])) + "\n")
    rows = list(csv.DictReader((tmp_path / "flags.csv").read_text().splitlines()))
    shown = source(both)
    first = float(rows[0]["t_s"])
    compared = set()
    for k in range(5, len(rows) // 3 - 1):
        tick = rows[3 * k : 3 * k + 3]
        seen = shown.seek(float(tick[0]["t_s"]) - first)
        for row, said in zip(seen.drives, tick, strict=True):
            assert (str(row.node), ADHESION[row.adhesion]) == (said["drive"], said["adhesion"])
            compared.add(ADHESION[row.adhesion])
            assert FAULT[row.thermal] == said["thermal"]
    assert compared == {"Unknown", "Adhering", "AdhesionLost"}


def test_seeking_gives_exactly_what_playing_gives(log, monkeypatch):
    monkeypatch.setattr(log_source, "CHECKPOINT_NS", 300 * MS)
    monkeypatch.setattr(log_source, "CHECKPOINTS", 4)
    monkeypatch.setattr(log_source, "PATIENCE_S", 60.0)
    seeking, times = source(log), random.Random(7)
    end = seeking.span_s[1]
    for t_s in (end, 0.0, 1.3, 1.29, 2.9, *(times.uniform(0, end) for _ in range(6))):
        sought = seeking.seek(t_s)
        assert abs(sought.t_s - t_s) <= 0.0101
        playing = source(log)
        at = 0.0
        while at < t_s - 1e-9:
            step = min(times.uniform(0.01, 0.4), t_s - at)
            at += step
            # To the nanosecond where the seek went, however the steps are rounded.
            played = playing.seek(t_s) if at >= t_s - 1e-9 else playing.advance(step)
        if t_s:
            assert played == sought
    assert seeking.seek(-5.0).t_s == 0.0
    assert seeking.seek(99.0).t_s == pytest.approx(end, abs=0.0101)


def test_playing_follows_the_speed_pauses_and_ends(log, monkeypatch):
    # A page waits for no more than a part of a second; here the machine may be slow.
    monkeypatch.setattr(log_source, "PATIENCE_S", 60.0)
    shown = source(log)
    shown.speed = 2.0
    assert shown.advance(0.2).t_s == pytest.approx(0.4, abs=0.0101)
    shown.paused = True
    assert shown.advance(5.0).t_s == pytest.approx(0.4, abs=0.0101)
    shown.paused = False
    for _ in range(100):
        last = shown.advance(0.5)
    assert shown._at_ns == shown._last_ns
    assert not shown.behind
    assert last.t_s == pytest.approx(shown.span_s[1], abs=0.0101)
    assert last.span_s == shown.span_s
    # At the end of a log nothing grows old.
    assert last.gateway.alive


def test_an_impatient_seek_goes_on_by_itself(log):
    shown = source(log)
    part = shown.seek(2.5, 0.0)
    assert shown.behind
    assert 0.0 < part.t_s < 2.5
    while shown.behind:
        part = shown.advance(0.1)
    assert part.t_s == pytest.approx(2.5, abs=0.0101)
    assert part == source(log).seek(2.5)


def test_frames_whose_time_goes_back_are_left_out_as_replay_does(tmp_path):
    run = recorded()
    path = log_of(tmp_path / "back.log", [f for f in run.frames if f.t_ns < 800 * MS])
    lines = path.read_text().splitlines()
    back = [line.replace(line[: line.index(")")], "(0.000001") for line in lines[100:2000:100]]
    for k, line in enumerate(back):
        lines.insert(150 + 101 * k, line)
    path.write_text("\n".join(lines) + "\n")
    shown = source(path).seek(5.0)
    assert shown.link.rejected["time_back"] == len(back) == 19
    halting = source(path)
    while halting._at_ns < halting._last_ns:
        halting.seek(halting._at_ns / 1e9 + 0.013)
    assert halting.seek(5.0).link.rejected["time_back"] == 19


def test_a_hole_of_years_is_played_and_sought_through(tmp_path, monkeypatch):
    """A clock that is set after the start: 1970, and then today."""
    monkeypatch.setattr(log_source, "PATIENCE_S", 60.0)
    run = recorded()
    years = 1_700_000_000 * 1_000_000_000
    early = [f for f in run.frames if f.t_ns <= 400 * MS]
    late = [f._replace(t_ns=f.t_ns + years) for f in run.frames if f.t_ns <= 400 * MS]
    path = log_of(tmp_path / "hole.log", early + late)
    sought = source(path).seek(years / 1e9 + 0.4)
    assert sought.drives[0].adhesion is Flag.GOOD
    playing = source(path)
    looks = 0
    while playing._at_ns < playing._last_ns:
        shown = playing.advance(0.5)
        looks += 1
    assert looks < 200
    assert shown == sought
    assert "gateway's flags no longer received" in [e.text for e in shown.events]


def test_logs_that_cannot_be_watched_are_refused(tmp_path):
    empty = tmp_path / "empty.log"
    empty.write_text("")
    with pytest.raises(BadLogError, match="no frame"):
        source(empty)
    two = tmp_path / "two.log"
    two.write_text("(0.000001) can0 181#00\n(0.000002) can1 181#00\n")
    with pytest.raises(BadLogError, match="--log-channel"):
        source(two)
    with pytest.raises(BadLogError, match="no such file"):
        source(tmp_path / "none.log")


class Fake:
    """A transport that gives the frames of a list by the clock; reads are counted."""

    def __init__(self, frames):
        self.frames = sorted(frames, key=lambda f: f.t_ns)
        self.now = 0
        self.status = Status(state=LinkState.UP)
        self.given = self.closed = self.reads = 0
        self.hangs = threading.Event()
        self.hangs.set()

    def receive(self):
        self.hangs.wait()
        time.sleep(0.0005)
        first, now = self.given, self.now
        while self.given < len(self.frames) and self.frames[self.given].t_ns <= now:
            self.given += 1
        self.reads += 1
        return block_of(self.frames[first : self.given])

    def at(self, now):
        """Let it be that late, and everything until then be read."""
        self.now = now
        before = self.reads
        while self.reads < before + 3:
            time.sleep(0.0005)

    def send(self, frame):
        raise AssertionError(frame)

    def close(self):
        self.closed += 1


@pytest.fixture
def live():
    bus = Fake(recorded().frames)
    shown = LiveSource(bus, recorded().observer(), "fake", lambda: bus.now)
    yield bus, shown
    bus.hangs.set()
    shown.close()
    assert bus.closed == 1


def test_a_bus_gives_what_the_observer_sees(live):
    bus, shown = live
    while bus.now < 2_000 * MS:
        bus.at(bus.now + 93 * MS)
        seen = shown.advance(0.0)
    frames = [f for f in recorded().frames if f.t_ns <= bus.now]
    assert seen == play(recorded().observer(), frames, bus.now)
    assert shown.span_s is None
    assert seen.span_s is None
    assert shown.seek(0.5).t_s == seen.t_s


def test_a_slow_picture_loses_nothing_and_a_bound_is_kept(live, monkeypatch):
    bus, shown = live
    for now in range(0, 1_000 * MS, 50 * MS):
        bus.at(now)
    seen = shown.advance(0.0)
    assert seen.link.received == bus.given > 2500
    assert seen.link.unread == 0
    monkeypatch.setattr(sources, "MOST_WAITING", 100)
    for now in range(1_000 * MS, 1_700 * MS, 10 * MS):
        bus.at(now)
    later = shown.advance(0.0)
    assert later.link.unread > 1000
    assert later.link.received + later.link.unread == bus.given


def test_a_paused_picture_stands_still_while_the_bus_is_read(live):
    bus, shown = live
    bus.at(500 * MS)
    seen = shown.advance(0.1)
    shown.paused = True
    bus.at(2_900 * MS)
    assert shown.advance(0.1) is seen
    shown.paused = False
    assert shown.advance(0.1).t_s == pytest.approx(2.9, abs=0.0101)


def test_what_was_heard_grows_old_though_reading_hangs(live):
    bus, shown = live
    bus.at(2_500 * MS)
    assert shown.advance(0.1).gateway.alive
    bus.hangs.clear()
    bus.now = 5_000 * MS
    gone = shown.advance(0.1)
    assert not gone.gateway.alive
    assert {row.adhesion for row in gone.drives} == {Flag.UNKNOWN}


def test_the_links_own_state_is_shown(live):
    bus, shown = live
    bus.at(500 * MS)
    bus.status.bus_state, bus.status.kernel_drops = BusState.PASSIVE, 7
    link = shown.advance(0.1).link
    assert (link.state, link.unread) == ("passive", 7)
    bus.status.state = LinkState.DOWN
    assert shown.advance(0.1).link.state == "down"


def test_nothing_can_be_sent_and_a_silent_bus_is_no_error():
    guarded = Guarded(Fake([]), allowed(Mode.LISTEN, config_of(), codec()))
    assert guarded.send(Frame(0, 0x1A0, bytes(8))) is SendResult.REFUSED
    shown = LiveSource(guarded, recorded().observer(), "quiet", lambda: 5 * TICK)
    seen = shown.advance(0.1)
    shown.close()
    assert seen.link.received == 0
    assert not seen.gateway.present
    assert seen.t_s == 0.0


@pytest.mark.parametrize(
    ("interface", "option"), [("slcan", "listen_only"), ("vector", "listen_only"),
                              ("cantact", "monitor")]
)  # fmt: skip
def test_listen_only_is_an_option_that_the_interface_has(interface, option):
    import importlib
    import inspect

    from can.interfaces import BACKENDS

    module, name = BACKENDS[interface]
    bus = getattr(importlib.import_module(module), name)
    assert option in inspect.signature(bus.__init__).parameters
    given = silently({"interface": interface, "bus_kwargs": {"x": 1}})
    assert given["bus_kwargs"] == {option: True, "x": 1}
    assert silently({"interface": "socketcan"}) == {"interface": "socketcan"}
