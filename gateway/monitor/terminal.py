"""The terminal view: panels over a source, keys for everything. A screen of 80 x 24 is enough."""

from __future__ import annotations

import asyncio
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, ClassVar, Final

from rich.text import Text
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.screen import ModalScreen, Screen
from textual.widget import Widget
from textual.widgets import Static
from textual_plotext import PlotextPlot

from dbc.text import InputError
from gateway.monitor.model import panels
from gateway.monitor.model.plots import GREY, ORANGE, SCALE, SKY, bars, columns, curve, strip
from gateway.monitor.model.snapshot import Snapshot, Trace
from gateway.monitor.sources import Source

REFRESH_S: Final = 0.1
LONGEST_S: Final = 0.5
"""Most time that a log advances between two polls, so that it does not jump after a stop."""
SPEEDS: Final = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0)
SPANS_S: Final = (10.0, 30.0, 60.0)
OTHERS: Final = 19
"""Least number of lines of all panels other than the table."""
SECOND_DIGIT_S: Final = 0.8
"""Time within which a second digit makes a drive number of two digits."""
HELP: Final = """\
 1..9, 1 2   drive by its number (two digits: quickly)
 up, down    drive before, after
 space       pause, and on again
 left, right one second back, on      (of a log)
 , .         ten seconds back, on     (of a log)
 home, end   start, end               (of a log)
 - +         slower, faster           (of a log)
 z           plots of 10, 30 or 60 s
 e           more room for events
 ?           this page; q quits

 ✓ good   ✗ bad   ? unknown: not heard, too old or not believed
 ░ two standard deviations of the load torque; they are not on
   the bus: a gateway that runs in the monitor says them, where
   it agrees with the bus
 strip: ─ adhering   █ lost   ? unknown   · nothing heard"""


class Help(ModalScreen[None]):
    """Help page: the keys, and the meaning of the signs. Any key closes it."""

    CSS = """
    Help { align: center middle; }
    Help > Static { width: 68; height: auto; border: round $foreground; padding: 0 1;
                    background: $surface; }
    """

    def compose(self) -> ComposeResult:
        """Yield the text of the page."""
        yield Static(Text(HELP))

    def on_key(self) -> None:
        """Close the page."""
        self.dismiss()


class Panel(Widget):
    """Text that depends on the size of the panel; drawn again whenever the size changes."""

    def __init__(self, draw: Callable[[int, int], Text], name: str) -> None:
        """draw: makes the text for a width and height in characters."""
        super().__init__(id=name)
        self._draw_text = draw

    def render(self) -> Text:
        """The present text for the present size."""
        return self._draw_text(self.size.width, self.size.height)


