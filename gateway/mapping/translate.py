"""Convert frames of other makers' inverters to our kinds, tick by tick; pure.

No value is invented: one that is missing, invalid or too old becomes the not-available code, and
no message of a kind is made while its source message does not arrive. Most foreign messages have
no counter; our counter then counts the periods between stamps, so that a missing frame shows as a
gap, to half a period.
"""

from __future__ import annotations

import math
from ast import literal_eval
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple

from dbc.codec import Codec
from dbc.e2e import protect
from dbc.frame import ERROR, EXTENDED, FD, MS, Frame, Nanos
from dbc.frames import Block, block_of
from dbc.spec import EXTENDED_KEY, Match, MessageSpec, Reading, SignalSpec, Validity
from gateway.mapping.plan import BASES, CARRIES, LEAST_NS, Plan, raw_ends
from gateway.settings.signal_map import Source

JOINED_PERIODS: Final = 1.5
"""Largest age of a value that is combined with one of another message, in its own periods."""
SILENT_PERIODS: Final = 3
"""After a silence of so many periods, the sender of a message may just have been powered up."""
APART_NS: Final[Nanos] = MS
"""Largest distance of the stamps of currents, angle and voltages that count as one instant, but at
most half a period: the frames of one sample are sent one after another."""
MOST_STEPS: Final = 15
SQUARES: Final = 256
"""Number of squared currents kept for `Irms`."""
NEAR_END_K: Final = 10.0
"""From this close a motor can warm up to the end of the range; from farther away it is a jump."""
_ELECTRICAL: Final = ("PhaseCurrents", "StatorVoltages")
_SQRT3: Final = math.sqrt(3.0)
_REMEMBERED: Final = ("_received", "_begun", "_counter", "_made", "_theirs", "_their", "_inside",
                      "_news")  # fmt: skip
"""Attributes of a `_Drive` that change with the frames, beside `_held` and `_squares`."""
_CAUSES: Final = {
    Match.REMOTE: "remote", Match.WRONG_LENGTH: "wrong_length", Match.WRONG_FORMAT: "wrong_length",
}  # fmt: skip


Phases = tuple[float | None, float | None, float | None]


class Held(NamedTuple):
    """Last value of a quantity; None: the message arrived without a usable value."""

    value: float | None
    t_ns: Nanos


class Translator:
    """All mapped drives of one gateway. Only `translate` and `recall` change its state."""

    def __init__(
        self,
        planned: list[Plan],
        codec: Codec,
        on_derived: Callable[[int, Nanos], None] | None = None,
    ) -> None:
        """Prepare the drives; `codec` is the one with which the core decodes, see `plan.fitted`.

        on_derived: called with node and time where one phase is minus the sum of the others.
        """
        self._drives = [_Drive(plan, codec, on_derived) for plan in planned]
        self._routes: dict[int, list[tuple[_Drive, MessageSpec]]] = {}
        for drive in self._drives:
            for spec in drive.plan.codec.messages:
                self._routes.setdefault(spec.key, []).append((drive, spec))
        # Otherwise another node could send frames as if the translator had made them.
        self._hidden = {base + plan.node for plan in planned for base in BASES.values()}

    def translate(self, frames: Iterable[Frame] | Block, now: Nanos, counts: Counter[str]) -> Block:
        """Frames of one tick: mapped ones as our messages, all others unchanged.

        counts: increments the number of rejected frames by cause, and `translated`.
        """
        block = frames if isinstance(frames, Block) else block_of(frames)
        out: list[Frame] = []
        for frame in block.ordered().frames():
            key = frame.can_id | (EXTENDED_KEY if frame.flags & EXTENDED else 0)
            routes = self._routes.get(key)
            if frame.flags & ERROR or (routes is None and key not in self._hidden):
                out.append(frame)
            elif routes is None:
                counts["unknown_id"] += 1
            elif not 0 <= frame.t_ns <= now:
                counts["time_back"] += 1
            else:
                for drive, spec in routes:
                    out += drive.translate(frame, spec, counts)
        return block_of(out)

    def memory(self) -> str:
        """State from the frames so far, as a Python literal."""
        return repr([drive.memory() for drive in self._drives])

    def recall(self, memory: str) -> None:
        """Restore the state. Raises ValueError or SyntaxError for text that is not a `memory`."""
        for drive, kept in zip(self._drives, literal_eval(memory), strict=True):
            drive.recall(kept)


