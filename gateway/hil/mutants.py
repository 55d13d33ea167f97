"""Gateways with a fault, to test whether a test suite detects it.

A mutant alters the flag frames one by one, or changes the gateway's settings. The checksum of an
altered frame is computed again and its counter kept, so that nothing is wrong but the mutant's
fault.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import count
from typing import Final, NamedTuple

from dbc.codec import Codec
from dbc.e2e import counter_of, protect
from dbc.frame import MS, SECOND, Frame, Nanos
from dbc.spec import MessageSpec, Validity
from gateway.core.codes import Flag
from gateway.settings.config import Config

FLAG_MESSAGES: Final = ("Gateway_Adhesion", "Gateway_Faults")
PLACES: Final = ("first", "second", "third")
"""Drives in the order of the configuration: a mutant is the same for any node numbers."""
DRAWS: Final = 10_000
"""After so many draws all mutants are found."""


class Sent(NamedTuple):
    """One flag frame. values: its signals by name; whole: whether its checksum is right."""

    t_ns: Nanos
    spec: MessageSpec
    values: dict[str, float | None]
    counter: int
    flags: int = 0
    whole: bool = True

    def having(self, **values: int) -> Sent:
        """The frame with these flags changed, except those that the message does not have."""
        own = {name: float(flag) for name, flag in values.items() if name in self.values}
        return self._replace(values={**self.values, **own})


Step = Callable[[Sent], Iterable[Sent]]
"""A frame -> the frames on the bus instead; called in the order of the frames."""
Alter = Callable[[Sequence[int]], Step]
"""Node numbers -> the step of a run that begins."""


def _keep(_nodes: Sequence[int]) -> Step:
    return lambda one: (one,)


class Mutant(NamedTuple):
    """A fault in words, and the function that makes it.

    settings: changes the configuration of the gateway; None: it is kept.
    """

    text: str
    alter: Alter = _keep
    settings: Callable[[Config], Config] | None = None


class Altered:
    """The frames that a gateway with this fault sends, tick by tick."""

    def __init__(self, mutant: Mutant, codec: Codec, nodes: Sequence[int]) -> None:
        """nodes: node numbers of the drives, in the order of the configuration."""
        self._codec, self._step = codec, mutant.alter(nodes)
        self._later: list[Sent] = []

    def __call__(self, frames: Sequence[Frame], now: Nanos) -> list[Frame]:
        """Frames on the bus until `now` instead of these; all but flag frames are kept."""
        own = {spec.can_id for spec in self._codec.messages if spec.name in FLAG_MESSAGES}
        flags = decoded(self._codec, frames)
        waiting = [*self._later, *(new for one in flags for new in self._step(one))]
        self._later = [one for one in waiting if one.t_ns > now]
        due = [one for one in waiting if one.t_ns <= now]
        return [f for f in frames if f.can_id not in own] + encoded(self._codec, due)


def altered(mutant: Mutant, sent: Iterable[Sent], nodes: Sequence[int]) -> list[Sent]:
    """The frames of a whole run, altered."""
    step = mutant.alter(nodes)
    return [new for one in sent for new in step(one)]


def decoded(codec: Codec, frames: Sequence[Frame]) -> list[Sent]:
    """The flag frames among these."""
    found = []
    for frame in frames:
        spec = codec.by_id.get(frame.can_id)
        if spec is None or spec.name not in FLAG_MESSAGES:
            continue
        readings = codec.decode(spec, frame.data).items()
        values = {n: r.value if r.validity is Validity.VALID else None for n, r in readings}
        counter = counter_of(spec, frame.data) or 0
        found.append(Sent(frame.t_ns, spec, values, counter, frame.flags))
    return found


def encoded(codec: Codec, sent: Sequence[Sent]) -> list[Frame]:
    """Encode as frames, in order of time."""
    frames = []
    for one in sorted(sent, key=lambda one: one.t_ns):
        payload = codec.encode(one.spec, one.values)
        protect(one.spec, payload, one.counter)
        payload[0] ^= 0 if one.whole else 0xFF
        frames.append(Frame(one.t_ns, one.spec.can_id, bytes(payload), one.flags))
    return frames


def mutants(number: int, seed: int) -> list[Mutant]:
    """`number` different mutants drawn by seed, fewer if no more are found."""
    rng = random.Random(seed)  # noqa: S311 a choice of tests
    found: dict[str, Mutant] = {}
    for _ in range(DRAWS):
        if len(found) == number:
            break
        mutant = rng.choice(KINDS)(rng)
        found.setdefault(mutant.text, mutant)
    return list(found.values())


def _each(change: Callable[[Sent, Sequence[int]], Sent]) -> Alter:
    return lambda nodes: lambda one: (change(one, nodes),)


def _flag(rng: random.Random) -> tuple[str, int]:
    """Draw a kind of flag, and the place of one of three drives."""
    return rng.choice(("Adhesion", "Adhesion", "Thermal")), rng.randrange(3)


def _node(nodes: Sequence[int], place: int) -> int:
    return nodes[place % len(nodes)]


def _instead(rng: random.Random, what: str, old: Flag, new: Flag) -> Mutant:
    """A mutant in which a drive's flag is `new` wherever it should be `old`."""
    kind, place = _flag(rng)

    def change(one: Sent, nodes: Sequence[int]) -> Sent:
        name = f"{kind}{_node(nodes, place)}"
        return one.having(**{name: new}) if one.values.get(name) == old else one

    return Mutant(f"{kind.lower()} of the {PLACES[place]} drive {what}", _each(change))


