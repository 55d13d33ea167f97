"""Every code of a flag frame: what it means, what to do about it, and what brings it about."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import IntEnum
from typing import Any, Final, NamedTuple

from gateway.core.codes import FaultClass, Health, Reason
from gateway.reports.record import camel
from gateway.reports.words import REASONS


class Advice(NamedTuple):
    """remedy: what to look at, or do; example: what has brought it about."""

    meaning: str
    remedy: str
    example: str


class Explained(NamedTuple):
    """One code. kind: the signal that it stands in."""

    kind: str
    code: IntEnum
    advice: Advice

    @property
    def name(self) -> str:
        """As the DBC's value table has it."""
        return camel(self.code.name)


_REASONS: Final = {
    Reason.NONE: (
        "nothing is unknown: every flag says what it knows",
        "nothing",
        "all drives are driven, and their messages come",
    ),
    Reason.STARTING: (
        REASONS[Reason.STARTING],
        "wait; after a second of driving look at `Health`, and at the motor's parameters",
        "the first 0.2 s after the start; a train at standstill",
    ),
    Reason.STALE: (
        REASONS[Reason.STALE],
        "is the drive powered, and on this bus? `candump` shows its identifiers, `check` limits",
        "the drive's CAN connector is off; its messages come ten times slower than the DBC says",
    ),
    Reason.CORRUPTED: (
        REASONS[Reason.CORRUPTED],
        "termination, shield, bit rate; where the drive protects nothing, map it without E2E",
        "a bus with one terminator; a drive that computes another CRC",
    ),
    Reason.SEQUENCE: (
        REASONS[Reason.SEQUENCE],
        "look for a second sender of these identifiers, and for an overloaded bus",
        "two drives with one node number; a bus load above 90 %",
    ),
    Reason.RANGE: (
        REASONS[Reason.RANGE],
        "compare units, signs, phase order, pole pairs and flux with the motor's sheet",
        "currents in A/10 that are read as A; phases swapped; a wheel 10 % faster than the others",
    ),
    Reason.NOT_AVAILABLE: (
        REASONS[Reason.NOT_AVAILABLE],
        "let the drive send the signal, or leave it out of the mapping; is it in operation?",
        "`TorqueCommand` is 0x7FFF; `State` is Off",
    ),
    Reason.DIVERGED: (
        REASONS[Reason.DIVERGED],
        "if it comes back: the motor's parameters (flux and inductance first), and late samples",
        "a flux of the motor's sheet that is half of the true one",
    ),
    Reason.TOO_FEW_DRIVES: (
        REASONS[Reason.TOO_FEW_DRIVES],
        "drive with more than a tenth of rated torque; let the drives send `TorqueCommand`",
        "the train slows down without load; of two drives one is silent",
    ),
    Reason.OVERRUN: (
        REASONS[Reason.OVERRUN],
        "`run --realtime`, a processor of its own, `check` for the timing budget",
        "another program computes on the gateway's processor",
    ),
    Reason.INTRUDER: (
        REASONS[Reason.INTRUDER],
        "find who sends: a second gateway, a tester that replays a log; `docs/threats.md`",
        "a log with the gateway's own frames is sent onto the bus",
    ),
    Reason.CONFIG: (
        REASONS[Reason.CONFIG],
        "`traction-gateway calibrate` makes limits for the thermal flags from fault-free logs",
        "a thermal flag without `[thermal] calibration`; a motor whose thermal model did not hold "
        "on held-back logs",
    ),
}
_HEALTH: Final = {
    Health.UNKNOWN: (
        "nothing is estimated of this drive",
        "see the reason of its flag",
        "no currents have come yet",
    ),
    Health.CONVERGING: (
        "the estimator has begun and is not settled",
        "wait; drive: at standstill nothing shows the rotor's angle",
        "the first tenth of a second after a start",
    ),
    Health.TRACKING: (
        "speed and load are estimated from fresh samples",
        "nothing",
        "driving",
    ),
    Health.PREDICTING: (
        "no fresh sample: the last estimate is continued, for a short while",
        "look for lost frames",
        "20 ms without currents",
    ),
    Health.DIVERGED: (
        "estimate and measurement contradict one another: it starts anew",
        "the motor's parameters; late or swapped samples",
        "a resistance ten times that of the sheet",
    ),
    Health.INPUT_INVALID: (
        "the inputs cannot be used: corrupt, out of range, or implausible",
        "see the reason of its flag, and `RejectedFrames`",
        "held phase currents of a hung converter",
    ),
}
_FAULTS: Final = {
    FaultClass.UNKNOWN: (
        "not known; beside a raised flag: it is heat or a sensor, and nobody can tell which",
        "`calibrate`; look at the motor and at its sensors",
        "no calibration; too few temperatures for a verdict",
    ),
    FaultClass.NONE: ("no fault", "nothing", "temperatures as the model expects them"),
    FaultClass.OVERHEATING: (
        "the winding is hotter than its losses explain",
        "cut the torque; look at the winding and its insulation",
        "a short circuit between turns",
    ),
    FaultClass.COOLING_LOSS: (
        "heat does not leave the motor as it should",
        "fan, filter, air duct",
        "a filter full of leaves",
    ),
    FaultClass.BEARING: (
        "one end is warmed by friction",
        "grease, bearing, alignment; `FaultSensor` names the end",
        "a bearing without grease",
    ),
    FaultClass.SENSOR_BIAS: (
        "a sensor reads too much or too little; the motor is not concerned",
        "replace or recalibrate the sensor that `FaultSensor` names",
        "a contact resistance in the wire of a PT100",
    ),
    FaultClass.SENSOR_STUCK: (
        "a sensor says the same while the others change",
        "the sensor, or what converts it",
        "a converter that repeats its last value",
    ),
    FaultClass.SENSOR_LOST: (
        "a sensor has no value",
        "its wire and connector",
        "an open PT100",
    ),
    FaultClass.WINDING_RESISTANCE: (
        "the winding's resistance does not fit its temperature",
        "joints and terminals of the phases",
        "a loose cable shoe",
    ),
}
_KINDS: Final[tuple[tuple[str, Mapping[Any, tuple[str, str, str]]], ...]] = (
    ("Reason", _REASONS), ("Health", _HEALTH), ("FaultClass", _FAULTS),
)  # fmt: skip
ALL: Final = tuple(
    Explained(kind, code, Advice(*advice))
    for kind, codes in _KINDS
    for code, advice in codes.items()
)
"""In the order of kinds and numbers."""


def named(word: str) -> list[Explained]:
    """Codes with this number or name, in whatever case."""
    wanted = word.replace("_", "").casefold()
    return [one for one in ALL if wanted in (str(int(one.code)), one.name.casefold())]


def text(found: Iterable[Explained]) -> str:
    """For a terminal."""
    return "\n\n".join(
        f"{one.kind} {int(one.code)} {one.name}: {one.advice.meaning}\n"
        f"  do       {one.advice.remedy}\n"
        f"  example  {one.advice.example}"
        for one in found
    )


def tables() -> str:
    """For a page: a table of each kind."""
    lines: list[str] = []
    for kind, _ in _KINDS:
        lines += [f"## {kind}", "", "| code | name | meaning | what to do | example |",
                  "|---|---|---|---|---|"]  # fmt: skip
        lines += [
            f"| {int(one.code)} | `{one.name}` | {' | '.join(one.advice)} |"
            for one in ALL if one.kind == kind
        ]  # fmt: skip
        lines.append("")
    return "\n".join(lines).rstrip("\n")
