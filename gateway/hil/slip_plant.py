"""A train that brakes on a bench track: the simulator's plant under a torque controller.

The mechanics are the plant's. Every 10 ms the rail under each wheel is set, the controller is
called, and the values to be scored are recorded.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.arrays import Array
from gateway.hil.slip_rails import AXLE_M, AXLES, Track
from sim.physics.adhesion import SPEED_FLOOR_M_S, Rail, traction_coefficient
from sim.physics.plant import (
    DT,
    LOAD,
    SPEED,
    TRACTION_350KW,
    Plant,
    SlipLimiter,
    Train,
    parameters,
    rail_array,
    set_slip_limiter,
)

Flags = NDArray[np.int64]

MOTOR: Final = "traction_350kw"
TRAIN: Final = Train(wheel_radius_m=0.43 / 3.036, mass_kg=151.0)
"""4 t on each axle (151 kg x 796 Nm / 30 Nm), all of it braked: the rotating mass is 14 % of it."""
ROTORS: Final = 1.0 + TRACTION_350KW.J / TRAIN.inertia(TRACTION_350KW)
"""Torque of the motors relative to that at the rail: the rest slows the rotors."""
START_M_S: Final = 15.0
STOP_M_S: Final = 2.0
"""End of the run: below this speed slip protection is off, as on a train."""
LEAD_IN_S: Final = 1.0
"""Time of reduced brake demand at the start, not scored, in which the drives are acquired."""
LEAD_IN: Final = 0.35
"""Share of the demand meanwhile: enough load to compare the drives, less than leaves carry."""
RISE_S: Final = 0.3
CLEANED: Final = 0.06
"""Gain in friction from each axle to the next, whose rail the axle before has cleaned."""
STEP: Final = 80
"""Periods of 125 us from one decision to the next."""
STANDS: Final = SlipLimiter(0.95, 200.0, 30.0)
"""Limiter that lets an inverter brake a wheel to a stop but not turn it backwards."""
LOCKED: Final = 0.9
"""Creep above which a wheel counts as locked."""
BACKWARD: Final = -1e4
"""rad/s2, slope of the driver's reference speed: full application of the brake."""
_CREEP: Final = np.linspace(0.0, 0.5, 251)


class Seen(NamedTuple):
    """Input of a controller every 10 ms. Arrays (N,); NaN in wheel_m_s and given_nm: cut out.

    train_m_s: speed of an unbraked axle; wheel_m_s: rim speeds; asked_nm: brake torque demanded of
    each axle at the rail; given_nm: the part of it now applied; flag: that of the device under
    test, 1 adhering, 2 lost, 0 unknown or no device. peak_nm and peak_creep are ground truth, for
    an oracle.
    """

    t_s: float
    train_m_s: float
    wheel_m_s: Array
    asked_nm: float
    given_nm: Array
    flag: Flags
    peak_nm: Array
    peak_creep: Array


Controller = Callable[[Seen], Array]
"""Returns (N,) shares 0..1 of the torque demanded; called every 10 ms from the start of a run."""


class Moment(NamedTuple):
    """10 ms of a run. Torques of the wheel's rim on the rail, Nm, braking positive; arrays (N,).

    limit: the controller's output, 0..1; peak_creep: creep at which the rail carries most.
    """

    t_s: float
    way_m: float
    train_m_s: float
    wheel_m_s: Array
    asked_nm: float
    load_nm: Array
    peak_nm: Array
    peak_creep: Array
    limit: Array
    flag: Flags