def _stuck(rng: random.Random) -> Mutant:
    kind, place = _flag(rng)

    def alter(nodes: Sequence[int]) -> Step:
        name, first = f"{kind}{_node(nodes, place)}", None

        def step(one: Sent) -> list[Sent]:
            nonlocal first
            first = one.values.get(name, first) if first in (None, Flag.UNKNOWN) else first
            return [one if first is None else one.having(**{name: int(first)})]

        return step

    return Mutant(f"{kind.lower()} of the {PLACES[place]} drive keeps its first known value", alter)


def _held(rng: random.Random) -> Mutant:
    kind, place = _flag(rng)

    def alter(nodes: Sequence[int]) -> Step:
        name, bad = f"{kind}{_node(nodes, place)}", False

        def step(one: Sent) -> list[Sent]:
            nonlocal bad
            bad = bad or one.values.get(name) == Flag.BAD
            return [one.having(**{name: Flag.BAD}) if bad else one]

        return step

    return Mutant(f"{kind.lower()} of the {PLACES[place]} drive stays bad for ever", alter)


def _swapped(rng: random.Random) -> Mutant:
    kind, place = _flag(rng)
    other = place + rng.randrange(1, 3)

    def change(one: Sent, nodes: Sequence[int]) -> Sent:
        a, b = (f"{kind}{_node(nodes, k)}" for k in (place, other))
        if a not in one.values:
            return one
        return one._replace(values={**one.values, a: one.values[b], b: one.values[a]})

    text = f"{kind.lower()} of the {PLACES[place]} and the {PLACES[other % 3]} drive is swapped"
    return Mutant(text, _each(change))


def _everyone(rng: random.Random) -> Mutant:
    kind, _ = _flag(rng)

    def change(one: Sent, nodes: Sequence[int]) -> Sent:
        names = [f"{kind}{node}" for node in nodes]
        bad = any(one.values.get(name) == Flag.BAD for name in names)
        return one.having(**dict.fromkeys(names, Flag.BAD)) if bad else one

    return Mutant(f"one drive's bad {kind.lower()} is sent for all drives", _each(change))


def _flicker(rng: random.Random) -> Mutant:
    kind, place = _flag(rng)
    every = rng.choice((50, 100, 200))

    def alter(nodes: Sequence[int]) -> Step:
        name, number = f"{kind}{_node(nodes, place)}", count(1)
        return lambda one: [one.having(**{name: Flag.BAD}) if next(number) % every == 0 else one]

    return Mutant(
        f"{kind.lower()} of the {PLACES[place]} drive is bad once in {every} frames", alter
    )


