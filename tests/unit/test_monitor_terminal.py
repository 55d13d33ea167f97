"""The terminal view by its text: what stands on the screen, and what keys do."""

import asyncio
import sys

import pytest
from rich.text import Text
from textual_plotext import Plot

from gateway.cli import main
from gateway.core.codes import FaultClass, Flag
from gateway.monitor.log_source import LogSource
from gateway.monitor.model import panels, plots
from gateway.monitor.model.snapshot import Event, Lateness, Trace
from gateway.monitor.terminal import MonitorApp
from tests.monitored import play, recorded
from tests.simrun import codec, log_of

END = 3_000_000_000


class Screen:
    """An app under test: its screen as lines."""

    def __init__(self, source, size=(80, 24)):
        self.now = 0.0
        self.app = MonitorApp(source, refresh_s=None, clock=lambda: self.now)
        self.source = source
        self.size = size

    def run(self, steps):
        async def inner():
            async with self.app.run_test(size=self.size) as self.pilot:
                await self.pilot.pause()
                await steps(self)

        asyncio.run(inner())

    async def press(self, *keys):
        await self.pilot.press(*keys)
        return await self.settled()

    async def settled(self):
        """A seek may take several looks."""
        while self.source.behind:
            self.app.tick()
        await self.pilot.pause()
        return self.lines()

    async def tick(self, seconds):
        self.now += seconds
        self.app.tick()
        return await self.settled()

    def lines(self):
        strips = self.app.screen._compositor.render_strips()
        return ["".join(segment.text for segment in strip) for strip in strips]


def opened(log, at=0.0, **options):
    source = LogSource(log, lambda: recorded().observer(**options))
    source.paused = True
    source.seek(at)
    return source


def text_of(lines):
    return "\n".join(lines)


def test_everything_stands_on_a_screen_of_80_by_24(log):
    async def steps(screen):
        lines = screen.lines()
        assert len(lines) == 24
        assert {len(line) for line in lines} == {80}
        text = text_of(lines)
        for part in ("loss.log", "GATEWAY", "Running", "Switching", "BUS ✓active",
                     "frames/s", "LOAD Nm of drive 1", "P(lost)", "FLAGS LATE BY",
                     "stator", "? help", "PAUSED"):  # fmt: skip
            assert part in text, part
        rows = {line[:6].split()[-1]: line for line in lines[5:8]}
        assert "✗AdhesionLost" in rows["2"]
        assert "✓Adhering" in rows["1"]
        assert "✓Adhering" in rows["3"]
        assert "Tracking" in rows["2"]
        assert "100 %" in rows["2"]
        assert "±0." in rows["1"]
        assert "✗ drive 2  adhesion AdhesionLost" in text
        assert "?Unknown" in rows["1"]  # thermal: no calibration

    Screen(opened(log, 1.5)).run(steps)


def test_a_drive_is_chosen_by_its_number_and_by_arrows(log):
    async def steps(screen):
        assert "LOAD Nm of drive 1" in text_of(screen.lines())
        lines = await screen.press("2")
        assert "LOAD Nm of drive 2" in text_of(lines)
        assert any(line.startswith("▶  2") for line in lines)
        assert "█" in next(line for line in lines if line.startswith("flag"))
        assert "LOAD Nm of drive 3" in text_of(await screen.press("down"))
        assert "LOAD Nm of drive 3" in text_of(await screen.press("down"))
        lines = await screen.press("up", "up")
        assert "LOAD Nm of drive 1" in text_of(lines)
        assert "█" not in next(line for line in lines if line.startswith("flag"))
        assert "LOAD Nm of drive 1" in text_of(await screen.press("9"))

    Screen(opened(log, 1.8)).run(steps)


