"""The drives and the train: PMSM under field-oriented control, wheel on rail or preset load.

May know: mechanics and machines. May not know: bits, faults by name, sensors, clocks.

Two ways to load a drive:

- `rail`: the wheel rolls on a creep curve, the drives share the train's mass, a driver holds the
  speed profile with one torque demand for all;
- `preset`: the healthy load torque is given over time (as in section 5 of paper `adhesion`) and
  each drive is speed controlled.

In both, `carry` (1 = all) is the share of the train's demand that the rail can carry: the load is
then min(demanded, carry x train's demand), in either sign. A drive whose limiter is at 30 % and
whose rail still carries 40 % therefore grips again.

On the rail a friction brake may be applied to each wheel, beside the motor. What is then asked of
the rail is the train's demand and the brake's torque together.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.physics.adhesion import SPEED_FLOOR_M_S, Rail, available, peak_creep
from sim.records import DRIVE, MOTOR, Columns, ffi, lib, pointer, zeros
from sim.records import TRAIN as TRAIN_RECORD

Array = NDArray[np.float64]

OUT: Final[int] = lib.OUT_COLUMNS
I_ALPHA: Final[int] = lib.OUT_I_ALPHA
I_BETA: Final[int] = lib.OUT_I_BETA
U_ALPHA: Final[int] = lib.OUT_U_ALPHA
U_BETA: Final[int] = lib.OUT_U_BETA
U_DC: Final[int] = lib.OUT_U_DC
TORQUE: Final[int] = lib.OUT_TORQUE
SPEED: Final[int] = lib.OUT_SPEED
ANGLE: Final[int] = lib.OUT_ANGLE
LOAD: Final[int] = lib.OUT_LOAD
COMMAND: Final[int] = lib.OUT_COMMAND

DT: Final = 125e-6
"""Control period, s: voltages are constant over it."""
CREEP_LIMIT: Final = 0.05
"""Creep that a fast slip limiter allows; a wheel beyond it and beyond the curve's peak slides."""
CUT_PER_S: Final = 7.0
RESTORE_PER_S: Final = 0.7
"""How fast a drive's torque limiter falls, within 100 ms, and returns, over 1 s."""
RAIL_STEPS: Final = 4
"""Runge-Kutta steps per period on the rail: the contact's time constant goes down to 15 us."""
CUT_LEVEL: Final = 0.3
"""Level that a drive's torque limiter falls to while the gateway sends `AdhesionLost`."""


class SlipLimiter(NamedTuple):
    """A drive's own slip control: a PI control of the wheel's speed that limits the torque.

    `creep`: allowed creep, infinite for a drive without slip control. `bandwidth` rad/s: the torque
    is reduced by bandwidth x J x the speed beyond that creep; `rate` 1/s of the integrator.
    """

    creep: float
    bandwidth: float
    rate: float


SLIP_LIMITERS: Final[dict[str, SlipLimiter]] = {
    "fast": SlipLimiter(CREEP_LIMIT, 200.0, 30.0),
    "slow": SlipLimiter(0.15, 8.0, 8.0),
    "none": SlipLimiter(math.inf, 0.0, 0.0),
}
"""By the name in the scenario. "fast" holds the wheel within some milliseconds. "slow" is an older
drive that compares filtered axle speeds at long intervals: natural frequency sqrt(8 x 8) = 8 rad/s,
damping 0.5, so the wheel's excess over 15 % creep peaks after 0.15 s and is gone after 0.5 s, and
the torque, too, takes about a second to come back. "none": the wheel runs up until the voltage of
the dc link leaves the motor no torque beyond what the sliding wheel meets."""


@dataclass(frozen=True)
class Motor:
    """A motor with all that turns with it. SI units; T = k_p pole_pairs psi_pm i_q."""

    R_s: float
    L_s: float
    psi_pm: float
    pole_pairs: int
    J: float
    I_rated: float
    T_rated: float
    B: float = 0.0
    k_p: float = 1.5
    U_dc: float = 300.0