class MonitorApp(App[None]):
    """A source on a terminal: polled by this thread only, and closed at the end."""

    TITLE = "traction-gateway monitor"
    ENABLE_COMMAND_PALETTE = False
    CSS = """
    Screen { layout: vertical; }
    Static, Panel { text-wrap: nowrap; text-overflow: ellipsis; }
    #title { height: 1; background: $panel; }
    #tops { height: 3; }
    #gateway { width: 3fr; }
    #link { width: 2fr; }
    #gateway { padding-right: 1; }
    #head { height: 1; }
    #drives { height: auto; scrollbar-size-vertical: 1; }
    #detail { height: 2; }
    #plots { height: 2fr; min-height: 7; }
    #load { width: 1fr; padding-right: 1; }
    #loadhead { height: 1; }
    #chances { height: 2; }
    #late { width: 28; }
    #events { height: 1fr; min-height: 4; }
    .more #events { height: 4fr; }
    #keys { height: 1; background: $panel; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("question_mark", "help", "help", show=False),
        Binding("q,ctrl+c", "quit", "quit", show=False, priority=True),
        Binding("space", "pause", "pause", show=False),
        Binding("left", "seek(-1)", show=False),
        Binding("right", "seek(1)", show=False),
        Binding("comma", "seek(-10)", show=False),
        Binding("full_stop", "seek(10)", show=False),
        Binding("home", "ends(0)", show=False),
        Binding("end", "ends(1)", show=False),
        Binding("plus,equals_sign", "speed(1)", show=False),
        Binding("minus", "speed(-1)", show=False),
        Binding("up", "step(-1)", show=False),
        Binding("down", "step(1)", show=False),
        Binding("z", "zoom", show=False),
        Binding("e", "more", show=False),
        *(Binding(str(k), f"digit({k})", show=False) for k in range(10)),
    ]

    def __init__(
        self,
        source: Source,
        *,
        refresh_s: float | None = REFRESH_S,
        clock: Callable[[], float] = time.monotonic,
        **options: Any,
    ) -> None:
        """refresh_s: interval of polls; None polls only when a key needs it, for tests."""
        super().__init__(**options)
        self._source = source
        self._refresh_s = refresh_s
        self._clock = clock
        self._looked_s = clock()
        self._shown: Snapshot | None = None
        self._selected = 0
        self._aim_s = 0.0
        """Target time of the last seek, which may not be complete yet."""
        self._digits = ""
        self._digit_s = 0.0
        self._zoom = 0
        self.problem: Exception | None = None
        """The error that ended the view, for the caller."""

    def compose(self) -> ComposeResult:
        """Yield the panels; only the table can be longer than its space."""
        yield Static(id="title")
        with Horizontal(id="tops"):
            yield Static(id="gateway")
            yield Static(id="link")
        yield Static(id="head")
        with VerticalScroll(id="drives", can_focus=False):
            yield Static(id="table")
        yield Static(id="detail")
        with Horizontal(id="plots"):
            with Vertical(id="load"):
                yield Static(id="loadhead")
                picture = PlotextPlot(id="curve")
                picture.theme = "clear"
                yield picture
                yield Static(id="chances")
            yield Panel(self._late, "late")
        yield Panel(self._events, "events")
        yield Static(id="keys")

    def on_mount(self) -> None:
        """Start polling."""
        with suppress(ValueError, RuntimeError, NotImplementedError):  # not in the main thread
            asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, self.exit)
        self._look(0.0)
        self._draw()
        if self._refresh_s is not None:
            self.set_interval(self._refresh_s, self.tick)

    def on_resize(self) -> None:
        """Adapt the table: it has more columns and rows on a larger screen."""
        rows = max(self.size.height - OTHERS, 3)
        self._base.query_one("#drives").styles.max_height = rows
        self._draw()

    def on_unmount(self) -> None:
        """Close the source."""
        with suppress(ValueError, RuntimeError, NotImplementedError):
            asyncio.get_running_loop().remove_signal_handler(signal.SIGTERM)
        self._source.close()

    def tick(self) -> None:
        """Poll the source once, by the time that has passed, and draw."""
        now = self._clock()
        passed, self._looked_s = now - self._looked_s, now
        self._look(min(max(passed, 0.0), LONGEST_S))
        self._draw()

    def _look(self, passed_s: float) -> None:
        if not self._ask(lambda: self._source.advance(passed_s)) or self._shown is None:
            return
        nodes = [row.node for row in self._shown.drives]
        if self._selected not in nodes:
            self._selected = nodes[0]

    def _ask(self, question: Callable[[], Snapshot]) -> bool:
        """Get a snapshot of the source. A log that becomes unreadable ends the view: `problem`."""
        try:
            self._shown = question()
        except (InputError, OSError) as error:
            self.problem = error
            self.exit()
            return False
        return True

    # ---- keys ----------------------------------------------------------------------------------

    def action_help(self) -> None:
        """Show the help page."""
        self.push_screen(Help())

    def action_pause(self) -> None:
        """Pause, or continue."""
        self._source.paused = not self._source.paused
        self._draw()

    def action_seek(self, seconds: int) -> None:
        """Go back or forward in a log; no effect on a bus."""
        if self._shown is not None and self._source.span_s is not None:
            at = self._aim_s if self._source.behind else self._shown.t_s
            self._go(at + seconds)

    def action_ends(self, which: int) -> None:
        """Go to the start or the end of a log."""
        if (span := self._source.span_s) is not None:
            self._go(span[which])

    def _go(self, t_s: float) -> None:
        self._aim_s = t_s
        if self._ask(lambda: self._source.seek(t_s, REFRESH_S)):
            self._draw()

    def action_speed(self, step: int) -> None:
        """Play a log slower or faster; no effect on a bus."""
        if self._source.span_s is None:
            return
        near = min(range(len(SPEEDS)), key=lambda k: abs(SPEEDS[k] - self._source.speed))
        self._source.speed = SPEEDS[min(max(near + step, 0), len(SPEEDS) - 1)]
        self._draw()

    def action_step(self, step: int) -> None:
        """Select the drive before or after."""
        if self._shown is not None:
            nodes = [row.node for row in self._shown.drives]
            at = nodes.index(self._selected) + step
            self._select(nodes[min(max(at, 0), len(nodes) - 1)])

    def action_digit(self, digit: int) -> None:
        """Select a drive by its number; a second digit soon after the first belongs to it."""
        if self._shown is None:
            return
        now = self._clock()
        soon = self._digits and now - self._digit_s <= SECOND_DIGIT_S
        nodes = [row.node for row in self._shown.drives]
        both = self._digits + str(digit) if soon else ""
        self._digits, self._digit_s = str(digit), now
        for text in (both, str(digit)):
            if text and int(text) in nodes:
                self._select(int(text))
                return

    def _select(self, node: int) -> None:
        self._selected = node
        self._draw()

    def action_zoom(self) -> None:
        """Change the time span of the plots."""
        self._zoom = (self._zoom + 1) % len(SPANS_S)
        self._draw()

    def action_more(self) -> None:
        """Toggle the size of the panel of events."""
        self._base.toggle_class("more")
        self._draw()

    # ---- drawing -------------------------------------------------------------------------------

    def _draw(self) -> None:
        shown = self._shown
        if shown is None or not self.is_running:
            return
        self._put("title", self._title(shown))
        self._put("gateway", panels.gateway(shown))
        self._put("link", panels.link(shown))
        width = self.size.width
        self._put("head", panels.heading(width))
        self._put("table", panels.drive_table(shown, self._selected, width))
        self._put("detail", panels.detail(shown, self._selected))
        self._put("keys", self._keys())
        self._plots(shown)
        for panel in self._base.query(Panel):
            panel.refresh()
        row = [r.node for r in shown.drives].index(self._selected)
        scroll = self._base.query_one("#drives", VerticalScroll)
        if scroll.size.height and not 0 <= row - scroll.scroll_y < scroll.size.height:
            scroll.scroll_to(y=max(row + 1 - scroll.size.height, 0), animate=False)

    @property
    def _base(self) -> Screen[Any]:
        """The screen with the panels, even if another one covers it."""
        return self.screen_stack[0]

    def _put(self, name: str, text: Text) -> None:
        self._base.query_one(f"#{name}", Static).update(text)

    def _title(self, shown: Snapshot) -> Text:
        source = self._source
        text = Text(" traction-gateway monitor ", style="bold", no_wrap=True)
        text.append(f" {source.title} ", style=SKY)
        text.append(f" {shown.t_s:.2f}")
        if source.span_s is not None:
            text.append(f" of {source.span_s[1]:.2f} s  x{source.speed:g}")
        else:
            text.append(" s")
        if source.behind:
            text.append("  reading ..", style=ORANGE)
        if source.paused:
            text.append("  PAUSED", style=f"bold {ORANGE}")
        if not shown.link.received:
            text.append("  nothing received yet", style=ORANGE)
        return text

    def _keys(self) -> Text:
        parts = [("?", "help"), ("q", "quit"), ("1-9", "drive"), ("space", "pause"), ("z", "zoom")]
        parts.append(("e", "events"))
        if self._source.span_s is not None:
            parts += [("← →", "1 s"), (", .", "10 s")]
        text = Text(" ", no_wrap=True)
        for key, what in parts:
            text.append(key, style="bold").append(f" {what}  ", style=GREY)
        return text

    def _late(self, width: int, height: int) -> Text:
        return panels.lateness(self._shown.lateness, (width, height)) if self._shown else Text()

    def _events(self, _width: int, height: int) -> Text:
        return panels.events(self._shown.events, height) if self._shown else Text()

    def _plots(self, shown: Snapshot) -> None:
        """Draw load with band, loss probability and strip of flags of the selected drive."""
        trace = next((t for t in shown.history if t.node == self._selected), Trace(self._selected))
        seconds = SPANS_S[self._zoom]
        span = (shown.t_s - seconds, shown.t_s)
        text = Text(f"LOAD Nm of drive {self._selected}", style=f"bold {SKY}", no_wrap=True)
        self._put("loadhead", text.append(f"  last {seconds:g} s, ░ 2 sigma", style=GREY))
        picture = self._base.query_one("#curve", PlotextPlot)
        curve(picture.plt, trace, span)
        picture.refresh()
        inner = max(picture.size.width - SCALE, 4)
        text = Text("P(lost)", no_wrap=True)
        text.append(bars(columns(trace.t_s, trace.loss_probability, *span, inner), 0.5))
        text.append("\nflag   ").append(strip(trace.t_s, trace.adhesion, span, inner))
        self._put("chances", text)