def test_numbers_of_two_digits(log):
    from gateway.monitor.model.observer import Observer
    from tests.monitored import config_of

    nodes = tuple(range(1, 17))
    source = LogSource(log, lambda: Observer(codec(nodes), config_of(nodes)))

    async def steps(screen):
        assert "LOAD Nm of drive 12" in text_of(await screen.press("1", "2"))
        lines = screen.lines()
        assert len([line for line in lines if line.startswith("▶")]) == 1
        assert any(line.startswith("▶ 12") for line in lines)
        assert lines[4].startswith("drive")
        assert "? help" in lines[-1]
        screen.now += 5.0
        assert "LOAD Nm of drive 2" in text_of(await screen.press("2"))
        screen.now += 5.0
        assert "LOAD Nm of drive 1 " in text_of(await screen.press("1"))
        screen.now += 5.0
        assert "LOAD Nm of drive 1 " in text_of(await screen.press("1"))

    Screen(source).run(steps)


def test_pause_seek_and_speed_by_keys(log):
    async def steps(screen):
        at = lambda lines: float(lines[0].split("loss.log")[1].split()[0])  # noqa: E731
        assert at(screen.lines()) == 1.0
        assert at(await screen.tick(0.3)) == 1.0
        await screen.press("space")
        assert "PAUSED" not in screen.lines()[0]
        assert at(await screen.tick(0.3)) == pytest.approx(1.3, abs=0.011)
        assert at(await screen.press("right")) == pytest.approx(2.3, abs=0.011)
        assert at(await screen.press("left", "left")) == pytest.approx(0.3, abs=0.03)
        assert at(await screen.press("end")) == pytest.approx(screen.source.span_s[1], abs=0.011)
        assert at(await screen.press("home")) == 0.0
        assert at(await screen.press("full_stop")) == pytest.approx(
            screen.source.span_s[1], abs=0.011
        )
        assert at(await screen.press("comma")) == 0.0
        assert "x2" in (await screen.press("plus"))[0]
        assert at(await screen.tick(0.2)) == pytest.approx(0.4, abs=0.011)
        assert "x0.5" in (await screen.press("minus", "minus"))[0]
        # A terminal that stood still does not make the log jump.
        assert at(await screen.tick(100.0)) == pytest.approx(0.65, abs=0.02)

    Screen(opened(log, 1.0)).run(steps)


def test_help_by_a_question_mark_and_away_by_any_key(log):
    async def steps(screen):
        assert "one second back" in text_of(await screen.press("question_mark"))
        assert "1..9" in text_of(screen.lines())
        await screen.tick(0.1)
        assert "one second back" not in text_of(await screen.press("x"))

    Screen(opened(log)).run(steps)


def test_more_events_and_another_span_by_keys(log):
    async def steps(screen):
        count = lambda: sum(" s · " in x or " s ✗ " in x or " s ! " in x for x in screen.lines())  # noqa: E731
        few = count()
        await screen.press("e")
        assert count() > few
        await screen.press("e")
        assert count() == few
        assert "last 10 s" in text_of(screen.lines())
        assert "last 30 s" in text_of(await screen.press("z"))

    Screen(opened(log, 2.9), size=(100, 34)).run(steps)


def test_a_wide_screen_has_more_columns_and_a_tiny_one_does_not_break(log):
    async def wide(screen):
        for part in ("heartbeat", "rejected", "MAISD", "Operational"):
            assert part in screen.lines()[4] + screen.lines()[5]

    async def tiny(screen):
        assert "traction-gateway" in screen.lines()[0]
        await screen.press("2", "e", "z", "question_mark", "q")

    Screen(opened(log, 1.0), size=(140, 50)).run(wide)
    Screen(opened(log, 1.0), size=(20, 6)).run(tiny)


def test_no_gateway_and_a_shadow_are_said(tmp_path):
    path = log_of(tmp_path / "drives.log", recorded().drives)

    async def none(screen):
        text = text_of(screen.lines())
        assert "no gateway on this bus" in text
        assert "Adhering" not in text

    async def shadow(screen):
        text = text_of(screen.lines())
        assert "SHADOW" in text
        assert "✗AdhesionLost" in text

    Screen(opened(path, 1.5)).run(none)
    Screen(opened(path, 1.5, show_shadow=True)).run(shadow)


def test_the_source_is_closed_at_the_end(log):
    source = opened(log)
    closed = []
    source.close = lambda: closed.append(True)

    async def steps(screen):
        await screen.press("q")

    Screen(source).run(steps)
    assert closed == [True]