BENCH: Final = Motor(
    R_s=0.28, L_s=3.465e-3, psi_pm=0.1989, pole_pairs=4, J=0.04, I_rated=25.0, T_rated=30.0
)
"""The motor of paper `adhesion`; rated values and dc link are our choice."""
LARGE: Final = Motor(
    R_s=0.12, L_s=2.0e-3, psi_pm=0.40, pole_pairs=4, J=0.12, I_rated=50.0, T_rated=120.0,
    U_dc=560.0,
)  # fmt: skip
"""A larger drive; with it, tests check that no constant is tied to the bench motor."""
TRACTION_350KW: Final = Motor(
    R_s=0.08, L_s=3.02e-3, psi_pm=1.104, pole_pairs=2, J=11.0, I_rated=240.4, T_rated=796.0,
    U_dc=2600.0,
)  # fmt: skip
"""The traction motor of paper `thermal`, Table 1: 350 kW, 1443 V, 170 A, 140 Hz.

The paper's motor is an induction machine; this is a magnet machine with the same nameplate at
i_d = 0. Two pole pairs: 140 Hz is w_e = 879.6 rad/s and 4200 rpm, T = 350 kW / 439.8 rad/s =
796 Nm, I = sqrt(2) 170 A = 240.4 A, psi_pm = T / (1.5 p I) = 1.104 Wb. R_s: copper loss 1.5 R I^2
= 2 % of the power. L_s: what is left of the phase voltage sqrt(2/3) 1443 V = 1178 V, that is
u_d = w_e L I = 639 V beside u_q = w_e psi + R I = 990 V (0.54 per unit, power factor 0.84).
J: rotor 2 kg m2 and a wheelset of 84 kg m2 behind a gear of 3.036, as in a high-speed unit. The dc
link holds 1.5 x T_rated at 140 Hz: |u| = 1384 V needs sqrt(3) x that + 41 V = 2440 V.
"""
MOTORS: Final[dict[str, Motor]] = {
    "bench": BENCH, "large": LARGE, "traction_350kw": TRACTION_350KW,
}  # fmt: skip


@dataclass(frozen=True)
class Train:
    """The rig's train for a motor of T_rated 30 Nm (mass and wheel load scale with T_rated).

    All weight on driven wheels: wheel load x radius = m g r = 94 Nm, so rated torque uses a
    traction coefficient of 0.32: dry rail carries 42 Nm, wet 20 Nm, leaves 7 Nm at 5 % creep.
    With a gear, `wheel_radius_m` is the wheel's radius over the gear's ratio, so that a rotor
    speed times it is the train's.
    """

    wheel_radius_m: float = 0.2
    mass_kg: float = 48.0
    gravity: float = 9.81
    weight_kg: float | None = None
    """Mass that loads the driven wheels; None: all of it."""

    def wheel_load_nm(self, motor: Motor) -> float:
        """Wheel load times radius, Nm: the torque at traction coefficient 1."""
        weight = self.mass_kg if self.weight_kg is None else self.weight_kg
        return weight * self.gravity * self.wheel_radius_m * motor.T_rated / BENCH.T_rated

    def inertia(self, motor: Motor) -> float:
        """Train mass per drive seen at the rotor, kg m2."""
        return self.mass_kg * self.wheel_radius_m**2 * motor.T_rated / BENCH.T_rated


TRAIN: Final = Train()
TRAINS: Final[dict[str, Train]] = {
    "traction_350kw": Train(wheel_radius_m=0.43 / 3.036, mass_kg=942.0, weight_kg=67.8),
}
"""Trains by motor; others have `TRAIN`. A motor of 796 Nm: wheels of 0.86 m, gear 3.036 (62 m/s
at 140 Hz), 25 t of train per motor, 46 times the inertia that turns (bench: 48). The wheel load
is lighter than an axle's 14 t, so that rated torque uses a traction coefficient of 0.32 as on the
bench and the rail conditions mean the same for both; at speed the creep curves fall: at 60 m/s
dry rail carries 770 Nm, wet 430 Nm."""


def parameters(motor: Motor, drives: int) -> Columns:
    """(N,) `struct sim_motor`: all drives as in the data sheet.

    Their slip limiters are fast, their friction brakes released.
    """
    p = zeros(drives, MOTOR)
    for name in ("R_s", "L_s", "psi_pm", "pole_pairs", "J", "B", "k_p"):
        p[name] = getattr(motor, name)
    p.T_max = p.effort_nm = 1.5 * motor.T_rated
    p.cut_level, p.psi_pm_control = CUT_LEVEL, motor.psi_pm
    p.share = p.wheel = 1.0
    set_slip_limiter(p, SLIP_LIMITERS["fast"])
    return p


def set_slip_limiter(p: Columns, limiter: SlipLimiter) -> None:
    """Give this slip limiter to all drives."""
    p.creep_max, p.slip_bandwidth, p.slip_rate = limiter


