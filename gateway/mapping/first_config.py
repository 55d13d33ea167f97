"""Text of a first configuration, with a comment wherever a person has to check it."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from gateway.mapping.bus_fit import Cycle
from gateway.mapping.guess import Guess
from gateway.mapping.plan import given
from gateway.settings.signal_map import SENSORS, UNITS, Signals, Source

_OTHERS: Final = 3
GUESSED_MS: Final = 10.0
_MOTOR: Final = """
# Parameters of the motor, from its data sheet, in SI units. Until they are here, the drives above
# have the bench motor of this project, and `check --log` says what does not fit.
# [motor.mine]
# R_s = 0.28           # ohm, of a phase
# L_s = 3.465e-3       # H, of a phase
# psi_pm = 0.1989      # Wb, flux linkage of the magnets
# pole_pairs = 4
# J = 0.04             # kg m2, rotor and wheel at the motor shaft
# I_rated = 25.0       # A, amplitude of the phase current
# T_rated = 30.0       # Nm, at the motor shaft
"""


class Shared(NamedTuple):
    """What all drives with one message set of another maker have in common.

    dbc: path as written in the configuration. cycle_ms: by message, where the DBC has no cycle
    time or the log another; None: the log shows none either. measured: what the log shows, by
    message. offset: of the first drive's identifiers; step: distance to the next drive's
    identifiers; source: where the step is from, empty for a guess.
    """

    name: str
    dbc: str
    chosen: Sequence[Guess]
    found: Mapping[str, Sequence[Guess]]
    cycle_ms: Mapping[str, float | None]
    measured: Mapping[str, Cycle]
    offset: int
    step: int
    source: str


def ours(drives: int, dbc: str) -> str:
    """Configuration of drives with our own message set; `dbc`: file, empty for the shipped one."""
    lines = ["# Drives that speak the message set of this project.", ""]
    if dbc:
        lines += ["[dbc]", f"file = {_quoted(dbc)}", ""]
    for node in range(1, drives + 1):
        lines += ["[[drive]]", f"node = {node}", 'motor = "bench"    # or "mine", see below', ""]
    return "\n".join(lines).rstrip("\n") + "\n" + _MOTOR


def mapped(drives: int, shared: Shared) -> str:
    """Configuration of drives with messages of another maker."""
    use = {guess.quantity: guess for guess in shared.chosen if guess.sure}
    lines = [
        f"# Written from names and units in {printed(shared.dbc)}: a guess.",
        "# Look at every signal before you believe a flag. `traction-gateway check THIS.toml --log",
        "# FILE` compares them with a recording.",
        "",
    ]
    if not _can_model(use):
        lines += _without_model(drives)
    sensors = [name for quantity, name in SENSORS.items() if quantity in use]
    for number in range(drives):
        lines += ["[[drive]]", f"node = {number + 1}", f'inverter = "{shared.name}"']
        offset = shared.offset + shared.step * number
        why = (shared.source or "GUESSED: correct it") if number else "as --id-offset says"
        lines += [f"id_offset = {offset:#x}    # {why}"] if offset else []
        lines += ['motor = "bench"    # or "mine", see below']
        if sensors:
            lines += [f"sensors = [{', '.join(map(repr, sensors))}]".replace("'", '"')]
        lines += [""]
    own = [f"dbc = {_quoted(shared.dbc)}", *_cycles(shared), ""]
    lines += [f"[inverter.{shared.name}]", *own]
    lines += [f"[inverter.{shared.name}.use]", *_signals(shared, use)]
    return "\n".join(lines) + "\n" + _MOTOR


def _without_model(drives: int) -> list[str]:
    """`[thermal]` for drives that the thermal model cannot judge."""
    needs = "the model needs an ambient temperature, torque, speed and current"
    if drives > 1:
        return ["[thermal]", f'method = "maisd"    # {needs}', ""]
    return [f"# No thermal flag: {needs},", '# and method "maisd" the motors of two drives.', ""]


def _can_model(use: Mapping[str, Guess]) -> bool:
    signals = Signals(dbc="x", use={name: Source(signal=g.name) for name, g in use.items()})
    kinds = given(signals)
    return "Tambient" in use and {"Temperatures", "Motion", "Status"} <= set(kinds)


def guessed(shared: Shared) -> list[str]:
    """Messages whose cycle time is written as `GUESSED_MS`, because neither file nor log has it."""
    return [name for name in _without(shared) if shared.cycle_ms[name] is None]


def _without(shared: Shared) -> list[str]:
    """Messages without a cycle time in the DBC, those of proposed signals too.

    The cycle times of proposals stand in the file, so that a proposal can be used by removing `#`.
    """
    names = dict.fromkeys(guess.message.name for guess in shared.chosen)
    return [name for name in names if name in shared.cycle_ms]


def _cycles(shared: Shared) -> list[str]:
    names, unknown = _without(shared), guessed(shared)
    if not names:
        return []
    cycles = ", ".join(f"{name} = {shared.cycle_ms[name] or GUESSED_MS:g}" for name in names)
    comment = "as in the log"
    if unknown == names:
        comment = "GUESSED, neither file nor log has them: correct it"
        comment = comment if shared.measured else "GUESSED, the file has none: correct it"
    elif unknown:
        comment += f", except {', '.join(unknown)}: GUESSED, correct it"
    return [f"cycle_ms = {{ {cycles} }}    # ms; {comment}"]


def _signals(shared: Shared, use: Mapping[str, Guess]) -> list[str]:
    lines = []
    taken = {_of_any_drive(guess) for guess in shared.chosen}
    for quantity, guesses in shared.found.items():
        best = next((g for g in shared.chosen if g.quantity == quantity), None)
        if best is None:
            continue
        unit = best.signal.unit.strip() or f"the file has no unit: {UNITS[quantity]}?"
        if best.electrical:
            unit = "electrical: scale = 1 / pole pairs; correct it, then remove #"
        sign = "" if quantity in use else "# "
        lines.append(f"{sign}{quantity} = {_value(best)}    # {printed(unit)}")
        names = [g.name for g in guesses if _of_any_drive(g) not in taken]
        if names[:_OTHERS]:
            lines.append(f"#   or {', '.join(names[:_OTHERS])}")
    return lines


def _of_any_drive(guess: Guess) -> str:
    """Name without its numbers, in which the same signals of different drives differ."""
    return re.sub(r"\d+", "#", guess.name)


def _value(guess: Guess) -> str:
    if (guess.scale, guess.offset) == (1.0, 0.0):
        return f'"{guess.name}"'
    parts = [f'signal = "{guess.name}"']
    parts += [f"scale = {guess.scale:g}"] if guess.scale != 1.0 else []
    parts += [f"offset = {guess.offset:g}"] if guess.offset else []
    return f"{{ {', '.join(parts)} }}"


def _quoted(text: str) -> str:
    """Text as a TOML string, which has JSON's escapes."""
    return json.dumps(text, ensure_ascii=False)


def printed(text: str) -> str:
    """Text from a file as one line, without a character that would end a comment."""
    return "".join(c if c.isprintable() else "?" for c in text)
