"""Gateways with a fault, to test whether a test suite detects it.

A mutant alters the recorded flag frames. Their checksum is computed again and their counter kept,
so that nothing is wrong but the mutant's fault. In the run, the drives received the original
frames.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final, NamedTuple

from dbc.codec import Codec
from dbc.e2e import counter_of, protect
from dbc.frame import MS, SECOND, Frame, Nanos
from dbc.spec import MessageSpec, Validity
from gateway.core.codes import Flag

FLAG_MESSAGES: Final = ("Gateway_Adhesion", "Gateway_Faults")


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


Alter = Callable[[list[Sent], Sequence[int]], list[Sent]]
"""(frames of a run in order, node numbers) -> frames on the bus instead."""


class Mutant(NamedTuple):
    """A fault in words, and the function that makes it."""

    text: str
    alter: Alter


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


def mutants(count: int, seed: int) -> list[Mutant]:
    """`count` different mutants drawn by seed, fewer if no more are found."""
    rng = random.Random(seed)  # noqa: S311 a choice of tests
    found: dict[str, Mutant] = {}
    for _ in range(100 * count):
        if len(found) == count:
            break
        mutant = rng.choice(KINDS)(rng)
        found.setdefault(mutant.text, mutant)
    return list(found.values())


def _each(change: Callable[[Sent, Sequence[int]], Sent]) -> Alter:
    return lambda sent, nodes: [change(one, nodes) for one in sent]


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

    return Mutant(f"{kind.lower()} of drive {place + 1} {what}", _each(change))


def _stuck(rng: random.Random) -> Mutant:
    kind, place = _flag(rng)

    def alter(sent: list[Sent], nodes: Sequence[int]) -> list[Sent]:
        name, first, out = f"{kind}{_node(nodes, place)}", None, []
        for one in sent:
            first = one.values.get(name, first) if first in (None, Flag.UNKNOWN) else first
            out.append(one if first is None else one.having(**{name: int(first)}))
        return out

    return Mutant(f"{kind.lower()} of drive {place + 1} stays what it was at first", alter)


def _held(rng: random.Random) -> Mutant:
    kind, place = _flag(rng)

    def alter(sent: list[Sent], nodes: Sequence[int]) -> list[Sent]:
        name, bad, out = f"{kind}{_node(nodes, place)}", False, []
        for one in sent:
            bad = bad or one.values.get(name) == Flag.BAD
            out.append(one.having(**{name: Flag.BAD}) if bad else one)
        return out

    return Mutant(f"{kind.lower()} of drive {place + 1} stays bad for ever", alter)


def _swapped(rng: random.Random) -> Mutant:
    kind, place = _flag(rng)
    other = place + rng.randrange(1, 3)

    def change(one: Sent, nodes: Sequence[int]) -> Sent:
        a, b = (f"{kind}{_node(nodes, k)}" for k in (place, other))
        if a not in one.values:
            return one
        return one._replace(values={**one.values, a: one.values[b], b: one.values[a]})

    text = f"{kind.lower()} of drives {place + 1} and {other % 3 + 1} is swapped"
    return Mutant(text, _each(change))


def _everyone(rng: random.Random) -> Mutant:
    kind, _ = _flag(rng)

    def change(one: Sent, nodes: Sequence[int]) -> Sent:
        names = [f"{kind}{node}" for node in nodes]
        bad = any(one.values.get(name) == Flag.BAD for name in names)
        return one.having(**dict.fromkeys(names, Flag.BAD)) if bad else one

    return Mutant(f"one drive's bad {kind.lower()} is all drives'", _each(change))


def _flicker(rng: random.Random) -> Mutant:
    kind, place = _flag(rng)
    every = rng.choice((50, 100, 200))

    def alter(sent: list[Sent], nodes: Sequence[int]) -> list[Sent]:
        name = f"{kind}{_node(nodes, place)}"
        return [
            one.having(**{name: Flag.BAD}) if k % every == every - 1 else one
            for k, one in enumerate(sent)
        ]

    return Mutant(f"{kind.lower()} of drive {place + 1} is bad once in {every} frames", alter)


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
        lambda sent, _: [one for one in sent if one.t_ns < from_s * SECOND],
    )


def _lost(rng: random.Random) -> Mutant:
    every = rng.choice((100, 10))

    def alter(sent: list[Sent], _nodes: Sequence[int]) -> list[Sent]:
        return [one for k, one in enumerate(sent) if k % every != every - 1]

    return Mutant(f"one flag frame in {every} lost", alter)


KINDS: Final[tuple[Callable[[random.Random], Mutant], ...]] = (
    partial(_instead, what="is never bad", old=Flag.BAD, new=Flag.GOOD),
    partial(_instead, what="is good where nobody knows", old=Flag.UNKNOWN, new=Flag.GOOD),
    partial(_instead, what="is unknown where it should be bad", old=Flag.BAD, new=Flag.UNKNOWN),
    partial(_instead, what="is bad where it should be good", old=Flag.GOOD, new=Flag.BAD),
    partial(_instead, what="is unknown where it should be good", old=Flag.GOOD, new=Flag.UNKNOWN),
    _stuck, _held, _swapped, _everyone, _flicker, _of_the_set, _late, _frozen, _corrupted, _silent,
    _lost,
)  # fmt: skip
