"""The gateway's flags as read from the wire, and a test's expectations of them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from typing import Final, Protocol

from dbc.codec import Codec
from dbc.frame import MS, Frame, Nanos
from dbc.text import near
from gateway.core.codes import Flag
from gateway.hil.pytest import picture
from gateway.reports import known
from gateway.reports.expectations import UNPROVEN, WORDS, FlagTrack, proves
from gateway.reports.scoring import first

SHOWN_NS: Final[Nanos] = 300 * MS
"""Time that a picture shows before the test began to wait."""
LAST_FRAMES: Final = 12
OF_THE_SET: Final = ("common_mode", "comm", "sensor")
"""Flags of the whole train."""


class Bench(Protocol):
    """What the flags need of a `HilBench`, see there."""

    codec: Codec
    nodes: tuple[int, ...]
    frames: deque[Frame]
    lost: dict[int, deque[tuple[Nanos, bool]]]
    now_ns: Nanos

    @property
    def missed(self) -> int:
        """Ticks that this process came too late for."""

    def run_until(self, met: Callable[[], bool], within_s: float) -> bool:
        """Let time pass until `met()`."""


class GatewayFlags:
    """Flags on the bus. An `expect_..` lets time pass until it is met, or fails with a picture."""

    def __init__(self, bench: Bench) -> None:
        """Made by the bench."""
        self._bench = bench
        self.track = FlagTrack(bench.codec, bench.nodes)

    def now(self, flag: str, drive: int = 0) -> Flag:
        """Last state received: `adhesion` or `thermal` of a drive; comm, sensor, common_mode."""
        seen = self._seen(flag, drive)
        return seen[-1][1] if seen else Flag.UNKNOWN

    def expect(self, flag: str, state: str, *, drive: int = 0, within_ms: float) -> float:
        """Expect a flag to be "good", "bad" or "unknown" within a time; return the time taken, ms.

        The time runs from the last tick before the call to the stamp of the first such frame.
        Raises AssertionError with the last frames and a picture.
        """
        __tracebackhide__ = True
        bench, began = self._bench, self._bench.now_ns
        wanted = _checked(state, within_ms)

        def found() -> Nanos | None:
            return first(self._seen(flag, drive), wanted, began + 1)

        bench.run_until(lambda: found() is not None, within_ms / 1000.0)
        if (at := found()) is None or at - began > within_ms * MS:
            who = f" of drive {drive}" if drive else ""
            last = self.now(flag, drive).name.lower()
            raise AssertionError(
                f"{flag}{who} was expected to be {state} within {within_ms:g} ms; it is {last}\n"
                + self.show(began)
            )
        return (at - began) / MS

    def expect_never(self, flag: str, state: str, *, drive: int = 0, for_ms: float) -> None:
        """Expect a flag not to be in a state for a time, in which it must be received and known.

        A flag that is not to be good may be unknown in that time, if it is known at another.
        """
        __tracebackhide__ = True
        bench, began = self._bench, self._bench.now_ns
        wanted = _checked(state, for_ms)
        count = len(self._seen(flag, drive))

        def broken() -> bool:
            return first(self._seen(flag, drive), wanted, began + 1) is not None

        who = f" of drive {drive}" if drive else ""
        if bench.run_until(broken, for_ms / 1000.0):
            at = (bench.now_ns - began) / MS
            raise AssertionError(
                f"{flag}{who} was expected never to be {state} for {for_ms:g} ms; it was after "
                f"{at:g} ms\n" + self.show(began)
            )
        seen = self._seen(flag, drive)
        if len(seen) == count:
            raise AssertionError(
                f"{flag}{who}: no flag frame for {for_ms:g} ms\n{self.show(began)}"
            )
        if not proves(wanted, (state for _, state in seen[count:]), seen):
            raise AssertionError(f"{flag}{who}: {UNPROVEN}\n{self.show(began)}")

    def expect_lost(self, *, drive: int, within_ms: float) -> float:
        """Expect `AdhesionLost` within a time from now; return the time taken, ms."""
        __tracebackhide__ = True
        return self.expect("adhesion", "bad", drive=drive, within_ms=within_ms)

    def expect_adhering(self, *, drive: int, within_ms: float) -> float:
        """Expect `Adhering` within a time from now; return the time taken, ms."""
        __tracebackhide__ = True
        return self.expect("adhesion", "good", drive=drive, within_ms=within_ms)

    def expect_unknown(self, *, drive: int, within_ms: float) -> float:
        """Expect unknown adhesion within a time from now; return the time taken, ms."""
        __tracebackhide__ = True
        return self.expect("adhesion", "unknown", drive=drive, within_ms=within_ms)

    def expect_thermal_fault(self, *, drive: int, within_ms: float) -> float:
        """Expect a thermal fault of a drive within a time from now; return the time taken, ms."""
        __tracebackhide__ = True
        return self.expect("thermal", "bad", drive=drive, within_ms=within_ms)

    def expect_never_lost(self, *, drive: int, for_ms: float) -> None:
        """Expect no `AdhesionLost` of a drive for a time from now on."""
        __tracebackhide__ = True
        self.expect_never("adhesion", "bad", drive=drive, for_ms=for_ms)

    def expect_known(self, percent: Mapping[str, float], *, since_ns: Nanos = 0) -> None:
        """Expect every drive's flag to be known for a percentage of the time: `{"adhesion": 90}`.

        since_ns: start of that time. Raises AssertionError with a line per flag that falls short.
        """
        __tracebackhide__ = True
        seen = known.of_frames(self.track.seen, self._bench.nodes, since_ns)
        if short := known.short_of(seen, percent):
            raise AssertionError("\n".join([*short, self.show(since_ns)]))

    def show(self, began: Nanos) -> str:
        """A picture of the time from shortly before `began` until now, and the last frames."""
        bench = self._bench
        first, last = max(began - SHOWN_NS, 0), max(bench.now_ns, began + 10 * MS)
        lines = []
        if bench.missed:
            lines = [f"  inconclusive: the test's own process missed {bench.missed} ticks"]
        rows = []
        for node in bench.nodes:
            truth = [(t, Flag.BAD if lost else Flag.GOOD) for t, lost in bench.lost[node]]
            rows.append((f"drive {node} truly", picture.strip(truth, first, last)))
            for flag in known.FLAGS:
                seen = self._seen(flag, node)
                rows.append((f"drive {node} {flag}", picture.strip(seen, first, last)))
        rows += [(flag, picture.strip(self._seen(flag, 0), first, last)) for flag in OF_THE_SET]
        lines += [f"  {name:>18} {text}" for name, text in rows]
        lines.append(f"  {'':>18} {picture.axis(first, last)}")
        lines.append(f"  {'':>18} - good   # bad   ? unknown")
        own = {spec.can_id for spec in bench.codec.messages if spec.is_gateway}
        flags = [f for f in bench.frames if f.can_id in own][-LAST_FRAMES // 2 :]
        others = [f for f in bench.frames if f.can_id not in own][-LAST_FRAMES // 2 :]
        frame_texts = picture.frame_texts(sorted([*flags, *others]), bench.codec)
        return "\n".join([*lines, "  last frames:", *(f"    {line}" for line in frame_texts)])

    def _seen(self, flag: str, drive: int) -> list[tuple[Nanos, Flag]]:
        if flag in OF_THE_SET:
            drive = 0
        elif flag not in known.FLAGS:
            names = (*known.FLAGS, *OF_THE_SET)
            msg = f"no flag {flag!r}: expected one of {', '.join(names)}{near(flag, names)}"
            raise ValueError(msg)
        elif drive not in self._bench.nodes:
            raise ValueError(f"drive {drive} is not one of {self._bench.nodes}: name one of them")
        return self.track.seen.get((flag, drive), [])


def _checked(state: str, time_ms: float) -> Flag:
    """The state by its name. Raises ValueError, also for a time in which nothing can be seen."""
    if state not in WORDS:
        msg = f"no state {state!r} of a flag: expected {', '.join(WORDS)}{near(state, WORDS)}"
        raise ValueError(msg)
    if not 0.0 < time_ms < math.inf:
        msg = f"expected a time of more than 0 ms, got {time_ms:g}"
        raise ValueError(msg)
    return WORDS[state]
