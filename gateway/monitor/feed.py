"""One source, polled ten times a second, for any number of viewers; no viewer can delay it.

The source has its own thread. Each poll makes a picture, and only the newest one is kept, so that
no queue grows: a slow viewer gets fewer pictures, each with all points of the traces since the last
one that it got.
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
"""Interval at which a picture without changes is sent, as a sign of life."""
LONGEST_S: Final = 0.5
"""Most time that a log advances in a poll, so that it does not jump if the machine stalls."""
SLOWEST, FASTEST = 0.1, 100.0
SHORTENED: Final = 4
"""Significant digits of the points of the traces, which are the largest part of a message."""


class Picture:
    """Result of one poll as text for the page. Immutable."""

    def __init__(self, number: int, shown: Snapshot, about: Mapping[str, Any]) -> None:
        """about: state of the source, for the page."""
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
        """Whether this picture shows anything that the other does not."""
        return other is None or (self.head, self.events) != (other.head, other.events)

    def message(self, before: Picture | None) -> str:
        """Message for a viewer whose last picture was `before`, or who had none (None)."""
        parts = [f'"head":{self.head}']
        if before is None or before.events != self.events:
            parts.append(f'"events":{self.events}')
        after = None if before is None else before.last_s
        if after is None or after != self.last_s:
            parts.append(f'"points":{self._since(after)}')
        return "{" + ",".join(parts) + "}"

    def _since(self, after_s: float | None) -> str:
        """Points after a time; all points if the traces do not continue from there."""
        if after_s not in self._points:
            traces = self.shown.history
            t_s = traces[0].t_s if traces else ()
            first = bisect_right(t_s, after_s) if after_s is not None else 0
            # All points are new after a seek, or after a gap as long as the traces.
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
    """The source, the requests of the viewers, and the newest picture."""

    def __init__(
        self, source: Source, *, waits: bool = False, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """waits: a log does not advance while there is no viewer."""
        self.picture: Picture | None = None
        """The newest picture."""
        self.viewers = 0
        self.counts: Counter[str] = Counter()
        """Viewers and requests that were rejected or dropped, by cause."""
        self.happened: Counter[str] = Counter()
        """Number of logged events by level."""
        self._source = source
        self._live = source.span_s is None
        self._waits = waits and not self._live
        self._clock = clock
        self._looked_s = clock()
        self._orders: dict[str, float | bool] = {}
        self._events: tuple[Event, ...] = ()
        self._seeking = not self._live
        self._shown: Picture | None = None
        """The newest picture that has changes or is due; viewers get this one."""
        self._new = asyncio.Event()

    def ask(self, what: object) -> bool:
        """Accept a request: {"seek": s}, {"pause": bool} or {"speed": x}; False for any other.

        On a bus a request has no effect. On a log the next poll executes it; of several seeks
        before that, only the last one.
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
        """Poll the source: let time pass, and make the next picture. In one thread at a time.

        orders: requests of viewers; None stands for those that `ask` has accepted.
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
        """Poll, and wake waiting viewers, until cancelled. Raises whatever a poll raises."""
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
        """Wait for a picture other than `before`, the viewer's last one, and return it."""
        while self._shown is None or self._shown is before:
            await self._new.wait()
        return self._shown

    def _asked(self) -> Mapping[str, float | bool]:
        orders, self._orders = self._orders, {}
        return orders

    def _log_events(self, events: tuple[Event, ...]) -> None:
        """Log new events by their level, except those that a seek jumps over.

        Each level has its own call in the code, because the log limits messages by place of call:
        many events of one level must not use up the limit of the others.
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
    """Yield the entries appended to a list whose oldest entries may have been dropped."""
    if before == after:
        return
    for gone in range(len(before) + 1):
        kept = before[gone:]
        if after[: len(kept)] == kept:
            yield from after[len(kept) :]
            return
