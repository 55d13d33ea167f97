"""Read the DBC of inverters with messages of their own, and plan the conversion to ours.

This happens only at start. `translate` makes the messages that the core receives from such a
drive: they are of our kinds, with the resolution and cycle of the foreign signals, and 32 bits for
each signal so that nothing clips. May know: DBCs, configuration. May not know: frames, clocks,
buses.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

from dbc.codec import Codec
from dbc.e2e import p02_data_ids
from dbc.frame import MS, Nanos
from dbc.spec import DbcMismatch, MessageSpec, Profile, SignalSpec
from dbc.text import near
from gateway.settings.config import Config, ConfigError, Motor
from gateway.settings.sections import Drive
from gateway.settings.signal_map import Signals, Source

BASES: Final = {
    "PhaseCurrents": 0x180, "StatorVoltages": 0x280, "Motion": 0x380, "Status": 0x1C0,
    "Temperatures": 0x480,
}  # fmt: skip
"""Identifiers of our message set, less the node; for a mapped drive, only translated frames have
them."""
CARRIES: Final = {
    "PhaseCurrents": ("Ia", "Ib", "Ic"), "StatorVoltages": ("Ualpha", "Ubeta"),
    "Motion": ("Speed", "Torque"), "Status": ("TorqueCommand", "Irms"),
    "Temperatures": ("Tstator", "Tde", "Tnde", "Tambient"),
}  # fmt: skip
OWN_CANOPEN: Final = {0x720: "the gateway's heartbeat", 0x0A0: "the gateway's emergencies"}
LEAST_NS: Final[dict[str, Nanos]] = {"Status": 100 * MS, "Motion": 10 * MS}
"""Shortest cycle, that of our message set, because all drives are compared with one another."""
NO_MESSAGE: Final = (
    "its mapped signals do not complete any message: docs/inverters.md says which signals belong "
    "together"
)
_LOWEST: Final = -(1 << 31)
_FD_SIZES: Final = (12, 16, 20, 24)

_OWN_KEY: Final = re.compile(r"((use|cycle_ms)\.\w+|id_offset|dbc): ")


class Plan(NamedTuple):
    """Plan of one drive.

    codec: of the foreign DBC's mapped messages, offset applied; sources: by message number of that
    codec, (our name, column name, source); spec: our message by kind; trigger: by kind, the
    quantity on whose reception our message is made.
    """

    node: int
    motor: Motor
    signals: Signals
    codec: Codec
    sources: Mapping[int, tuple[tuple[str, str, Source], ...]]
    spec: Mapping[str, MessageSpec]
    trigger: Mapping[str, str]
    sends: Mapping[int, str]
    """Names of all messages that the file lists, by identifier, offset applied."""


def plans(config: Config) -> list[Plan]:
    """Plans of all drives that have signals. Raises ConfigError with the problems of all drives."""
    mapped = [drive for drive in config.drive if drive.signals is not None]
    if mapped and config.sealed:
        cure = "use a DBC with this project's messages, which is signed, or leave out --public-key"
        raise ConfigError("drive.signals", [f"its DBC is not covered by the signature; {cure}"])
    problems: list[str] = []
    out = []
    for position, drive in enumerate(config.drive):
        if drive.signals is None:
            continue
        try:
            out.append(_plan(config, drive, drive.signals))
        except ConfigError as error:
            for line in error.problems:
                key, _, text = line.partition(": ") if _OWN_KEY.match(line) else ("", "", line)
                problems.append(f"{config.signals_path(position, key)}: {text}")
    if problems:
        raise config.error(problems)
    return out


def fitted(codec: Codec, planned: list[Plan], *, creep: bool = False) -> Codec:
    """Our message set as the core receives it, with the planned messages for mapped drives.

    creep: the gateway sends its optional messages. Raises ConfigError where identifiers collide.
    """
    if not planned:
        return codec
    nodes = {plan.node for plan in planned}
    _apart(codec, planned, creep)
    kept = [s for s in codec.messages if s.is_gateway or s.node not in nodes]
    made = [spec for plan in planned for spec in plan.spec.values()]
    numbered = [replace(spec, index=k) for k, spec in enumerate([*kept, *made])]
    return Codec(codec.path, numbered, codec.digest)


def _apart(codec: Codec, planned: list[Plan], creep: bool) -> None:
    """Raise ConfigError if an inverter's identifier is the gateway's or another inverter's."""
    nodes = {plan.node for plan in planned}
    own = {s.key: s.name for s in codec.own(creep=creep) if s.node in (0, *nodes)}
    own |= OWN_CANOPEN
    taken: dict[int, int] = {}
    problems = []
    for plan in planned:
        for key, name in plan.sends.items():
            where = f"drive {plan.node}: {name} ({key & 0x1FFFFFFF:#x})"
            if key in own:
                problems.append(f"{where} has the identifier of {own[key]}; move it by id_offset")
        for spec in plan.codec.messages:
            other = taken.setdefault(spec.key, plan.node)
            if other != plan.node and spec.key not in _shared(planned, other, plan):
                problems.append(
                    f"drive {plan.node}: {spec.name} ({spec.can_id:#x}) is also used by drive "
                    f"{other}; give each its id_offset or its own signals"
                )
    if problems:
        raise ConfigError("drive.signals", problems)


