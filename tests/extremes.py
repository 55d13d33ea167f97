"""Drives' frames of extreme but legal raw values, headers right: a rule makes the values of some
messages of some drives for a while.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

import gateway
from dbc.e2e import protect
from dbc.spec import SignalSpec
from gateway.settings.config import parse
from tests.simrun import CLASSIC, FD_FILE, codec

CALIBRATION = Path(gateway.__path__[0]) / "bench_calibration.toml"
HEADER = ("Crc", "Counter", "SampleIndex", "Quality")
MESSAGES = ("electrical", "PhaseCurrents", "StatorVoltages", "Samples", "Motion", "Status",
            "Temperatures", "all")  # fmt: skip


class At(NamedTuple):
    """Where a frame stands. k: number of this message's frame in the stretch; raws: honest ones;
    first: those of the first frame of the stretch."""

    k: int
    raws: list[int]
    first: list[int]
    rng: np.random.Generator


Rule = Callable[[At, Sequence[SignalSpec]], list[int]]


def _all(pick):
    return lambda _at, signals: [_legal(s, pick(s)) for s in signals]


def _legal(s, raw):
    return min(max(raw, s.raw_min), s.raw_max)


def _pattern(*values):
    """Every signal goes through parts of its highest value, the next signal a step behind."""

    def rule(at, signals):
        n = len(values)
        return [_legal(s, round(values[(at.k - j) % n] * s.raw_max)) for j, s in enumerate(signals)]

    return rule


def _ends(at, signals):
    return [int(at.rng.choice([s.raw_min, s.raw_max])) for s in signals]


def _any_legal(at, signals):
    return [int(at.rng.integers(s.raw_min, s.raw_max, endpoint=True)) for s in signals]


def _any_bits(at, signals):
    return [int(at.rng.integers(0, 1 << s.length)) for s in signals]


def _edges(at, signals):
    return [
        int(at.rng.choice([s.raw_min, s.raw_max, 0, 1, -1, s.not_available or 0, s.start_raw]))
        for s in signals
    ]


def _sometimes(rule, share):
    return lambda at, signals: rule(at, signals) if at.rng.random() < share else at.raws


def _axis(*parts):
    """Currents (or whatever there is) in fixed proportions: on one axis."""

    def rule(at, signals):
        return [_legal(s, round(parts[j % len(parts)] * at.raws[0])) for j, s in enumerate(signals)]

    return rule


RULES: dict[str, Rule] = {
    "zero": _all(lambda _: 0),
    "one": _all(lambda _: 1),
    "minus one": _all(lambda _: -1),
    "highest": _all(lambda s: s.raw_max),
    "lowest": _all(lambda s: s.raw_min),
    "below highest": _all(lambda s: s.raw_max - 1),
    "thousand": _all(lambda _: 1000),
    "not available": lambda _at, signals: [
        s.raw_max if s.not_available is None else s.not_available for s in signals
    ],
    "held": lambda at, _: at.first,
    "held but for a bit": lambda at, _: [raw ^ (at.k & 1) for raw in at.first],
    "alternating ends": lambda at, signals: [
        s.raw_max if (at.k + j) % 2 else s.raw_min for j, s in enumerate(signals)
    ],
    "alternating together": lambda at, signals: [
        s.raw_max if at.k % 2 else s.raw_min for s in signals
    ],
    "alternating inside": lambda at, signals: [
        (s.raw_max - 1 if at.k % 2 else s.raw_min + 1) // 2 for s in signals
    ],
    "three": _pattern(0.25, -0.125, -0.125),
    "four": _pattern(0.25, 0.0, -0.25, 0.0),
    "four high": _pattern(0.999, 0.0, -0.999, 0.0),
    "six": _pattern(0.1, 0.1, 0.0, -0.1, -0.1, 0.0),
    "twelve": _pattern(*(0.02 * np.cos(np.arange(12) * np.pi / 6.0))),
    "ends": _ends,
    "any": _any_legal,
    "any bits": _any_bits,
    "edges": _edges,
    "now and then": _sometimes(_edges, 0.2),
    "axis a": _axis(1.0, -0.5, -0.5),
    "axis b": _axis(0.0, 1.0, -1.0),
    "axis ab": _axis(1.0, -1.0, 0.0),
    "reversed": lambda at, signals: [_legal(s, -r) for s, r in zip(signals, at.raws, strict=True)],
}


class Setup(NamedTuple):
    """A gateway and its drives."""

    drives: int = 3
    kind: str = "ekf"
    fd: bool = False
    speed: float = 200.0
    motor: str = "bench"
    detector: str = "vb"
    thermal: bool = False
    """With the bench's calibration, so that temperatures are judged by the model."""

    @property
    def nodes(self):
        """CANopen numbers."""
        return tuple(range(1, self.drives + 1))

    @property
    def codec(self):
        """Bound for these drives."""
        return codec(self.nodes, FD_FILE if self.fd else CLASSIC)

    def config(self):
        """Of the gateway."""
        more = {"thermal": {"calibration": str(CALIBRATION)}} if self.thermal else {}
        return parse({
            "dbc": {"file": "traction_fd.dbc" if self.fd else "traction.dbc"},
            "drive": [{"node": node, "motor": self.motor} for node in self.nodes],
            "estimator": {"kind": self.kind}, "adhesion": {"detector": self.detector}, **more,
        })  # fmt: skip


class Stretch(NamedTuple):
    """What happens to which messages, and to the drives (from 0) of which."""

    rule: str
    message: str
    drives: tuple[int, ...]


def fits(spec, message):
    """Whether a stretch changes this message."""
    if message == "electrical":
        return spec.kind in ("PhaseCurrents", "StatorVoltages", "Samples")
    return message in ("all", spec.kind)


def changed(setup, stretch, blocks, seed):
    """Honest frames of consecutive ticks, their values made by the stretch's rule."""
    specs = {
        spec.can_id: spec
        for spec in setup.codec.messages
        if spec.node in setup.nodes and not spec.is_gateway and fits(spec, stretch.message)
        and spec.node - 1 in stretch.drives
    }  # fmt: skip
    signals = {
        key: [s for s in spec.signals if s.name not in HEADER] for key, spec in specs.items()
    }
    rng = np.random.default_rng([seed, 1])
    count = {}
    first = {}
    for block in blocks:
        out = block._replace(data=block.data.copy())
        for k, can_id in enumerate(block.can_id.tolist()):
            spec = specs.get(can_id)
            if spec is None:
                continue
            word = int.from_bytes(block.data[k, : spec.length].tobytes(), "little")
            raws = [_raw(word, s) for s in signals[can_id]]
            at = At(count.get(can_id, 0), raws, first.setdefault(can_id, raws), rng)
            count[can_id] = at.k + 1
            new = RULES[stretch.rule](at, signals[can_id])
            for s, raw in zip(signals[can_id], new, strict=True):
                mask = (1 << s.length) - 1
                word = word & ~(mask << s.start) | (raw & mask) << s.start
            payload = bytearray(word.to_bytes(spec.length, "little"))
            counter = payload[2] if spec.is_fd else payload[1] & 15
            protect(spec, payload, counter)
            out.data[k, : spec.length] = np.frombuffer(payload, dtype=np.uint8)
        yield out


def _raw(word, s):
    raw = word >> s.start & ((1 << s.length) - 1)
    return raw - (1 << s.length) if s.is_signed and raw >> s.length - 1 else raw
