"""The drives' own speed and torque: load by observer, where the currents come too slowly.

Ten samples per electrical revolution are about the least that the filters need. Beyond that the
load comes from the observer, without a bump; without fresh `Motion` it is unknown. May know:
estimators, readings. May not know: frames, clocks, flags.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

from dbc.frame import SECOND, Nanos
from estimators.observer import LoadState, Mechanics, first, observe
from gateway.bank import DriveEstimate
from gateway.config import Estimator, Motor
from gateway.health import Health, Reason
from gateway.inbox import Motion

FEWEST_SAMPLES: Final = 10.0
"""Per electrical revolution."""
HYSTERESIS: Final = 0.05
SETTLED_READINGS: Final = 5
MOST_MISSING: Final = 5
"""Periods without a reading after which the observer starts anew."""
HAND_OVER_S: Final = 0.5
"""Time constant with which the difference between two sources fades."""
SPEED_FLOOR_VAR: Final = 1e-8
"""(rad/s)^2: a DBC may carry speed as a float."""
FADED_NM: Final = 1e-3
SUB_STEP_S: Final = 125e-6
"""What the configured process noise is stated for."""


class Timebase(NamedTuple):
    """When readings come.

    sample_s: spacing of the current samples; period_ns, speed_step: cycle and resolution of
    `Motion` (rad/s at the rotor).
    """

    sample_s: float
    period_ns: Nanos
    speed_step: float


class _Drive:
    """Memory of one drive."""

    __slots__ = (
        "beyond",
        "last_ns",
        "load",
        "mechanics",
        "observed",
        "offset",
        "readings",
        "state",
    )

    def __init__(self, mechanics: Mechanics) -> None:
        self.mechanics = mechanics
        self.state: LoadState | None = None
        self.last_ns: Nanos = 0
        self.readings = 0
        self.beyond = False
        self.load: float | None = None
        """What was given in the tick before; None if it was unknown."""
        self.observed = False
        self.offset = 0.0


class MotionSide:
    """Observers of N drives; `take` and then `merge`, once per tick."""

    def __init__(
        self,
        motors: Sequence[Motor],
        config: Estimator,
        times: Timebase,
        tick_ns: Nanos,
    ) -> None:
        """Noise is that of the configuration, per unit of each motor's rated torque."""
        self._period_ns = times.period_ns
        self._limit_w_e = 2.0 * math.pi / (FEWEST_SAMPLES * times.sample_s)
        self._fade = math.exp(-tick_ns / SECOND / HAND_OVER_S)
        self._pole_pairs = [m.pole_pairs for m in motors]
        self._any_beyond = False
        self._drives = [
            _Drive(
                Mechanics(
                    m.J,
                    m.B,
                    # A real encoder adds about as much again as rounding does.
                    2.0 * times.speed_step**2 / 12.0 + SPEED_FLOOR_VAR,
                    config.process_noise[4] * (m.T_rated / 30.0) ** 2 / SUB_STEP_S,
                )
            )
            for m in motors
        ]

    def take(self, readings: Sequence[Motion], flux: Callable[[int], float]) -> None:
        """Readings of one tick, in order of time.

        flux: of a drive, its magnets' over that of the data sheet, from which the drive computes
        the torque that it sends.
        """
        for k, t_ns, speed, sent in readings:
            drive = self._drives[k]
            torque = sent * flux(k)
            # The cycle is exact, stamps jitter.
            cycles = round((t_ns - drive.last_ns) / self._period_ns)
            drive.last_ns = t_ns
            if drive.state is None or cycles > MOST_MISSING:
                drive.state = first(speed, torque, drive.mechanics)
                drive.readings = 0
            elif cycles > 0:
                dt = cycles * self._period_ns / SECOND
                drive.state = observe(drive.state, speed, torque, dt, drive.mechanics)
                drive.readings += 1

    def beyond(self, k: int) -> bool:
        """Whether a drive turns too fast for its current samples."""
        return self._drives[k].beyond

    def note_speeds(
        self, estimates: Sequence[DriveEstimate], measured: Sequence[float | None]
    ) -> None:
        """Which drives turn too fast; once per tick, before `merge`."""
        each = zip(self._drives, self._pole_pairs, estimates, measured, strict=True)
        for drive, pole_pairs, estimate, measured_w in each:
            w = measured_w if measured_w is not None else (estimate.speed_rad_s or 0.0)
            limit = self._limit_w_e * (1.0 - HYSTERESIS if drive.beyond else 1.0)
            drive.beyond = abs(pole_pairs * w) > limit
        self._any_beyond = any(drive.beyond for drive in self._drives)

    def merge(self, k: int, estimate: DriveEstimate, measured_w: float | None) -> DriveEstimate:
        """The estimate to use this tick.

        measured_w: rotor speed of fresh `Motion`, None without. Drives are compared, and filter
        and observer follow a load step at different speeds: where one drive needs the observer,
        all that can use it. A drive whose input cannot be believed stays what it is.
        """
        drive = self._drives[k]
        if estimate.health is Health.INPUT_INVALID:
            drive.load = None
            return estimate
        ready = measured_w is not None and drive.readings >= SETTLED_READINGS
        observed = drive.beyond or (self._any_beyond and ready)
        if observed:
            estimate = self._observed(drive, measured_w is not None)
        if estimate.load_nm is None or estimate.health is not Health.TRACKING:
            drive.load = None
            return estimate
        return self._faded(drive, estimate, observed)

    def _observed(self, drive: _Drive, fresh: bool) -> DriveEstimate:
        state = drive.state
        if state is None or not fresh:
            return DriveEstimate(Health.UNKNOWN, reason=Reason.NOT_AVAILABLE)
        if drive.readings < SETTLED_READINGS:
            return DriveEstimate(Health.CONVERGING)
        return DriveEstimate(Health.TRACKING, state.w, state.T_L, math.sqrt(state.P_LL), state.nis)

    def _faded(self, drive: _Drive, estimate: DriveEstimate, observed: bool) -> DriveEstimate:
        """No bump where the source changes: the difference fades."""
        load = estimate.load_nm or 0.0
        if drive.load is None:
            drive.offset = 0.0
        elif observed is not drive.observed:
            drive.offset = drive.load - load
        drive.observed = observed
        drive.offset *= self._fade if abs(drive.offset) > FADED_NM else 0.0
        drive.load = load + drive.offset
        if not drive.offset:
            return estimate
        return estimate._replace(load_nm=drive.load)