class Plant:
    """N drives in full detail. `advance` moves them by whole control periods of 125 us."""

    def __init__(
        self, motor: Motor, theta_0: Array, *, on_rail: bool, w_0: float, load_0: float,
        train: Train = TRAIN, p: Columns | None = None,
    ) -> None:  # fmt: skip
        """Start rolling at `w_0` rad/s (rotor), angles `theta_0` (N,), torque for load `load_0` Nm.

        `p` (N,): the drives' own parameters, default all as `motor` (see `parameters`).
        """
        n = len(theta_0)
        self.motor, self.train, self.on_rail = motor, train, on_rail
        self.p = parameters(motor, n) if p is None else p
        """(N,) `struct sim_motor`; share, open phase and brake may change between two periods."""
        self.drives = zeros(n, DRIVE)
        self.drives.w_m = w_0 / self.p.wheel
        self.drives.theta_e = np.mod(theta_0, 2.0 * math.pi)
        self.drives.integral_nm = load_0 * self.p.share
        self.drives.limiter = 1.0
        e = self.p.psi_pm * motor.pole_pairs * self.drives.w_m
        self.drives.u_alpha = -e * np.sin(self.drives.theta_e)
        self.drives.u_beta = e * np.cos(self.drives.theta_e)
        self.wheel_load_nm = train.wheel_load_nm(motor)
        self.state = zeros(1, TRAIN_RECORD)
        """The train, `struct sim_train`."""
        self.state[0] = (
            DT, motor.U_dc, train.wheel_radius_m, self.wheel_load_nm, train.inertia(motor),
            SPEED_FLOOR_M_S, CUT_PER_S, RESTORE_PER_S, RAIL_STEPS if on_rail else 1, on_rail,
            w_0, load_0, load_0,
        )  # fmt: skip
        # Columns that are read number by number: from the records it takes ten times as long.
        self._share, self._brake = self.p["share"], self.p["brake_nm"]
        self._wheel, self._creep_max = self.p["wheel"], self.p["creep_max"]
        self._w_m = self.drives["w_m"]
        self._w_train, self._demand = self.state["w_m"], self.state["demand_nm"]

    @property
    def demand_nm(self) -> float:
        """The train's torque demand on each drive, before limiter and slip limit, Nm."""
        return float(self._demand[0])

    @property
    def w_train(self) -> float:
        """The train's speed, rad/s of a rotor with a nominal wheel that does not slide."""
        return float(self._w_train[0])

    @property
    def v_m_s(self) -> float:
        """The train's speed."""
        return self.w_train * self.train.wheel_radius_m

    def advance(
        self, w_ref: Array, w_acc: Array, load: Array, carry: Array, cut: NDArray[np.bool_],
        rails: Array,
    ) -> Array:  # fmt: skip
        """Advance n periods; returns (n, N, 10), columns OUT, at the end of each.

        `w_ref` (n,) rotor speed wanted rad/s, `w_acc` (n,) its slope rad/s2, `load` (n,) healthy
        load per drive Nm (rail: running resistance), `carry` (n, N) share of what is asked of the
        wheel, motor and friction brake together, that the rail can carry (1 = all), `cut` (n, N)
        limiter commanded down, `rails` (n, N, 6) curves in force. See sim/physics/plant.c.
        """
        numbers = [np.ascontiguousarray(x, float) for x in (w_ref, w_acc, load, carry, rails)]
        down = np.ascontiguousarray(cut, np.uint8)
        out = np.empty((*carry.shape, OUT))
        *columns, curves = (pointer("double", x) for x in numbers)
        schedule = ffi.new("struct sim_schedule *", [
            *carry.shape, *columns, pointer("uint8_t", down),
            ffi.cast("struct sim_rail *", curves),
        ])  # fmt: skip
        lib.sim_advance(
            pointer("struct sim_train", self.state), pointer("struct sim_motor", self.p),
            pointer("struct sim_drive", self.drives), schedule, pointer("double", out),
        )  # fmt: skip
        return out

    def slips(self, drive: int, condition: Rail) -> bool:
        """True when this rail cannot carry what is asked of this drive's wheel.

        Either the curve gives less within the drive's slip limit (without a limit: at its peak), or
        the wheel slides by more than 5 % and beyond that peak. Always False under a preset load.
        """
        if not self.on_rail:
            return False
        if abs(self._asked(drive)) > self._limit(drive, condition):
            return True
        creep, v = self.creep(drive)
        return abs(creep) > CREEP_LIMIT and abs(creep) > peak_creep(condition, v)

    def creep(self, drive: int) -> tuple[float, float]:
        """(Wheel - train) / train speed, and that speed, m/s; NaN under a preset load."""
        if not self.on_rail:
            return math.nan, math.nan
        v = self.v_m_s
        radius = self.train.wheel_radius_m * float(self._wheel[drive])
        slip = float(self._w_m[drive]) * radius - v
        return slip / max(abs(v), SPEED_FLOOR_M_S), v

    def shortage(self, drive: int, condition: Rail, load: float) -> float:
        """Share 0..1 of the torque asked that a drive which `slips` does not bring onto the rail.

        The rail carries the smaller of what it can carry and of `load` Nm, the load now.
        """
        asked = abs(self._asked(drive))
        if asked <= 0.0:
            return 0.0
        carried = min(self._limit(drive, condition), abs(load))
        return min(max(1.0 - carried / asked, 0.0), 1.0)

    def given(self, drive: int, torque: float) -> float:
        """Share of the train's demand on this motor that `torque` Nm is, 0..1; 1 at preset load."""
        asked = self.demand_nm * float(self._share[drive])
        if not self.on_rail or asked == 0.0:
            return 1.0
        return min(max(torque / asked, 0.0), 1.0)

    def _asked(self, drive: int) -> float:
        """The train's demand and, while the train moves, the friction brake's torque, Nm.

        At standstill a brake only holds and asks nothing of the rail. A train stands when a
        locked wheel's creep is within 5 %: below 25 mm/s.
        """
        asked = self.demand_nm * float(self._share[drive])
        v = self.v_m_s
        if abs(v) > CREEP_LIMIT * SPEED_FLOOR_M_S:
            asked -= math.copysign(float(self._brake[drive]), v)
        return asked

    def _limit(self, drive: int, condition: Rail) -> float:
        """Most that this rail carries within the drive's slip limit, Nm."""
        v = self.v_m_s
        creep = float(self._creep_max[drive])
        most = available(condition, v, peak_creep(condition, v) if math.isinf(creep) else creep)
        return self.wheel_load_nm * float(self._share[drive]) * most


