"""Torque controllers of the slip-protection bench."""

from __future__ import annotations

from typing import Final

import numpy as np

from dbc.arrays import Array
from gateway.hil.slip_plant import Controller, Seen
from gateway.hil.slip_rails import AXLES

STEP_S: Final = 0.01


def creep_of(seen: Seen) -> Array:
    """(N,) creep as a controller sees it; NaN for an axle without a speed."""
    out: Array = (seen.train_m_s - seen.wheel_m_s) / seen.train_m_s
    return out


def none(_seen: Seen) -> Array:
    """No slip protection."""
    return np.ones(AXLES)


def oracle(seen: Seen) -> Array:
    """Ideal: knows the rail, demands its peak torque and holds the creep just below the peak."""
    before = (ORACLE_CREEP * seen.peak_creep - creep_of(seen)) * seen.train_m_s
    wanted = seen.peak_nm + HOLD_NM_S * before
    return np.nan_to_num(np.clip(wanted / seen.asked_nm, 0.0, 1.0))


ORACLE_CREEP: Final = 0.85
HOLD_NM_S: Final = 2000.0
"""Nm per m/s: a quarter of the gain that would remove the speed error in one step of 10 ms."""


class CreepControl:
    """A good conventional controller: above a creep it reduces torque, then restores it slowly."""

    def __init__(
        self, creep: float = 0.05, cut: float = 8.0, back: float = 0.6, late: int = 0
    ) -> None:
        """creep: limit; cut: 1/s per m/s above it; back: 1/s; late: delay, steps of 10 ms."""
        self._creep, self._cut, self._back = creep, cut, back
        self._limit = np.ones(AXLES)
        self._past = [np.zeros(AXLES)] * (late + 1)

    def __call__(self, seen: Seen) -> Array:
        """One step."""
        beyond = (creep_of(seen) - self._creep) * seen.train_m_s
        self._past = [*self._past[1:], np.nan_to_num(beyond)]
        now = self._past[0]
        change = np.where(now > 0.0, -self._cut * now, self._back)
        self._limit = np.clip(self._limit + STEP_S * change, 0.0, 1.0)
        return self._limit


def late(seed: int) -> Controller:
    """A bad controller: a high creep limit, and a delay of a quarter to half a second."""
    rng = np.random.default_rng([seed, 1])
    return CreepControl(float(rng.uniform(0.2, 0.4)), float(rng.uniform(1.0, 4.0)),
                        float(rng.uniform(1.0, 3.0)), int(rng.integers(25, 50)))  # fmt: skip


class Timid:
    """A bad controller: a small creep of one axle releases all brakes, for a long time."""

    def __init__(self, seed: int) -> None:
        """Draw creep, level and time by seed."""
        rng = np.random.default_rng([seed, 2])
        self._creep, self._hold_s = float(rng.uniform(0.01, 0.02)), float(rng.uniform(0.5, 1.5))
        self._level = float(rng.uniform(0.3, 0.5))
        self._until_s = 0.0

    def __call__(self, seen: Seen) -> Array:
        """One step."""
        if (np.nan_to_num(creep_of(seen)) > self._creep).any():
            self._until_s = seen.t_s + self._hold_s
        return np.full(AXLES, self._level if seen.t_s < self._until_s else 1.0)


LOST: Final = 2
CUT: Final = 0.6
"""Factor on the limit at once when adhesion is lost."""
FALL: Final = 4.0
FLOOR: Final = 0.2
"""Then the limit falls at the rate `FALL`, 1/s, relative, down to `FLOOR`: with less load the flag
could not show that the wheel grips again."""
FASTER_M_S2: Final = 0.5
"""A wheel that accelerates more than this while braking is regaining its grip."""
LONGEST_S: Final = 1.0
"""A cut ends after this time without acceleration of the wheel."""
BACK: Final = 0.93
RETURN: Final = 10.0
"""After a cut the limit returns to the level `BACK` times the limit at the loss; the difference
shrinks at the rate `RETURN`, 1/s."""
FEEL: Final = 0.03
CALM_S: Final = 0.8
QUICKER: Final = 0.3
"""The level rises at `FEEL`, 1/s; from `CALM_S` after a cut, this rate grows by `QUICKER`, 1/s2."""
AGAIN_S: Final = 0.5
"""Shortest time from a cut to the next: the gateway gets the limit every 100 ms only (`Status`)."""


class FlagLaw:
    """How a drive acts on its flag and its own speed: cut, let the wheel catch up, return.

    Tuned on the library's tracks only, not on seeded ones.
    """

    def __init__(self) -> None:
        self._limit, self._level = np.ones(AXLES), np.ones(AXLES)
        self._cut_s, self._calm_s = np.full(AXLES, np.inf), np.zeros(AXLES)
        self._sped_up = np.zeros(AXLES, np.bool_)
        self._wheel: Array | None = None

    def __call__(self, seen: Seen) -> Array:
        """One step."""
        before = seen.wheel_m_s if self._wheel is None else self._wheel
        faster = seen.wheel_m_s - before > FASTER_M_S2 * STEP_S
        self._wheel = seen.wheel_m_s.copy()
        lost = seen.flag == LOST
        cutting = self._cut_s < LONGEST_S
        begins = lost & ~cutting & (self._calm_s >= AGAIN_S)
        self._sped_up = ~begins & cutting & (self._sped_up | faster)
        cutting = begins | (cutting & ~(self._sped_up & ~faster))
        self._cut_s = np.where(begins, 0.0, np.where(cutting, self._cut_s + STEP_S, np.inf))
        self._cut_s = np.where(cutting & faster, 0.0, self._cut_s)
        self._calm_s = np.where(cutting, 0.0, self._calm_s + STEP_S)
        self._level = np.where(begins, BACK * self._limit, self._level)
        feel = FEEL + QUICKER * np.maximum(self._calm_s - CALM_S, 0.0)
        self._level = np.minimum(self._level + STEP_S * feel * ~cutting, 1.0)
        down = np.where(begins, CUT, 1.0 - STEP_S * FALL * ~faster) * self._limit
        up = self._limit + STEP_S * RETURN * np.maximum(self._level - self._limit, 0.0)
        self._limit = np.where(cutting, np.maximum(down, np.minimum(FLOOR, self._limit)), up)
        return self._limit.copy()
