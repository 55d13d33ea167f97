"""`check` for another maker's inverter: which flags its mapped signals support."""

from __future__ import annotations

from collections.abc import Iterator

from gateway.core.motion import FEWEST_SAMPLES
from gateway.mapping import lacks
from gateway.mapping.plan import Plan, given, raw_ends
from gateway.settings.signal_map import UNITS


def signal_lines(plan: Plan) -> list[str]:
    """Lines of one drive; the first begins with its name."""
    first = f"drive {plan.node}"
    lines = [*_sources(plan), *_limits(plan), *_codes(plan)]
    return [f"{first if k == 0 else '':<14} {line}" for k, line in enumerate(lines)]


def _sources(plan: Plan) -> Iterator[str]:
    names = {
        "PhaseCurrents": "currents", "StatorVoltages": "voltages", "Motion": "motion",
        "Status": "torque, RMS current", "Temperatures": "temperatures",
    }  # fmt: skip
    yield f"{plan.signals.dbc}, identifiers moved by {plan.signals.id_offset:#x}"
    for kind, parts in given(plan.signals).items():
        cycle_ms = plan.spec[kind].cycle_ns / 1e6
        yield f"{names[kind]} from {', '.join(parts)}, every {cycle_ms:g} ms"


def _codes(plan: Plan) -> Iterator[str]:
    """Lines for ends of raw ranges that may mean "no value" but are not declared as such."""
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
            listed = ", ".join(map(str, ends))
            yield (
                f"{name}: raw {codes} may mean that there is no value; if so: "
                f'{name} = {{ signal = "{source.signal}", not_available = [{listed}] }}'
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