class QuasiStatic:
    """The same drives without electrical detail, for long records of slow messages.

    Speed follows the profile, torque the load: currents are those of the steady state, angle is
    the integral of speed. Thousands of times faster; carries no adhesion dynamics.
    """

    STEP_NS: Final = 10_000_000

    def __init__(self, motor: Motor, theta_0: Array, load_0: float) -> None:
        """`theta_0` (N,) electrical angles, rad; `load_0` the load at the start, Nm."""
        self.motor = motor
        self.theta = np.mod(theta_0, 2.0 * math.pi)
        self.limit = np.ones(len(theta_0))
        self.demand_nm = load_0

    def advance(self, w_m: float, load: float, carry: Array, cut: NDArray[np.bool_]) -> Array:
        """Advance by 10 ms; `carry`, `cut` (N,); returns (N, 10) columns OUT at the end."""
        m = self.motor
        dt = self.STEP_NS * 1e-9
        down = np.maximum(self.limit - CUT_PER_S * dt, CUT_LEVEL)
        up = np.minimum(self.limit + RESTORE_PER_S * dt, 1.0)
        self.limit = np.where(cut, down, up)
        self.demand_nm = load
        w_e = m.pole_pairs * w_m
        self.theta = np.mod(self.theta + w_e * dt, 2.0 * math.pi)
        out = np.empty((len(self.theta), OUT))
        out[:, COMMAND] = load * self.limit
        out[:, LOAD] = load * np.minimum(self.limit, carry)
        out[:, TORQUE] = out[:, LOAD] + m.B * w_m
        i_q = out[:, TORQUE] / (m.k_p * m.pole_pairs * m.psi_pm)
        sin, cos = np.sin(self.theta), np.cos(self.theta)
        out[:, I_ALPHA] = -i_q * sin
        out[:, I_BETA] = i_q * cos
        u_d = -w_e * m.L_s * i_q
        u_q = m.R_s * i_q + w_e * m.psi_pm
        out[:, U_ALPHA] = u_d * cos - u_q * sin
        out[:, U_BETA] = u_d * sin + u_q * cos
        out[:, U_DC] = m.U_dc
        out[:, SPEED] = w_m
        out[:, ANGLE] = self.theta
        return out


def rail_array(conditions: list[Rail]) -> Array:
    """(N, 6) of the curves in force, as `struct sim_rail`."""
    return np.array(conditions, dtype=np.float64)