def _shared(planned: list[Plan], other: int, plan: Plan) -> set[int]:
    """Identifiers from which two drives use different signals: one controller has two motors."""
    (first,) = [p for p in planned if p.node == other]
    out = set()
    for spec in plan.codec.messages:
        mine = {column for _, column, _ in plan.sources[spec.index]}
        theirs = {
            column
            for there in first.codec.messages
            if there.key == spec.key
            for _, column, _ in first.sources[there.index]
        }
        if not mine & theirs:
            out.add(spec.key)
    return out


def given(signals: Signals) -> dict[str, tuple[str, ...]]:
    """By our kind of message, the quantities it is made of; only kinds that can be made."""
    use = signals.use
    phases, voltages = signals.phases, signals.voltages
    torque = next((n for n in ("Torque", "Iq") if n in use), None)
    command = next((n for n in ("TorqueCommand", "Torque", "Iq") if n in use), None)
    amount = ("Irms",) if "Irms" in use else phases or (("Id", "Iq") if "Id" in use else ())
    out = {
        "PhaseCurrents": phases,
        "StatorVoltages": voltages if phases else (),
        "Motion": ("Speed", torque) if "Speed" in use and torque else (),
        "Status": (command, *amount) if command and amount else (),
        "Temperatures": tuple(n for n in CARRIES["Temperatures"] if n in use),
    }
    return {kind: parts for kind, parts in out.items() if parts}


def raw_ends(signal: SignalSpec) -> tuple[int, ...]:
    """Raw values at the ends of an integer signal's range, and of the range of its bits."""
    low, high = 0, (1 << signal.length) - 1
    if signal.is_signed:
        low, high = -(1 << (signal.length - 1)), (1 << (signal.length - 1)) - 1
    return tuple(sorted({low, signal.raw_min, signal.raw_max, high}))


def _plan(config: Config, drive: Drive, signals: Signals) -> Plan:
    path = config.base / signals.dbc
    specs, problems, sends, left_out = _messages(path, signals)
    by_name = {spec.name: spec for spec in specs}
    sources: dict[int, list[tuple[str, str, Source]]] = {}
    of: dict[str, int] = {}
    resolution: dict[str, float] = {}
    for name, source in signals.use.items():
        spec = by_name.get(source.message)
        if spec is None:
            why = _why(left_out, source.message) or near(source.message, sends.values())
            problems.append(f"use.{name}: {path.name} has no message {source.message!r}{why}")
            continue
        found = {signal.name: signal for signal in spec.signals}.get(source.name)
        if found is None:
            names = [signal.name for signal in spec.signals]
            why = _why(left_out, source.name) or near(source.name, names)
            what = f"use.{name}: {source.message} has no signal {source.name!r}"
            problems.append(f"{what}; it has {', '.join(names)}{why}")
            continue
        sources.setdefault(spec.index, []).append((name, source.name, source))
        of[name] = spec.index
        resolution[name] = abs(source.scale * (1e-3 if found.is_float else found.scale))
    unknown = set(signals.cycle_ms) - set(sends.values())
    problems += [
        f"cycle_ms.{name}: {path.name} has no such message; remove it{near(name, sends.values())}"
        for name in sorted(unknown)
    ]
    kinds = given(signals)
    message_of = {str(name): source.message for name, source in signals.use.items()}
    needed = {message_of[name] for parts in kinds.values() for name in parts}
    problems += [
        f"cycle_ms.{name}: {path.name} has no cycle time of {name}: add cycle_ms.{name}"
        for name in sorted(needed & by_name.keys())
        if not by_name[name].cycle_ns
    ]
    if problems:
        raise ConfigError("signals", list(dict.fromkeys(problems)))
    spec_of = {}
    for kind, parts in kinds.items():
        cycle = specs[of[parts[0]]].cycle_ns
        if kind in LEAST_NS:
            cycle = max(LEAST_NS[kind], *(specs[of[n]].cycle_ns for n in parts))
        scales = {n: _scale(n, parts, resolution) for n in CARRIES[kind]}
        spec_of[kind] = _spec(kind, drive.node, cycle, scales)
    trigger = {kind: parts[0] for kind, parts in kinds.items()}
    content = hashlib.sha256(path.read_bytes()).hexdigest()
    used = [_used(spec, {column for _, column, _ in sources[spec.index]}) for spec in specs]
    return Plan(
        drive.node, config.motors[drive.motor], signals, Codec(path, used, content),
        {index: tuple(rows) for index, rows in sources.items()}, spec_of, trigger, sends,
    )  # fmt: skip