class BrakingTrain(Plant):
    """The plant of one track under one controller; `moments` is the run so far."""

    def __init__(
        self, track: Track, controller: Controller, flags: Callable[[], Flags] | None = None
    ) -> None:
        """Start at `START_M_S`. flags: returns those of a device under test, (N,)."""
        p = parameters(TRACTION_350KW, AXLES)
        p.wheel = np.array(track.wheel)
        set_slip_limiter(p, STANDS)
        angles = 1.3 * np.arange(AXLES, dtype=np.float64)
        w_0 = START_M_S / TRAIN.wheel_radius_m
        super().__init__(
            TRACTION_350KW, angles, on_rail=True, w_0=w_0, load_0=0.0, train=TRAIN, p=p
        )
        # One step is fine enough above STOP_M_S: the contact's time constant is at least 60 us.
        self.state.steps = 1
        self.state.cut_per_s = self.state.restore_per_s = 0.0
        self.track, self.moments = track, list[Moment]()
        self._controller, self._flags = controller, flags or (lambda: np.zeros(AXLES, int))
        self._t_s = self._way_m = 0.0
        self._film = np.ones(AXLES)  # share of the film left under each axle
        self.rails: list[Rail] = []

    @property
    def stopped(self) -> bool:
        """Whether the run has ended."""
        return self.v_m_s <= STOP_M_S

    def advance(self, w_ref: Array, *_others: object) -> Array:
        """See `Plant.advance`; of the arguments only the number of periods matters.

        The controller decides in calls that begin at a multiple of 10 ms.
        """
        count = len(w_ref)
        if round(self._t_s / DT) % STEP == 0:
            self._decide()
        ones = np.ones((count, AXLES))
        rails = np.repeat(rail_array(self.rails)[None], count, axis=0)
        out = super().advance(0.0 * w_ref, np.full(count, BACKWARD), 0.0 * w_ref, ones,
                              np.zeros_like(ones, bool), rails)  # fmt: skip
        self._t_s += count * DT
        self._way_m += count * DT * self.v_m_s
        self._note(out)
        return out

    def run(self, most_s: float = 60.0) -> list[Moment]:
        """Run without a bus to the end, or for `most_s`."""
        blank, none = np.zeros(STEP), np.zeros((STEP, AXLES), bool)
        while not self.stopped and self._t_s < most_s:
            self.advance(blank, blank, blank, none, none)
        return self.moments

    def slips(self, drive: int, _condition: Rail) -> bool:
        """See `Plant.slips`, on the track's rail."""
        return super().slips(drive, self.rails[drive])

    def _decide(self) -> None:
        """Set the rails, the brake demand and each axle's share of it; record the moment."""
        self.rails = [self._rail(k) for k in range(AXLES)]
        peak, creep = self._peaks()
        full = self.track.asked * self.wheel_load_nm
        if self.track.of_peak is not None:
            full = self.track.of_peak * float(peak.min())
        asked = full * float(np.clip(LEAD_IN + (self._t_s - LEAD_IN_S) / RISE_S, LEAD_IN, 1.0))
        wheel = self.drives.w_m * self.p.wheel * self.train.wheel_radius_m
        torque, flag = asked * self.drives.limiter, self._flags()
        seen = Seen(self._t_s, self.v_m_s, wheel.copy(), asked, torque, flag, peak, creep)
        out = self.track.cut_out
        if out >= 0:
            for column in (seen.wheel_m_s, seen.given_nm):
                column[out] = np.nan
        limit: Array = np.clip(self._controller(seen), 0.0, 1.0)
        self.drives.limiter = limit
        if out >= 0:
            self.drives.limiter[out] = limit[out] = 0.0
        if self.track.stuck >= 0:
            self.drives.limiter[self.track.stuck] = 1.0
        self.p.effort_nm = asked * ROTORS
        self.moments.append(Moment(self._t_s, self._way_m, self.v_m_s, wheel, asked,
                                   np.zeros(AXLES), peak, creep, limit, flag))  # fmt: skip

    def _rail(self, axle: int) -> Rail:
        """Rail under an axle, cleaned by the axles before, and its film worn by them and itself."""
        rail = self.track.rail_at(self._way_m - axle * AXLE_M)
        better = 1.0 + CLEANED * axle + 1.0 - float(self._film[: axle + 1].prod())
        return rail._replace(mu_0=rail.mu_0 * better)

    def _peaks(self) -> tuple[Array, Array]:
        """(N,) torque, Nm, that the rail carries at the best creep up to 0.5, and that creep."""
        at = {rail: traction_coefficient(rail, _CREEP, self.v_m_s) for rail in set(self.rails)}
        best = [(float(at[r].max()), float(_CREEP[at[r].argmax()])) for r in self.rails]
        most, creep = np.array(best).T
        return self.wheel_load_nm * most, creep

    def _note(self, out: Array) -> None:
        """Add the mean load of the simulated periods to the moment; wear the film."""
        moment = self.moments[-1]
        share = len(out) / STEP
        moment.load_nm[:] -= share * out[:, :, LOAD].mean(axis=0)
        if self.track.film_j is not None:
            radius = self.train.wheel_radius_m
            slide = np.abs(out[-1, :, SPEED] * self.p.wheel * radius - self.v_m_s)
            grip = np.abs(out[-1, :, LOAD]) / self.wheel_load_nm * self.train.gravity
            work = grip * slide * len(out) * DT
            self._film *= np.exp(-work / self.track.film_j)


def creep_of(moment: Moment) -> Array:
    """(N,) creep, braking positive: 0 for a rolling wheel, 1 for a locked one."""
    out: Array = (moment.train_m_s - moment.wheel_m_s) / max(moment.train_m_s, SPEED_FLOOR_M_S)
    return out
