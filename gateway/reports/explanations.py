"""Every code of a flag frame: its meaning, its cause and its remedy."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import IntEnum
from typing import Any, Final, NamedTuple

from gateway.core.codes import FaultClass, Health, Reason
from gateway.reports.record import camel
from gateway.reports.words import REASONS


class Explained(NamedTuple):
    """One code. kind: name of its signal; remedy: what to check or do; example: possible cause."""

    kind: str
    code: IntEnum
    meaning: str
    remedy: str
    example: str

    @property
    def name(self) -> str:
        """Name of the code in the DBC's value table."""
        return camel(self.code.name)


_REASONS: Final = {
    Reason.NONE: ("nothing", "all drives run, and all their messages arrive"),
    Reason.STARTING: (
        "wait; if it lasts after a second of driving, look at `Health` and the motor's parameters",
        "the first 0.2 s after the start; a train at standstill without `Motion`",
    ),
    Reason.STALE: (
        "check that the drive is powered and on this bus: `candump` shows its identifiers",
        "the drive's CAN connector is off; its messages come ten times slower than the DBC says",
    ),
    Reason.CORRUPTED: (
        "check termination, shield, bit rate; if a drive sends no checksum, map it without E2E",
        "a bus with one terminator; a drive that computes another CRC",
    ),
    Reason.SEQUENCE: (
        "look for a second sender of these identifiers, and for an overloaded bus",
        "two drives with one node number; a bus load above 90 %",
    ),
    Reason.RANGE: (
        "compare units, signs, phase order, pole pairs and flux with the motor's sheet",
        "currents in A/10 that are read as A; phases swapped; a wheel 10 % faster than the others",
    ),
    Reason.NOT_AVAILABLE: (
        "let the drive send the signal, or do not map it; check that the drive is in operation",
        "`TorqueCommand` is 0x7FFF; `State` is Off",
    ),
    Reason.DIVERGED: (
        "if it recurs, check flux and inductance, then the other parameters; look for late samples",
        "the configured flux is half of the true one",
    ),
    Reason.TOO_FEW_DRIVES: (
        "run with more than a tenth of rated torque; let the drives send `TorqueCommand`",
        "the train coasts and slows down; one of two drives is silent",
    ),
    Reason.OVERRUN: (
        "use `run --realtime` and a dedicated processor; `check` prints the timing budget",
        "another program loads the gateway's processor",
    ),
    Reason.INTRUDER: (
        "find the node: a second gateway, a tester that replays a log; see `docs/threats.md`",
        "a log that contains the gateway's frames is played onto the bus",
    ),
    Reason.CONFIG: (
        "adhesion: `traction-gateway check` names the signals that the drive lacks; thermal: "
        "`traction-gateway calibrate` makes limits from fault-free logs, with method `maisd` of "
        "two drives or more",
        "an inverter that sends no phase currents or voltages; a thermal flag without `[thermal] "
        "calibration`; a motor whose thermal model did not hold on held-back logs, or that turns "
        "without current",
    ),
}
"""Remedy and example; the meanings are `REASONS`."""
_HEALTH: Final = {
    Health.UNKNOWN: (
        "no estimate for this drive",
        "see the reason of its flag",
        "no currents have been received yet",
    ),
    Health.CONVERGING: (
        "the estimator has started and has not settled",
        "wait, and let the rotor turn: at standstill its angle is not observable",
        "the first tenth of a second after a start",
    ),
    Health.TRACKING: ("speed and load are estimated from fresh samples", "nothing", "driving"),
    Health.PREDICTING: (
        "no fresh sample: the last estimate is extrapolated for a short time",
        "look for lost frames",
        "20 ms without currents",
    ),
    Health.DIVERGED: (
        "estimate and measurement contradict each other: the estimator restarts",
        "check the motor's parameters; look for late or swapped samples",
        "the configured resistance is a tenth of the true one",
    ),
    Health.INPUT_INVALID: (
        "the inputs cannot be used: corrupt, out of range, or implausible",
        "see the reason of its flag, and `RejectedFrames`",
        "an inverter that hangs and repeats its last phase currents",
    ),
}
_FAULTS: Final = {
    FaultClass.UNKNOWN: (
        "not known; if a flag is raised, the cause is heat or a sensor",
        "`calibrate`; look at the motor and at its sensors",
        "no calibration; too few temperatures",
    ),
    FaultClass.NONE: ("no fault", "nothing", "temperatures as the model expects them"),
    FaultClass.OVERHEATING: (
        "the winding is hotter than its losses explain",
        "cut the torque; look at the winding and its insulation",
        "a short circuit between turns",
    ),
    FaultClass.COOLING_LOSS: (
        "heat does not leave the motor as it should",
        "check fan, filter and air duct",
        "a filter full of leaves",
    ),
    FaultClass.BEARING: (
        "friction heats one end of the motor",
        "check grease, bearing and alignment at the warmer end",
        "a bearing without grease",
    ),
    FaultClass.SENSOR_BIAS: (
        "a sensor reads too high or too low; the motor is not the cause",
        "replace or recalibrate the sensor that `FaultSensor` names",
        "contact resistance in the wiring of a PT100",
    ),
    FaultClass.SENSOR_STUCK: (
        "a sensor's value does not change while the others change",
        "check the sensor and its converter",
        "a converter that repeats its last value",
    ),
    FaultClass.SENSOR_LOST: (
        "a sensor has no value",
        "check its wiring and connector",
        "an open PT100",
    ),
    FaultClass.WINDING_RESISTANCE: (
        "the winding's resistance does not fit its temperature",
        "check joints and terminals of the phases",
        "a loose cable lug",
    ),
}
_KINDS: Final[tuple[tuple[str, Mapping[Any, tuple[str, str, str]]], ...]] = (
    ("Reason", {
        code: (REASONS.get(code, "no flag is `Unknown`"), *rest) for code, rest in _REASONS.items()
    }),
    ("Health", _HEALTH), ("FaultClass", _FAULTS),
)  # fmt: skip
ALL: Final = tuple(
    Explained(kind, code, *advice) for kind, codes in _KINDS for code, advice in codes.items()
)
"""All codes, by kind, then by number."""


def named(word: str) -> list[Explained]:
    """Codes with this number or name; upper and lower case are equal."""
    wanted = word.replace("_", "").casefold()
    return [one for one in ALL if wanted in (str(int(one.code)), one.name.casefold())]


def text(found: Iterable[Explained]) -> str:
    """The explanations as text for a terminal."""
    return "\n\n".join(
        f"{one.kind} {int(one.code)} {one.name}: {one.meaning}\n"
        f"  do       {one.remedy}\n"
        f"  example  {one.example}"
        for one in found
    )
