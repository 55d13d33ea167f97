"""`check` for another maker's inverter: which flags its mapped signals support."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence

from gateway.core.motion import FEWEST_SAMPLES
from gateway.mapping import lacks
from gateway.mapping.plan import Plan, given, raw_ends
from gateway.settings.signal_map import UNITS, Source


def signal_lines(planned: Sequence[Plan]) -> list[str]:
    """Lines of all drives of other makers; those with the same signals share theirs."""
    alike: dict[tuple[str, ...], list[Plan]] = {}
    for plan in planned:
        lines = (plan.signals.dbc, *_sources(plan), *_limits(plan), *_codes(plan))
        alike.setdefault(lines, []).append(plan)
    out = []
    for (dbc, *shared), plans in alike.items():
        nodes = [plan.node for plan in plans]
        in_a_row = len(nodes) > 2 and nodes == list(range(nodes[0], nodes[-1] + 1))
        which = f"{nodes[0]}-{nodes[-1]}" if in_a_row else ", ".join(map(str, nodes))
        whose = f"drive{'s' * (len(nodes) > 1)} {which}"
        offsets = ", ".join(f"{plan.signals.id_offset:#x}" for plan in plans)
        out.append(f"{whose:<14} {dbc}, identifiers moved by {offsets}")
        out += [f"{'':<14} {line}" for line in shared]
    return out


def _sources(plan: Plan) -> Iterator[str]:
    names = {
        "PhaseCurrents": "currents", "StatorVoltages": "voltages", "Motion": "motion",
        "Status": "torque, RMS current", "Temperatures": "temperatures",
    }  # fmt: skip
    for kind, parts in given(plan.signals).items():
        cycle_ms = plan.spec[kind].cycle_ns / 1e6
        yield f"{names[kind]} from {', '.join(parts)}, every {cycle_ms:g} ms"


def _codes(plan: Plan) -> Iterator[str]:
    """Lines for ends of raw ranges that may mean "no value" but are not declared as such."""
    alike: dict[tuple[str, tuple[int, ...]], list[tuple[str, Source]]] = {}
    for spec in plan.codec.messages:
        for name, column, source in plan.sources[spec.index]:
            signal = spec.signals[spec.column(column)]
            if signal.is_float or signal.not_available is not None or source.not_available:
                continue
            if name == "Counter":
                continue
            ends = raw_ends(signal)
            if UNITS[name] != "degC":
                # Except for temperatures, 0 is an ordinary value, and so are the DBC's limits.
                ends = tuple(raw for raw in (ends[0], ends[-1]) if raw)
            codes = ", ".join(
                f"{raw} ({source.scale * (signal.scale * raw + signal.offset) + source.offset:g})"
                for raw in ends
            )
            alike.setdefault((codes, ends), []).append((name, source))
    for (codes, ends), sources in alike.items():
        name, source = sources[0]
        new = source.model_copy(update={"not_available": ends}).model_dump(exclude_defaults=True)
        entry = ", ".join(f"{key} = {json.dumps(value)}" for key, value in new.items())
        yield (
            f"{', '.join(name for name, _ in sources)}: raw {codes} may mean that there is no "
            f"value; if so: {name} = {{ {entry} }}"
        )


def _limits(plan: Plan) -> Iterator[str]:
    kinds = given(plan.signals)
    use = plan.signals.use
    adhesion = lacks.adhesion(kinds, plan.signals)
    if adhesion:
        yield f"adhesion: always Unknown: {', '.join(adhesion)}"
    else:
        yield from _rate(plan, measured="Motion" in kinds)
    thermal = lacks.thermal(plan.signals)
    if thermal:
        yield f"thermal by the model: always Unknown: {', '.join(thermal)}"
    if "Torque" not in use and "Iq" in use and ("Motion" in kinds or "Status" in kinds):
        yield "torque: computed without reluctance torque, 1.5 p psi_pm Iq"
    if "TorqueCommand" not in use and "Status" in kinds:
        yield "torque command: none; the torque is used instead"
    if "Counter" not in use:
        yield "no counter: a lost frame is detected by time only, a repeated one not at all"
    yield "no checksum: a corrupted frame that the CAN controller does not reject is accepted"


def _rate(plan: Plan, *, measured: bool) -> Iterator[str]:
    cycle_s = plan.spec["PhaseCurrents"].cycle_ns / 1e9
    rpm = 60.0 / (FEWEST_SAMPLES * cycle_s * plan.motor.pole_pairs)
    above = "by measured speed and torque" if measured else "Unknown: no measured speed"
    yield f"adhesion: by the currents up to {rpm:.0f} rpm; above that {above}"
