"""Tables of the groups of `scenarios_family`: slides of a wheel, and motors off the data sheet.

`slide`: wheels that run away or lock, which a drive's own slip limiter otherwise hides from a
detector. In all other families a fast slip limiter holds a slide at 5 % creep.

`mismatch`: one motor or its sensors are off the data sheet, and there is a loss. All families draw
the same runs from the same seeds: they differ in the mismatch alone. Drive 1 is off, any drive
loses adhesion.

May know: scenarios. May not know: any detector.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np

from gateway.study.scenarios_random import PerUnit, between, sign

Table = dict[str, Any]
Rng = np.random.Generator

SLIP_LENGTH_S: Final = (1.0, 3.0)
PULL_NM: Final = (8.0, 20.0)
BRAKE_NM: Final = (9.0, 18.0)
"""At every speed drawn, dry rail carries more than these two, and than the driver's limit."""
EFFORT_NM: Final = 24.0
GRADIENT_NM: Final = 8.0
"""Load from a gradient before and after the train brakes: large enough to be judged."""
RAIL_LEFT: Final = (0.2, 0.6)
"""Largest share of the brake's torque that a poor rail carries, up to 5 % creep at low speed."""
FRICTION_PER_NM: Final = 0.3 / 20.0
"""Friction coefficient that carries 1 Nm on the bench: wet rail has 0.3 and carries 20 Nm."""

OFF: Final = 0.2
OFFSET_A: Final = 0.5
"""A fiftieth of the bench motor's rated current."""
GAIN: Final = 0.05
OPEN_AT_S: Final = 1.0


def _speed(rng: Rng, unit: PerUnit) -> float:
    """Draw a speed of either sign, electrical rad/s, with voltage left for a runaway wheel."""
    low, high = unit.speed
    return between(rng, (low + 0.5 * (high - low), low + 0.7 * (high - low)), 3) * sign(rng)


def slipping(rng: Rng, unit: PerUnit, limiter: str, loss: Table) -> Table:
    """One slipping wheel, which its drive's slip limiter holds late or never.

    Half of the losses grow slowly. The train pulls or brakes. `loss`: an event of kind
    `adhesion_loss`.
    """
    if rng.random() < 0.5:
        loss["ramp_s"] = between(rng, (0.3 * loss["for_s"], 0.5 * loss["for_s"]))
    pull = between(rng, PULL_NM) * sign(rng)
    return {
        "slip_limiter": limiter,
        "event": [loss],
        "motion": {"speed": _speed(rng, unit), "effort_nm": unit.nm(EFFORT_NM)},
        "load": {"kind": "rail", "torque_nm": unit.nm(pull)},
    }


def braked(rng: Rng, unit: PerUnit) -> Table:
    """Friction brakes act on all wheels while the motors coast; one wheel meets a poor rail.

    The motors cannot observe the rail's load here, because the brakes take it up.
    """
    brake = between(rng, BRAKE_NM)
    at, length = between(rng, (1.0, 2.0)), between(rng, (0.8, 1.5))
    poor = {
        "at_s": round(at + 0.1, 4), "for_s": round(length - 0.2, 4), "kind": "rail",
        "drive": int(rng.integers(1, 4)),
        "value": round(FRICTION_PER_NM * between(rng, RAIL_LEFT) * brake, 4),
    }  # fmt: skip
    brakes = {"at_s": at, "for_s": length, "kind": "friction_brake", "ramp_s": 0.3}
    speed = _speed(rng, unit)
    return {
        "event": [{**brakes, "value": unit.nm(brake)}, poor],
        "motion": {"speed": speed, "effort_nm": unit.nm(EFFORT_NM)},
        "load": {"kind": "rail", "torque_nm": unit.nm(math.copysign(GRADIENT_NM, speed))},
    }


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
