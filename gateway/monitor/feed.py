"""One source, polled ten times a second, for any number of viewers; none of them can delay it.

The source has a thread of its own. Each look becomes a picture; there is only ever the newest, so
nothing queues up: a viewer who is slow gets fewer of them, and with the next one all points of the
traces since the last that it got.
"""

from __future__ import annotations

import asyncio
import json
import logging
import math
import time
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final

from gateway.monitor.model.snapshot import Event, Snapshot, Trace, as_json, word
from gateway.monitor.sources import Source

log = logging.getLogger(__name__)

PERIOD_S: Final = 0.1
IDLE_S: Final = 1.0
"""A picture in which nothing is new is sent this often, as a sign of life."""
LONGEST_S: Final = 0.5
"""Time that may pass between two looks: a machine that stood still does not make a log jump."""
SLOWEST, FASTEST = 0.1, 100.0
SHORTENED: Final = 4
"""Digits of the points of the traces, which are the most of what is sent."""


class Picture:
    """What one look gave, as text for the page. Never changes."""

    def __init__(self, number: int, shown: Snapshot, about: Mapping[str, Any]) -> None:
        """about: the source's state, for the page."""
        self.number = number
        self.shown = shown
        plain = as_json(shown)
        self.events = _text(plain.pop("events"))
        self.head = _text({**about, **plain})
        self._points: dict[float | None, str] = {}

    @property
    def last_s(self) -> float | None:
        """Time of the newest point of the traces."""
        t_s = self.shown.history[0].t_s if self.shown.history else ()
        return t_s[-1] if t_s else None

    def differs(self, other: Picture | None) -> bool:
        """Whether there is anything new to see."""
        return other is None or (self.head, self.events) != (other.head, other.events)

    def message(self, before: Picture | None) -> str:
        """For a viewer who had that picture last; None: had none."""
        parts = [f'"head":{self.head}']
        if before is None or before.events != self.events:
            parts.append(f'"events":{self.events}')
        after = None if before is None else before.last_s
        if after is None or after != self.last_s:
            parts.append(f'"points":{self._since(after)}')
        return "{" + ",".join(parts) + "}"

    def _since(self, after_s: float | None) -> str:
        """Points later than a time; all where the traces do not go on from there."""
        if after_s not in self._points:
            traces = self.shown.history
            t_s = traces[0].t_s if traces else ()
            first = bisect_right(t_s, after_s) if after_s is not None else 0
            # A seek, or a gap as long as the traces.
            fresh = first == 0 or first == len(t_s)
            begin = 0 if fresh else first
            drives = {t.node: _columns(t, begin) for t in traces}
            rounded = [round(t, 3) for t in t_s[begin:]]
            self._points[after_s] = _text({"fresh": fresh, "t_s": rounded, "drives": drives})
        return self._points[after_s]


def _columns(trace: Trace, begin: int) -> dict[str, list[Any]]:
    def short(values: tuple[float | None, ...]) -> list[float | None]:
        return [_short(v) for v in values[begin:]]

    return {
        "speed_rad_s": short(trace.speed_rad_s),
        "load_nm": short(trace.load_nm),
        "load_sigma_nm": short(trace.load_sigma_nm),
        "loss_probability": short(trace.loss_probability),
        "adhesion": [word("adhesion", flag) for flag in trace.adhesion[begin:]],
    }


def _short(value: float | None) -> float | None:
    if value is None or not math.isfinite(value):
        return None
    return float(f"{value:.{SHORTENED}g}")


def _text(value: Any) -> str:
    return json.dumps(value, separators=(",", ":"), allow_nan=False)