def _used(spec: MessageSpec, names: set[str]) -> MessageSpec:
    """The message with these signals and those that select them: others would only cost time."""
    parents = {signal.name: signal.mux_parent for signal in spec.signals}
    while more := {parent for name in names if (parent := parents[name])} - names:
        names = names | more
    return replace(spec, signals=tuple(s for s in spec.signals if s.name in names))


def _why(left_out: list[str], name: str) -> str:
    """Reason why the reader of the file left out an entry, in brackets; empty if there is none."""
    return next(
        (
            f" ({line})"
            for line in left_out
            if name in line.replace(":", " ").replace(".", " ").split()
        ),
        "",
    )


def _messages(
    path: Path, signals: Signals
) -> tuple[list[MessageSpec], list[str], dict[int, str], list[str]]:
    """The mapped messages, numbered, with offset and cycles; problems; all messages' names.

    The fourth result lists the file's unusable entries, which matter only if they are mapped.
    """
    from dbc.tolerant import read_any_dbc

    try:
        specs, left_out = read_any_dbc(path)
    except DbcMismatch as error:
        lines = [f"dbc: {path.name}: {line}" for line in error.problems]
        raise ConfigError("signals", lines) from None
    wanted = {source.message for source in signals.use.values()}
    problems: list[str] = []
    out: list[MessageSpec] = []
    sends = {spec.key + signals.id_offset: spec.name for spec in specs}
    for spec in specs:
        if spec.name not in wanted:
            continue
        can_id = spec.can_id + signals.id_offset
        if not 0 <= can_id < (1 << (29 if spec.is_extended else 11)):
            problems.append(
                f"id_offset: {spec.name} would get the invalid identifier {can_id:#x}; correct it"
            )
            can_id = spec.can_id
        cycle = signals.cycle_ms.get(spec.name)
        out.append(replace(
            spec, index=len(out), can_id=can_id, profile=Profile.NONE,
            cycle_ns=spec.cycle_ns if cycle is None else round(cycle * MS),
        ))  # fmt: skip
    return out, problems, sends, left_out


def _scale(name: str, parts: tuple[str, ...], resolution: Mapping[str, float]) -> float:
    """Resolution of our signal: that of its sources; 0.01 or finer for a computed torque or RMS."""
    if name in resolution:
        return resolution[name]
    known = [resolution[p] for p in parts if p in resolution and p != "ElectricalAngle"]
    return min([*known, 0.01]) if name in ("Torque", "TorqueCommand", "Irms") else min(known)


def _spec(kind: str, node: int, cycle: Nanos, scales: Mapping[str, float]) -> MessageSpec:
    header = (SignalSpec("Crc", 0, 8, raw_max=255), SignalSpec("Counter", 8, 4, raw_max=15))
    values = tuple(
        SignalSpec(
            name, 16 + 32 * k, 32, is_signed=True, scale=scales[name], raw_min=_LOWEST + 1,
            raw_max=-_LOWEST - 1, not_available=_LOWEST,
        )
        for k, name in enumerate(CARRIES[kind])
    )  # fmt: skip
    can_id = BASES[kind] + node
    return MessageSpec(
        name=f"Drive{node}_{kind}", can_id=can_id, is_fd=True, brs=False, cycle_ns=cycle,
        length=next(n for n in _FD_SIZES if n >= 2 + 4 * len(values)), profile=Profile.P02,
        data_ids=p02_data_ids(can_id), signals=(*header, *values), index=0, node=node, kind=kind,
    )  # fmt: skip