class _Drive:
    """One mapped drive: its last values, and the counters of our messages made from them."""

    def __init__(
        self, plan: Plan, codec: Codec, on_derived: Callable[[int, Nanos], None] | None
    ) -> None:
        self.plan = plan
        self._on_derived = on_derived
        self._codec = codec
        self._specs = {kind: codec.by_name[spec.name] for kind, spec in plan.spec.items()}
        self._held: dict[str, Held] = {}
        self._received: dict[int, Nanos] = {}
        self._begun: dict[int, Nanos] = {}
        self._counter = dict.fromkeys(self._specs, -1)
        self._made: dict[str, Nanos] = {}
        self._theirs: int | None = None
        self._their = 0
        self._squares: deque[float] = deque(maxlen=SQUARES)
        self._inside: dict[str, float] = {}
        """Last temperatures that were not at an end of their raw range, in the DBC's unit."""
        self._news: set[str] = set()
        """Quantities received since the last currents were made."""
        self._of = {n: k for k, rows in plan.sources.items() for n, _, _ in rows}
        self._phases_of, self._voltages_of = plan.signals.phases, plan.signals.voltages
        self._parts = {*self._phases_of, *self._voltages_of}
        self._signals = {
            k: {s.name: s for s in plan.codec.messages[k].signals} for k in plan.sources
        }

    def memory(self) -> dict[str, Any]:
        """State that changes with the frames, as plain types."""
        kept = {name: getattr(self, name) for name in _REMEMBERED}
        held = {name: tuple(value) for name, value in self._held.items()}
        return {**kept, "_held": held, "_squares": list(self._squares)}

    def recall(self, memory: dict[str, Any]) -> None:
        """Restore the state from `memory`."""
        for name in _REMEMBERED:
            setattr(self, name, memory[name])
        self._held = {name: Held(*value) for name, value in memory["_held"].items()}
        self._squares = deque(memory["_squares"], SQUARES)

    def translate(self, frame: Frame, spec: MessageSpec, counts: Counter[str]) -> list[Frame]:
        """Translate one frame of this drive: our frames that it completes, in the fixed order."""
        codec = self.plan.codec
        match, _ = codec.match(frame)
        if match is not Match.OK:
            counts[_CAUSES.get(match, "wrong_length")] += 1
            return []
        index, t_ns = spec.index, frame.t_ns
        last = self._received.get(index)
        if last is not None and t_ns < last:
            counts["time_back"] += 1
            return []
        counts["translated"] += 1
        silent = last is None or (spec.cycle_ns and t_ns - last > SILENT_PERIODS * spec.cycle_ns)
        self._received[index] = t_ns
        if silent:
            self._begun[index] = t_ns
        readings = codec.decode(spec, frame.data)
        came, signals = set(), self._signals[index]
        for name, column, source in self.plan.sources[index]:
            reading = readings[column]
            if reading.validity is Validity.ABSENT:
                continue
            good = reading.validity is Validity.VALID and reading.raw not in source.not_available
            good = good and not self._jumped_to_end(name, signals[column], reading)
            good = good and t_ns - self._begun[index] >= source.settle_ms * MS
            self._held[name] = Held(_physical(reading.value, source) if good else None, t_ns)
            came.add(name)
        self._note_square(came, t_ns)
        self._news |= came
        one = self._one_instant(came, t_ns)
        due = [
            k for k in self._specs if (one if k in _ELECTRICAL else self._its_turn(k, came, t_ns))
        ]
        if "PhaseCurrents" in due:
            self._news.clear()
        return [self._make(kind, t_ns) for kind in due]

    def _jumped_to_end(self, name: str, signal: SignalSpec, reading: Reading) -> bool:
        """Whether a temperature is at an end of its raw range, and was not near it before.

        A sensor without a value sends 255, 0x7FFF or -40; a motor approaches the end gradually.
        """
        if name not in CARRIES["Temperatures"] or signal.is_float:
            return False
        if reading.raw not in raw_ends(signal):
            self._inside[name] = reading.value
            return False
        last = self._inside.get(name)
        return last is None or abs(reading.value - last) > NEAR_END_K

    def _its_turn(self, kind: str, came: set[str], t_ns: Nanos) -> bool:
        """Whether our slow message of a kind is due; `came`: the quantities of this frame."""
        trigger = self.plan.trigger[kind]
        if trigger not in came:
            return False
        last = self._made.get(kind)
        if kind not in LEAST_NS or last is None:
            return True
        own = self.plan.codec.messages[self._of[trigger]].cycle_ns
        return t_ns - last >= self._specs[kind].cycle_ns - own // 2

    def _one_instant(self, came: set[str], t_ns: Nanos) -> bool:
        """Whether this frame completes currents (and voltages, if mapped) of one instant."""
        spec = self._specs.get("PhaseCurrents")
        if spec is None or self._parts.isdisjoint(came) or not self._parts <= self._news:
            return False
        most = min(APART_NS, spec.cycle_ns // 2)
        return all(t_ns - self._held[part].t_ns <= most for part in self._parts)

    def _make(self, kind: str, t_ns: Nanos) -> Frame:
        spec = self._specs[kind]
        self._counter[kind] += self._steps(kind, t_ns, spec.cycle_ns)
        self._made[kind] = t_ns
        payload = self._codec.encode(spec, self._values(kind, t_ns))
        protect(spec, payload, self._counter[kind])
        return Frame(t_ns, spec.can_id, bytes(payload), FD)

    def _steps(self, kind: str, t_ns: Nanos, cycle: Nanos) -> int:
        """Number of periods since the last message of this kind."""
        if kind in _ELECTRICAL and "Counter" in self.plan.signals.use:
            if kind == _ELECTRICAL[0]:
                self._their = self._their_steps()
            return self._their
        last = self._made.get(kind)
        if last is None:
            return 1
        return min(max(1, (t_ns - last + cycle // 2) // cycle), MOST_STEPS)

    def _their_steps(self) -> int:
        """Steps of the drive's own counter; 0 if it stands still: E2E then finds a repetition."""
        held = self._held.get("Counter")
        if held is None or held.value is None:
            return 0
        before, self._theirs = self._theirs, int(held.value)
        if before is None:
            return 1
        source = self.plan.signals.use["Counter"]
        spec = self.plan.codec.by_name[source.message]
        bits = next(s.length for s in spec.signals if s.name == source.name)
        return min((self._theirs - before) % (1 << bits), MOST_STEPS)

    def _values(self, kind: str, t_ns: Nanos) -> Mapping[str, float | None]:
        if kind == "PhaseCurrents":
            return dict(zip(CARRIES[kind], self._phases(t_ns), strict=True))
        if kind == "StatorVoltages":
            return dict(zip(CARRIES[kind], self._voltages(t_ns), strict=True))
        if kind == "Motion":
            return {"Speed": self._get("Speed", t_ns), "Torque": self._torque(t_ns)}
        if kind == "Status":
            commanded = self._has("TorqueCommand")
            command = self._get("TorqueCommand", t_ns) if commanded else self._torque(t_ns)
            return {"TorqueCommand": command, "Irms": self._irms(t_ns)}
        return {name: self._get(name, t_ns) for name in CARRIES[kind]}

    def _has(self, name: str) -> bool:
        return name in self.plan.signals.use

    def _get(self, name: str, t_ns: Nanos) -> float | None:
        held = self._held.get(name)
        if held is None or held.value is None:
            return None
        cycle = self.plan.codec.messages[self._of[name]].cycle_ns
        return held.value if t_ns - held.t_ns <= JOINED_PERIODS * cycle else None

    def _torque(self, t_ns: Nanos) -> float | None:
        """Measured torque, or the magnets' torque 1.5 p psi Iq (without reluctance torque)."""
        if self._has("Torque"):
            return self._get("Torque", t_ns)
        iq, motor = self._get("Iq", t_ns), self.plan.motor
        return None if iq is None else 1.5 * motor.pole_pairs * motor.psi_pm * iq

    def _phases(self, t_ns: Nanos) -> Phases:
        names = self._phases_of
        values = [self._get(name, t_ns) for name in names]
        if names[0] == "Ia":
            phases, is_derived = three_phases(values)
            if is_derived and self._on_derived is not None:
                self._on_derived(self.plan.node, t_ns)
            return phases
        alpha, beta = _in_stator_frame(values)
        if alpha is None or beta is None:
            return alpha, None, None
        return alpha, -0.5 * alpha + 0.5 * _SQRT3 * beta, -0.5 * alpha - 0.5 * _SQRT3 * beta

    def _voltages(self, t_ns: Nanos) -> tuple[float | None, float | None]:
        return _in_stator_frame([self._get(name, t_ns) for name in self._voltages_of])

    def _note_square(self, came: set[str], t_ns: Nanos) -> None:
        """Keep squared currents for `Irms`, where the drive does not send it."""
        if self._has("Irms") or "Status" not in self._specs:
            return
        names = self._phases_of or ("Id", "Iq")
        if names[0] not in came:
            return
        values = [self._get(name, t_ns) for name in names if name != "ElectricalAngle"]
        if names[0] == "Ia":
            values = list(three_phases(values)[0])
        known = [value for value in values if value is not None]
        if len(known) == len(values):
            self._squares.append(math.fsum(value * value for value in known) / len(known))

    def _irms(self, t_ns: Nanos) -> float | None:
        if self._has("Irms"):
            return self._get("Irms", t_ns)
        squares = list(self._squares)
        self._squares.clear()
        return math.sqrt(math.fsum(squares) / len(squares)) if squares else None


def three_phases(values: Sequence[float | None]) -> tuple[Phases, bool]:
    """Ia, Ib, Ic from two or three measured ones; whether one is minus the sum of the others.

    With only one phase known, the other two stay None.
    """
    a, b, c = (*values, None)[:3]
    if a is not None and b is not None:
        return (a, b, -a - b if c is None else c), c is None
    if c is None:
        return (a, b, None), False
    if a is not None:
        return (a, -a - c, c), True
    return ((None, None, c), False) if b is None else ((-b - c, b, c), True)


def _in_stator_frame(values: Sequence[float | None]) -> tuple[float | None, float | None]:
    """Alpha and beta as given, or from d, q and the angle; then None if one of the three is."""
    if len(values) == 2:
        return values[0], values[1]
    d, q, angle = values
    if d is None or q is None or angle is None:
        return None, None
    return _turned(d, q, angle)


def _turned(d: float, q: float, angle_deg: float) -> tuple[float, float]:
    """Rotate from the rotor frame into the stationary one; at 0 the d axis lies on phase a."""
    cos, sin = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    return d * cos - q * sin, d * sin + q * cos


def _physical(value: float, source: Source) -> float | None:
    out = value * source.scale + source.offset
    return out if math.isfinite(out) else None