class Feed:
    """The source, what viewers have asked of it, and the newest picture."""

    def __init__(
        self,
        source: Source,
        *,
        waits: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """waits: a log stands still as long as nobody looks."""
        self.picture: Picture | None = None
        """The newest."""
        self.viewers = 0
        self.counts: Counter[str] = Counter()
        """Of viewers: `dropped` because slow, `refused` by cause, `bad_request`."""
        self.happened: Counter[str] = Counter()
        """Events by level, as they were told."""
        self._source = source
        self._live = source.span_s is None
        self._waits = waits and not self._live
        self._clock = clock
        self._looked_s = clock()
        self._orders: dict[str, float | bool] = {}
        self._events: tuple[Event, ...] = ()
        self._seeking = not self._live
        self._shown: Picture | None = None
        """The newest in which something is new, or that is due: what viewers get."""
        self._new = asyncio.Event()

    def ask(self, what: object) -> bool:
        """A viewer's wish: {"seek": s}, {"pause": bool} or {"speed": x}. False if it is none.

        Nothing else exists, and on a bus nothing is done at all. It is done with the next look;
        of several seeks before that only the last.
        """
        if not isinstance(what, dict) or len(what) != 1:
            return False
        [(name, value)] = what.items()
        if name == "pause":
            good = isinstance(value, bool)
        elif name in ("seek", "speed"):
            good = isinstance(value, int | float) and not isinstance(value, bool)
            good = good and math.isfinite(value) and value >= 0
        else:
            return False
        if good and not self._live:
            self._orders[name] = value
        return good

    def look(self, orders: Mapping[str, float | bool] | None = None) -> Picture:
        """Let time pass and make the next picture. In one thread at a time.

        orders: what viewers asked for; None takes it from where `ask` left it.
        """
        if orders is None:
            orders = self._asked()
        now = self._clock()
        passed = min(max(now - self._looked_s, 0.0), LONGEST_S)
        self._looked_s = now
        source = self._source
        if "pause" in orders:
            source.paused = bool(orders["pause"])
        if "speed" in orders:
            source.speed = min(max(float(orders["speed"]), SLOWEST), FASTEST)
        if "seek" in orders:
            self._seeking = True
            shown = source.seek(float(orders["seek"]), PERIOD_S)
        else:
            shown = source.advance(0.0 if self._waits and not self.viewers else passed)
        self._log_events(shown.events)
        self._seeking = self._seeking and source.behind
        about = {
            "title": source.title,
            "live": self._live,
            "paused": source.paused,
            "speed": source.speed,
            "behind": source.behind,
        }
        number = self.picture.number + 1 if self.picture else 1
        self.picture = Picture(number, shown, about)
        return self.picture

    async def play(self) -> None:
        """Look, and wake who waits, until cancelled. Whatever a look raises comes out here."""
        loop = asyncio.get_running_loop()
        sent_s = -math.inf
        with ThreadPoolExecutor(1, thread_name_prefix="monitor") as thread:
            while True:
                begin = loop.time()
                picture = await loop.run_in_executor(thread, self.look, self._asked())
                if picture.differs(self._shown) or begin - sent_s >= IDLE_S:
                    self._shown, sent_s = picture, begin
                    new, self._new = self._new, asyncio.Event()
                    new.set()
                await asyncio.sleep(max(PERIOD_S - (loop.time() - begin), 0.01))

    async def after(self, before: Picture | None) -> Picture:
        """The newest picture, once there is one that this viewer has not had."""
        while self._shown is None or self._shown is before:
            await self._new.wait()
        return self._shown

    def _asked(self) -> Mapping[str, float | bool]:
        orders, self._orders = self._orders, {}
        return orders

    def _log_events(self, events: tuple[Event, ...]) -> None:
        """New events to the log, by their level; not those that a seek jumps over.

        A place in the code for each level: what the log allows is counted by place, and many of
        one level should not use up what is allowed to the others.
        """
        for event in () if self._seeking else added(self._events, events):
            self.happened[event.level] += 1
            where = "" if event.drive is None else f"drive {event.drive}: "
            extra = {"drive": event.drive, "t_s": round(event.t_s, 3)}
            if event.level == "error":
                log.error("%s%s", where, event.text, extra=extra)
            elif event.level == "warning":
                log.warning("%s%s", where, event.text, extra=extra)
            else:
                log.info("%s%s", where, event.text, extra=extra)
        self._events = events


def added(before: tuple[Event, ...], after: tuple[Event, ...]) -> Iterator[Event]:
    """What was appended to a list whose oldest entries may have gone."""
    if before == after:
        return
    for gone in range(len(before) + 1):
        kept = before[gone:]
        if after[: len(kept)] == kept:
            yield from after[len(kept) :]
            return
