"""Runs with one motor or its sensors off the data sheet, and a loss: effect of a mismatch.

All families here draw the same runs from the same seeds: they differ in the mismatch alone.
Drive 1 is off, any drive loses adhesion. `scenarios_family` has them as the group `mismatch`.

May know: scenarios. May not know: any detector.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

Table = dict[str, Any]

OFF: Final = 0.2
OFFSET_A: Final = 0.5
"""A fiftieth of the bench motor's rated current."""
GAIN: Final = 0.05
OPEN_AT_S: Final = 1.0


class Mismatch(NamedTuple):
    """One mismatch: factor on a motor value of drive 1, errors that `sensors` draws, or open phase.

    offset_a: for a motor of 25 A; it scales with the rated current.
    """

    title: str
    motor: str = ""
    factor: float = 1.0
    offset_a: float = 0.0
    gain: float = 0.0
    phase_open: bool = False


MISMATCHES: Final[dict[str, Mismatch]] = {
    "off_nothing": Mismatch("nothing is off"),
    "off_R_s_up": Mismatch("R_s 20 % high", "R_s", 1.0 + OFF),
    "off_R_s_down": Mismatch("R_s 20 % low", "R_s", 1.0 - OFF),
    "off_L_s_up": Mismatch("L_s 20 % high", "L_s", 1.0 + OFF),
    "off_L_s_down": Mismatch("L_s 20 % low", "L_s", 1.0 - OFF),
    "off_psi_up": Mismatch("psi_pm 20 % high", "psi_pm", 1.0 + OFF),
    "off_psi_down": Mismatch("psi_pm 20 % low", "psi_pm", 1.0 - OFF),
    "off_offset": Mismatch("current offsets of up to 0.5 A", offset_a=OFFSET_A),
    "off_gain": Mismatch("current gains up to 5 % off", gain=GAIN),
    "off_phase_open": Mismatch("phase a of drive 1 open", phase_open=True),
}


def tables(off: Mismatch, amps: float) -> tuple[Table, Table, list[Table]]:
    """Tables of a scenario: mismatch, more of sensors, more events; amps: rated current / 25 A."""
    motor = {off.motor: [off.factor, 1.0, 1.0]} if off.motor else {}
    sensors = {
        "current_offset_within_a": off.offset_a * amps,
        "current_gain_within": off.gain,
    }
    event = {"at_s": OPEN_AT_S, "drive": 1, "kind": "phase_open"}
    return motor, sensors, [event] if off.phase_open else []