# ---- panels ------------------------------------------------------------------------------------


def test_nothing_is_told_by_colour_alone():
    """Without any style good, bad and unknown still differ, in every panel that has flags."""
    shown = play(recorded().observer(), recorded().frames, END)
    drawn = []
    for flag in Flag:
        rows = tuple(row._replace(adhesion=flag, thermal=flag) for row in shown.drives)
        gate = shown.gateway._replace(
            common_mode=flag, sensor_fault=flag, comm_fault=flag, estimator_fault=flag, overrun=flag
        )
        here = shown._replace(drives=rows, gateway=gate)
        strip = plots.strip((0.5, 1.0), (flag, flag), (0.0, 1.0), 2)
        drawn.append(
            (panels.drive_table(here, 1, 80).plain, panels.gateway(here).plain, strip.plain)
        )
    for one, two in ((0, 1), (0, 2), (1, 2)):
        assert all(a != b for a, b in zip(drawn[one], drawn[two], strict=True))


def test_a_thermal_fault_says_its_class():
    shown = play(recorded().observer(), recorded().frames, END)
    row = shown.drives[0]._replace(thermal=Flag.BAD, fault_class=FaultClass.COOLING_LOSS)
    assert panels.thermal(row).plain == "✗CoolingLoss"
    assert panels.thermal(row._replace(thermal=Flag.UNKNOWN)).plain == "?Unknown"


def test_the_lowest_rows_of_a_histogram_go_together_and_none_is_lost():
    late = Lateness((0, 1, 2, 4, 8, 16), (1, 20, 300, 4000, 50000), 54321, 15, 15)
    for height in (2, 3, 4, 6, 20):
        plain = panels.lateness(late, (28, height)).plain.splitlines()
        assert len(plain) <= height
        counts = [int(line.split()[-1]) for line in plain[1:]]
        assert sum(counts) == 54321
        assert max(len(line) for line in plain) <= 28


def test_the_newest_events_are_the_ones_that_are_shown():
    events = tuple(Event(float(k), "info", None, f"event {k}") for k in range(20))
    plain = panels.events(events, 3).plain.splitlines()
    assert [line.split()[-1] for line in plain] == ["17", "18", "19"]


def curve(t_s, load_nm, sigma_nm, size):
    """The lines of a plot of 10 s."""
    nothing = (None,) * len(t_s)
    trace = Trace(1, t_s, nothing, load_nm, sigma_nm, nothing, (Flag.UNKNOWN,) * len(t_s))
    plot = Plot()
    plot.plot_size(*size)
    plots.curve(plot, trace, (0.0, 10.0))
    plot._set_size(*size)
    return Text.from_ansi(plot.build()).plain.removesuffix("\n").split("\n")


def test_a_curve_has_its_size_its_gaps_and_its_ends():
    t_s = [k / 10 for k in range(1, 101)]
    values = [20.0 if t < 4 else None if t < 6 else 0.0 for t in t_s]
    lines = curve(t_s, values, [1.0] * 100, (57, 10))
    assert len(lines) == 10
    assert {len(line) for line in lines} == {57}
    body = [line[plots.SCALE :] for line in lines]

    def column(x):
        return {line[x] for line in body} - {" "}

    assert all(column(x) for x in range(19))
    assert not any(column(x) for x in range(21, 29))
    assert all(column(x) for x in range(31, 50))
    high, low = float(lines[0][:6]), float(lines[-1][:6])
    assert high >= 22.0
    assert low <= -2.0
    tops = [y for y, line in enumerate(body) if any(0x2800 < ord(c) < 0x2900 for c in line[:19])]
    ends = [y for y, line in enumerate(body) if any(0x2800 < ord(c) < 0x2900 for c in line[31:])]
    assert max(tops) < min(ends)
    assert any("░" in line for line in body)


@pytest.mark.parametrize("bad", [None, float("nan"), float("inf")])
def test_a_curve_of_nothing_says_so(bad):
    plain = curve((), (), (), (40, 5))
    assert "not known" in "".join(plain)
    assert curve([1.0], [bad], [None], (40, 5)) == plain


