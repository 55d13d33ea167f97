"""Check the expectations of a scenario against the flag frames on the wire."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple, Protocol

from dbc.codec import Codec
from dbc.e2e import Check, Receiver
from dbc.frame import Frame
from gateway.core.codes import INVALID, Flag
from gateway.reports.scoring import first

WORDS = {"unknown": Flag.UNKNOWN, "good": Flag.GOOD, "bad": Flag.BAD}
_SET_FLAGS = {"common_mode": "CommonMode", "comm": "CommFault", "sensor": "SensorFault"}


class Expectation(Protocol):
    """The part of `sim.scenario.Expect` that is checked here."""

    @property
    def flag(self) -> str:
        """adhesion, thermal, common_mode, comm or sensor."""

    @property
    def is_(self) -> str:
        """good, bad or unknown."""

    @property
    def drive(self) -> int | str | None:
        """A node number, `all` or `others` (drives that no event names)."""

    @property
    def after_s(self) -> float:
        """Seconds from the start of the scenario."""

    @property
    def within_ms(self) -> float | None:
        """The state must occur within this time after `after_s`; None: at any time."""

    @property
    def never(self) -> bool:
        """The state must not occur from `after_s` on."""


class Verdict(NamedTuple):
    """Result of one expectation for one drive (0: the train).

    delay_ms: time from `after_s` to the first occurrence of the state, None if it did not occur;
    limit_ms: largest delay that passes, None if there is no limit.
    """

    text: str
    passed: bool
    detail: str
    delay_ms: float | None = None
    limit_ms: float | None = None


UNPROVEN = "not seen, but the flag was unknown for all that time, which proves nothing"
_USABLE = (Check.OK, Check.OK_SOME_LOST)


class FlagTrack:
    """Decoded flag frames: (t_ns, flag) by name and drive.

    If the checksum or counter of a frame is wrong, its flags are unknown.
    """

    def __init__(self, codec: Codec, nodes: Sequence[int]) -> None:
        self.codec = codec
        self.nodes = tuple(nodes)
        self.seen: dict[tuple[str, int], list[tuple[int, Flag]]] = {}
        self._receivers: dict[int, Receiver] = {}

    def store(self, frames: Iterable[Frame]) -> None:
        """Store the flags in the gateway's frames; other frames are ignored."""
        for frame in frames:
            spec = self.codec.by_id.get(frame.can_id)
            if spec is None or spec.name not in ("Gateway_Adhesion", "Gateway_Faults"):
                continue
            receiver = self._receivers.setdefault(frame.can_id, Receiver(spec))
            usable = receiver.check(frame.data) in _USABLE
            values = self.codec.decode(spec, frame.data)
            if spec.name == "Gateway_Adhesion":
                names = [("adhesion", n, f"Adhesion{n}") for n in self.nodes]
                names.append(("common_mode", 0, "CommonMode"))
            else:
                names = [("thermal", n, f"Thermal{n}") for n in self.nodes]
                names += [("comm", 0, "CommFault"), ("sensor", 0, "SensorFault")]
            for flag, node, signal in names:
                raw = int(values[signal].raw)
                state = Flag.UNKNOWN if raw == INVALID or not usable else Flag(raw)
                self.seen.setdefault((flag, node), []).append((frame.t_ns, state))


def judge(
    expectations: Iterable[Expectation], track: FlagTrack, touched: set[int], start_ns: int
) -> list[Verdict]:
    """Check every expectation, for each of its drives.

    touched: nodes of the drives that events name.
    """
    verdicts = []
    for expect in expectations:
        if expect.flag in _SET_FLAGS:
            nodes: tuple[int, ...] = (0,)
        elif expect.drive in (None, "all"):
            nodes = track.nodes
        elif expect.drive == "others":
            nodes = tuple(n for n in track.nodes if n not in touched)
        else:
            nodes = (int(expect.drive or 0),)
        verdicts += [_one(expect, track.seen.get((expect.flag, n), []), n, start_ns) for n in nodes]
    return verdicts


def proves(wanted: Flag, states: Iterable[Flag], run: Iterable[tuple[int, Flag]]) -> bool:
    """Whether `wanted` could have been seen: the flag was known at some time.

    states: of the time in which it was not seen; run: of the whole run. A flag that must not be
    good may stay unknown for that time, but not for the whole run.
    """
    if wanted is Flag.GOOD:
        states = (state for _, state in run)
    return any(state is not Flag.UNKNOWN for state in states)


def _one(expect: Expectation, seen: list[tuple[int, Flag]], node: int, start_ns: int) -> Verdict:
    wanted = WORDS[expect.is_]
    after = start_ns + round(expect.after_s * 1e9)
    who = f" of drive {node}" if node else ""
    text = f"{expect.flag}{who} {'never ' if expect.never else ''}{expect.is_}"
    text += f" after {expect.after_s:g} s"
    found = first(seen, wanted, after)
    if expect.never:
        if found is not None:
            detail = f"seen at {(found - start_ns) / 1e9:.3f} s"
            return Verdict(text, False, detail, (found - after) / 1e6)
        states = [state for t_ns, state in seen if t_ns >= after]
        if not states:
            return Verdict(text, False, "no flag frame")
        if not proves(wanted, states, seen):
            return Verdict(text, False, UNPROVEN)
        known = sum(state is not Flag.UNKNOWN for state in states) / len(states)
        share = "" if known == 1.0 else f"; the flag was known for {known:.0%} of that time"
        return Verdict(text, True, f"held{share}")
    limit = None if expect.within_ms is None else expect.within_ms
    if limit is not None:
        text += f" within {limit:g} ms"
    if found is None:
        last = seen[-1][1].name.lower() if seen else "no flag frame"
        return Verdict(text, False, f"not seen; last: {last}", None, limit)
    delay_ms = (found - after) / 1e6
    passed = limit is None or delay_ms <= limit
    return Verdict(text, passed, f"after {delay_ms:.0f} ms", delay_ms, limit)