def _of_the_set(rng: random.Random) -> Mutant:
    name = rng.choice(("CommFault", "SensorFault", "CommonMode"))
    old, new = rng.choice(((Flag.BAD, Flag.GOOD), (Flag.GOOD, Flag.BAD)))

    def change(one: Sent, _nodes: Sequence[int]) -> Sent:
        return one.having(**{name: new}) if one.values.get(name) == old else one

    what = "is never bad" if old is Flag.BAD else "is bad where it should be good"
    return Mutant(f"{name} {what}", _each(change))


def _late(rng: random.Random) -> Mutant:
    ms = rng.choice((40, 80, 160, 320))
    return Mutant(
        f"flags {ms} ms late", _each(lambda one, _: one._replace(t_ns=one.t_ns + ms * MS))
    )


def _frozen(rng: random.Random) -> Mutant:
    from_s = rng.choice((0, 1, 2))

    def change(one: Sent, _nodes: Sequence[int]) -> Sent:
        return one._replace(counter=7) if one.t_ns >= from_s * SECOND else one

    return Mutant(f"counters frozen from {from_s} s on", _each(change))


def _corrupted(_rng: random.Random) -> Mutant:
    return Mutant("checksums wrong", _each(lambda one, _: one._replace(whole=False)))


def _silent(rng: random.Random) -> Mutant:
    from_s = rng.choice((0.5, 1.0, 2.0, 3.0))
    return Mutant(
        f"silent from {from_s:g} s on",
        lambda _nodes: lambda one: [one] if one.t_ns < from_s * SECOND else [],
    )


def _lost(rng: random.Random) -> Mutant:
    every = rng.choice((100, 10))

    def alter(_nodes: Sequence[int]) -> Step:
        number = count(1)
        return lambda one: [one] if next(number) % every else []

    return Mutant(f"one flag frame in {every} lost", alter)


def _thresholds(rng: random.Random) -> Mutant:
    """A gateway that waits longer than its settings say (at least a tick), or must be surer."""
    times = rng.choice((2, 5, 10))
    section, keys, text = rng.choice((
        ("adhesion", ("raise_ms", "raise_severe_ms"), "a loss is raised after {} the time"),
        ("adhesion", ("clear_ms", "good_ms"), "adhesion is good again after {} the time"),
        ("thermal", ("raise_s", "clear_s"), "thermal fault comes and goes after {} the time"),
        ("adhesion", ("raise_probability",), "a loss is raised with {} less doubt"),
    ))  # fmt: skip

    def settings(config: Config) -> Config:
        part, tick_ms = getattr(config, section), config.loop.period_ns // MS

        def more(key: str) -> float:
            value: float = getattr(part, key)
            if key.endswith("probability"):
                return 1.0 - (1.0 - value) / times
            return times * max(value, tick_ms if key.endswith("_ms") else 0)

        update = {key: more(key) for key in keys}
        return config.model_copy(update={section: part.model_copy(update=update)})

    return Mutant(text.format(f"{times} times"), settings=settings)


KINDS: Final[tuple[Callable[[random.Random], Mutant], ...]] = (
    partial(_instead, what="is never bad", old=Flag.BAD, new=Flag.GOOD),
    partial(_instead, what="is good where it should be unknown", old=Flag.UNKNOWN, new=Flag.GOOD),
    partial(_instead, what="is unknown where it should be bad", old=Flag.BAD, new=Flag.UNKNOWN),
    partial(_instead, what="is bad where it should be good", old=Flag.GOOD, new=Flag.BAD),
    partial(_instead, what="is unknown where it should be good", old=Flag.GOOD, new=Flag.UNKNOWN),
    _stuck, _held, _swapped, _everyone, _flicker, _of_the_set, _late, _frozen, _corrupted, _silent,
    _lost, _thresholds,
)  # fmt: skip