def test_a_curve_without_a_band_and_of_huge_numbers_is_drawn():
    for sigma in (None, float("nan")):
        assert "░" not in "".join(curve([1.0, 1.1], [1e9, -1e9], [sigma] * 2, (40, 5)))
    lines = curve([1.0, 1.1], [1e9, -1e9], [None] * 2, (40, 5))
    assert (float(lines[0][:6]), float(lines[-1][:6])) == (1e9, -1e9)


def test_a_strip_shows_the_gravest_and_a_bar_what_is_not_known():
    states = [Flag.GOOD, Flag.BAD, Flag.GOOD, Flag.UNKNOWN, Flag.GOOD, Flag.GOOD]
    assert plots.strip((1, 2, 3, 4, 5, 6), states, (0.0, 8.0), 4).plain == "█?─·"
    bins = plots.columns((1, 2, 3), (0.0, 1.0, None), 0.0, 3.0, 3)
    assert plots.bars(bins, 0.5).plain == "▁█·"
    assert plots.bar(0.0, 5) == ""
    assert plots.bar(1e-6, 5) == "▏"
    assert plots.bar(7.0, 5) == "█████"


# ---- the verb ----------------------------------------------------------------------------------


def test_what_cannot_be_shown_is_one_line(refused, log, monkeypatch, tmp_path):
    assert "needs a terminal" in refused("monitor", log)
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    assert "a log and a bus" in refused("monitor", log, "-i", "virtual", "-c", "x")
    assert "no such file" in refused("monitor", tmp_path / "none.log")
    assert "for a log" in refused("monitor", "-i", "virtual", "-c", "x", "--at", "3")
    assert "name one" in refused("monitor")
    monkeypatch.setitem(sys.modules, "textual", None)
    assert "pip install 'textual>=8' 'textual-plotext" in refused("monitor", log)


def test_a_log_that_vanishes_ends_the_view_with_one_line(refused, monkeypatch, tmp_path):
    path = log_of(tmp_path / "vanishing.log", recorded().frames)
    real = MonitorApp.run

    async def steps(app, pilot):
        await pilot.press("end")
        while app._source.behind:
            app.tick()
        path.unlink()
        await pilot.press("home")

    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    monkeypatch.setattr(
        MonitorApp, "run",
        lambda app: real(app, headless=True, size=(80, 24), auto_pilot=lambda p: steps(app, p)),
    )  # fmt: skip
    assert "no such file" in refused("monitor", path)


def test_a_name_cannot_bring_control_characters_to_the_terminal(tmp_path):
    path = log_of(tmp_path / "a\x1b[2Jb.log", recorded().drives[:50])
    source = opened(path)
    assert "\x1b" not in source.title


def test_the_verb_shows_the_log_where_it_is_told_to(monkeypatch, log):
    seen = []

    def run(app):
        seen.append((app._source.advance(0.0), app._source.speed))
        while app._source.behind:
            seen.append((app._source.advance(0.0), app._source.speed))

    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    monkeypatch.setattr(MonitorApp, "run", run)
    assert main(["monitor", str(log), "--at", "1.5", "--speed", "2", "--shadow"]) == 0
    shown, speed = seen[-1]
    assert shown.t_s == pytest.approx(1.5, abs=0.011)
    assert shown.drives[1].adhesion is Flag.BAD
    assert speed == 2.0


def test_the_verb_on_a_bus_sends_nothing(monkeypatch):
    import can

    frames = []

    def run(app):
        with can.Bus(interface="virtual", channel="monitored") as other:
            other.send(can.Message(arbitration_id=0x701, data=[5], is_extended_id=False))
            while not (shown := app._source.advance(0.1)).link.received:
                pass
            frames.append((shown.link.received, other.recv(0.05)))
            app._source.close()

    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    monkeypatch.setattr(MonitorApp, "run", run)
    assert main(["monitor", "-i", "virtual", "-c", "monitored"]) == 0
    assert frames == [(1, None)]
