"""The ground truth of a run: the rows of the truth file."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

COLUMNS: Final = (
    "t_s", "drive", "speed_rad_s", "angle_rad", "load_nm", "lost", "fault_class", "true_effect_k",
    "cut", "creep", "train_speed_m_s",
)  # fmt: skip
"""Columns of the truth file."""
GIVEN: Final = 0.95
"""A drive that delivers a smaller share of the demanded torque cuts its torque."""


class Truth(NamedTuple):
    """One drive at one instant, every 10 ms.

    `drive` is the node number, `speed_rad_s` the rotor's (mechanical), `angle_rad` electrical in
    [0, 2 pi), `load_nm` the torque on the rail (the motor's load is this and the friction brake's
    torque), `fault_class` the contract's number (1 none).

    `lost`: the adhesion at hand is below what is asked of the wheel: the train's demand and the
    friction brake. That is: an adhesion loss is active with depth > 0, or the rail cannot carry
    what is asked within the creep that the drive's slip limiter allows (fast 5 %, slow 15 %, none:
    the peak of the creep curve), or the wheel slides by more than 5 % and beyond that peak. The
    demand is the one before the drive's limiter: a drive that was cut and grips again stays `lost`
    until the rail is back.

    `true_effect_k`: what the fault changes at the drive's temperature readings, the largest of the
    four, noise aside: against a fault-free twin of the motor under the same currents, sensor bias
    and the error of a stuck value included; 0 for a lost sensor.

    `depth`: while `lost`, the share of what is asked that does not reach the rail, 0..1; else 0.
    Not in the truth file.

    `given`: the share of the demanded torque that the motor delivers, 0..1: below 1 where the
    drive's own slip limiter, or the gateway's flag, cuts its torque. 1 under a preset load. Not in
    the truth file, which has `cut`: 1 where it is less than 0.95.

    `creep`: (wheel - train) / train speed, signed; `train_speed_m_s`. NaN under a preset load,
    which has no train; empty in the truth file.
    """

    t_s: float
    drive: int
    speed_rad_s: float
    angle_rad: float
    load_nm: float
    lost: int
    fault_class: int
    true_effect_k: float
    depth: float = 0.0
    given: float = 1.0
    creep: float = math.nan
    train_speed_m_s: float = math.nan

    @property
    def cut(self) -> int:
        """1 where the drive, or the gateway's flag, cuts its torque."""
        return int(self.given < GIVEN)

    def text(self) -> tuple[str, ...]:
        """Cells of the truth file."""
        train = (self.creep, self.train_speed_m_s)
        return (
            f"{self.t_s:.3f}", str(self.drive), f"{self.speed_rad_s:.5f}",
            f"{self.angle_rad:.5f}", f"{self.load_nm:.4f}", str(self.lost), str(self.fault_class),
            f"{self.true_effect_k:.4f}", str(self.cut),
            *("" if math.isnan(value) else f"{value:.5f}" for value in train),
        )  # fmt: skip
