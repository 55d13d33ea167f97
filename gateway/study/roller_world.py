"""Wheels on rollers, two axles to a bogie: a third world to judge detectors in.

The mechanics are independent of `sim/physics`. The rollers are geared together, have the
vehicle's mass, as seen from the rotors, and are held softly at the profile's speed. Creep force
rises to a peak and falls beyond it, f(x) = sin(C atan(B x)) with x the creep; an effort relieves
the bogie's first axle and loads its second. Torque follows the demand with a lag. A drive's slip
limiter cuts it beyond the limiter's creep; without one, the wheel runs up until no voltage is
left. Friction brakes, if there are any, act on every wheel beside a braking motor and slow the
rollers. Currents and voltages follow in closed form, as in `held_world`.

In a loss the rail carries a share of the demand; it begins from 0.5 s on and grows over 1 ms to
1 s. A wheel is `lost` in the truth while the rail carries less than the demand, or, with depth 0,
while it still slides beyond both the peak and 5 % creep. Nothing is tuned on this world.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np

from dbc.arrays import Array, Flags
from dbc.codec import Codec
from gateway.study.held_world import (
    LENGTH_S,
    TAIL_S,
    OtherMachine,
    Played,
    courses,
    electrical,
    periods,
)
from gateway.study.scenarios_random import PerUnit, between, sign
from gateway.study.varied_trains import variation
from sim.drive_spread import Variety
from sim.physics.adhesion import Rail
from sim.physics.plant import CREEP_LIMIT, DT
from sim.scenario import Scenario, parse

STREAM: Final = 37
SHAPE: Final = 1.4
"""C: far beyond the peak the contact carries sin(C pi / 2) = 0.81 of the peak force."""
PEAK_CREEP: Final = (0.02, 0.06)
GRIP: Final = (1.3, 2.0)
"""Torque that a wheel carries at the peak of the creep curve, over rated torque."""
ROLLER: Final = (30.0, 120.0)
"""Inertia of the rollers per axle, over the rotor's."""
HELD_S: Final = 2.0
"""Time constant with which the rollers are held at their speed."""
TRANSFER: Final = 0.12
"""Share of an axle's normal force that moves, with rated torque on both axles of the bogie."""
LAG_S: Final = 0.002
RUN_UP: Final = (1.4, 1.6)
"""Wheel speed over the rollers' plus 5 rad/s: where torque begins to fall, and where it is 0."""
STOP: Final = 0.1
"""The same ratio, below which a brake's torque falls to zero, so that no wheel turns backwards."""
SLOWEST_RAD_S: Final = 1.0
"""Smallest speed by which a creep is divided."""
ONSET_S: Final = (0.5, 2.5)
DEPTH: Final = (0.2, 1.0)
RAMP_S: Final = (0.001, 1.0)
LEAST_BITRATE_DRIVES: Final = 4
FRICTION: Final = (0.05, 0.25)
"""Torque of the friction brakes of a wheel, over rated torque."""
FRICTION_AT_S: Final = (0.3, 2.5)
FRICTION_RISE_S: Final = (0.2, 1.0)
STANDS_RAD_S: Final = 0.5
"""Speed of a rotor below which the friction of its brakes falls to 0."""


class Limiter(NamedTuple):
    """A drive's own slip control: cuts torque at `cut` 1/s above `creep`, else restores it."""

    creep: float
    cut: float
    back: float


LIMITERS: Final = {
    "fast": Limiter(0.08, 40.0, 4.0),
    "slow": Limiter(0.20, 4.0, 1.0),
    "none": Limiter(np.inf, 0.0, 0.0),
}


class Kind(NamedTuple):
    """One kind of run.

    drives: least and most; lost: largest share of them that loses adhesion; varied: any motor and
    bus, with drives and speed of `varied_trains`; friction: brakes beside a motor that brakes.
    """

    title: str
    limiter: str
    drives: tuple[int, int] = (3, 3)
    lost: float = 0.34
    commands: bool = True
    apart: float = 0.0
    varied: bool = False
    friction: bool = False


KINDS: Final = {
    "roller": Kind("one of three, fast limiter", "fast"),
    "roller_slow": Kind("one of three, slow limiter", "slow"),
    "roller_none": Kind("one of three, no limiter", "none"),
    "roller_mute": Kind("one of three, no command", "slow", commands=False),
    "roller_two": Kind("one of two", "slow", (2, 2), 0.5),
    "roller_many": Kind("up to a third of 4 to 16", "slow", (4, 16)),
    "roller_apart": Kind("one of three, 10 % apart", "slow", apart=0.1),
    "roller_healthy": Kind("nothing lost", "slow", (2, 16), 0.0, apart=0.1),
    "roller_healthy_mute": Kind("nothing lost, no command", "slow", (2, 16), 0.0, False, 0.1),
    "roller_varied": Kind("any motor and bus", "slow", apart=0.1, varied=True),
    "roller_varied_healthy": Kind(
        "the same, nothing lost", "slow", lost=0.0, apart=0.1, varied=True
    ),
    "roller_friction": Kind("one of three, friction brakes, too", "slow", friction=True),
    "roller_friction_healthy": Kind("the same, nothing lost", "slow", lost=0.0, friction=True),
}


def draw(name: str, seed: int, motor: str = "bench") -> Scenario:
    """The run of this kind and seed. Raises KeyError for an unknown kind."""
    kind = KINDS[name]
    rng = np.random.default_rng([seed, STREAM, list(KINDS).index(name)])
    varied = variation(seed) if kind.varied else None
    unit = PerUnit(motor, varied and varied.motor)
    drives = int(rng.integers(kind.drives[0], kind.drives[1], endpoint=True))
    speed, load = between(rng, unit.speed, 3) * sign(rng), between(rng, (8.0, 26.0)) * sign(rng)
    if kind.friction:
        load = -math.copysign(load, speed)
    if varied:
        drives, speed = varied.drives, varied.speed_rad_s
    most = math.ceil(kind.lost * drives) if varied else int(kind.lost * drives)
    who = rng.choice(drives, int(rng.integers(1, most, endpoint=True)) if most else 0, False)
    onset = between(rng, ONSET_S)
    events: list[dict[str, Any]] = []
    for drive in who:
        ramp_s = round(float(np.exp(rng.uniform(*np.log(RAMP_S)))), 4)
        events.append({
            "at_s": onset, "for_s": round(2.0 * ramp_s + between(rng, LENGTH_S), 4),
            "drive": int(drive) + 1, "kind": "adhesion_loss", "depth": between(rng, DEPTH),
            "ramp_s": ramp_s,
        })  # fmt: skip
    end = max((e["at_s"] + e["for_s"] for e in events), default=5.0) + TAIL_S
    begin, last = unit.nm(load), unit.nm(load * between(rng, (0.6, 1.15)))
    table: dict[str, Any] = {
        "title": f"{name} {seed}", "seed": seed, "drives": drives, "duration_s": round(end, 4),
        "motor": varied.sheet() if varied else {"name": motor}, "motion": {"speed": speed},
        "load": {
            "kind": "preset", "transition": "linear",
            "profile": [[0.0, begin], [round(0.3 * end, 4), begin], [round(end, 4), last]],
        },
        "sensors": {"current_noise_var": unit.noise(2e-4)}, "event": events,
    }  # fmt: skip
    if kind.apart:
        table["load"]["share_within"] = kind.apart
    if drives > LEAST_BITRATE_DRIVES or not kind.commands or varied:
        table["bus"] = {"bitrate": 0}
    return parse(table, table["title"])


class Waveforms(NamedTuple):
    """Waveforms of a whole run, a row every `DT`.

    rows (n, N, 10): columns `sim.physics.plant.OUT`; slides (n, N): creep is beyond the peak and
    5 %; given (n, N): share of its torque that the drive's own limiter lets through.
    """

    rows: Array
    slides: Flags
    given: Array


def waveforms(name: str, scenario: Scenario) -> Waveforms:
    """Simulate the machines of a run in steps of `DT`."""
    variety, (w_ref, _, demand), carried = courses(scenario, periods(scenario) + 1)
    brake = friction(name, scenario, len(demand))
    # Load that a loss leaves at the peak of the creep curve; infinite without a loss.
    left = np.where(carried < 1.0, carried * (np.abs(demand) + brake)[:, None], np.inf)
    rig = Rig(scenario, variety, LIMITERS[KINDS[name].limiter])
    speed, torque, load, given = np.empty((4, len(demand), scenario.drives))
    slides = np.empty((len(demand), scenario.drives), np.bool_)
    for k in range(len(demand)):
        rig.advance(w_ref[k], demand[k], left[k], brake[k])
        speed[k], torque[k], load[k], slides[k] = rig.w, rig.torque, rig.on_shaft, rig.slides
        given[k] = rig.limit
    rows = electrical(scenario, variety, speed, torque, load, demand)
    return Waveforms(rows, slides[1:], given[1:])


def friction(name: str, scenario: Scenario, rows: int) -> Array:
    """Torque (rows,) of each wheel's friction brakes, Nm at the motor's shaft."""
    if not KINDS[name].friction:
        return np.zeros(rows)
    rng = np.random.default_rng([scenario.seed, STREAM, len(FRICTION)])
    most = between(rng, FRICTION) * scenario.motor.machine.T_rated
    since = np.arange(rows) * DT - between(rng, FRICTION_AT_S)
    out: Array = most * np.clip(since / between(rng, FRICTION_RISE_S), 0.0, 1.0)
    return out


class _Rolled(Played):
    """Plant that plays rows back and knows which wheels slide."""

    def __init__(self, scenario: Scenario, played: Waveforms) -> None:
        super().__init__(scenario, played.rows)
        self._slides, self._given = played.slides, played.given

    def given(self, drive: int, _torque: float) -> float:
        return float(self._given[self._at - 1, drive])

    def slips(self, drive: int, _condition: Rail) -> bool:
        return bool(self._slides[self._at - 1, drive])

    def shortage(self, _drive: int, _condition: Rail, _load: float) -> float:
        """Missing share of the demand: 0, because the wheel's own rail carries all of it."""
        return 0.0


class Roller(OtherMachine):
    """The simulated train on rollers."""

    def __init__(self, name: str, scenario: Scenario, codec: Codec) -> None:
        """Simulate the run `scenario` of this kind."""
        played = waveforms(name, scenario)
        super().__init__(scenario, codec, played.rows)
        self._plant = _Rolled(scenario, played)


class Rig:
    """All wheels of a run and the rollers, advanced by one period of `DT` at a time."""

    def __init__(self, scenario: Scenario, variety: Variety, limiter: Limiter) -> None:
        """Draw all random numbers from the scenario's seed."""
        rng = np.random.default_rng([scenario.seed, STREAM])
        motor, n = scenario.motor.machine, scenario.drives
        self._limiter, self._j, self._rated = limiter, motor.J, motor.T_rated
        self._share: Array = variety.share(0.0)
        self._wheel: Array = variety.p.wheel
        self._peak_creep = between(rng, PEAK_CREEP)
        self._stiff = np.tan(np.pi / 2 / SHAPE) / self._peak_creep
        self._grip = rng.uniform(*GRIP, n) * motor.T_rated
        self._mass = between(rng, ROLLER) * motor.J
        self._bogie = np.arange(n) // 2
        self._axles = np.bincount(self._bogie)[self._bogie]
        self._transfer = TRANSFER * np.where(np.arange(n) % 2, 1.0, -1.0) * (self._axles == 2)
        self._v: float | None = None
        self.limit = np.ones(n)
        self.w = np.zeros(n)
        self.torque = np.zeros(n)
        self.load = np.zeros(n)
        self.on_shaft = np.zeros(n)
        """Torque of rail and brakes on each rotor, Nm."""
        self.slides = np.zeros(n, np.bool_)

    def advance(self, w_ref: float, demand: float, left: Array, brake: float) -> None:
        """Advance one period. w_ref rad/s; demand, brake Nm of each drive; left (N,) Nm: limit."""
        asked = demand * self._share
        if self._v is None:
            self._v, self.torque, self.load = w_ref, asked.copy(), asked.copy()
            self.w = (w_ref + self._steady_creep() * abs(w_ref)) / self._wheel
        v, rolls = self._v, self.w * self._wheel
        per_v = max(abs(v), SLOWEST_RAD_S)
        creep = (rolls - v) / per_v
        peak = np.minimum(self._normal(v) * self._grip, left)
        angle = SHAPE * np.arctan(self._stiff * creep)
        bent = 1.0 + (self._stiff * creep) ** 2
        slope = peak * np.cos(angle) * SHAPE * self._stiff / bent / per_v
        self.load = peak * np.sin(angle)
        self.on_shaft = self.load + brake * np.clip(self.w / STANDS_RAD_S, -1.0, 1.0)
        self.slides = np.abs(creep) > max(CREEP_LIMIT, self._peak_creep)
        self._follow(asked, creep * np.sign(demand), rolls / (v + 5.0 * np.sign(v)))
        # Linearly implicit, because the contact is faster than a period.
        gained = DT * (self.torque - self.on_shaft)
        self.w = self.w + gained / (self._j + DT * np.maximum(slope, 0.0))
        pull = float((self.load - asked).mean()) / self._mass
        self._v = v + DT * (pull + (w_ref - v) / HELD_S)

    def _normal(self, v: float) -> Array:
        """Normal force (N,) of each axle, over that at rest."""
        effort = np.bincount(self._bogie, self.load)[self._bogie] / (self._axles * self._rated)
        out: Array = 1.0 + self._transfer * effort * np.sign(v)
        return out

    def _steady_creep(self) -> Array:
        """Creep (N,) below the peak at which each wheel carries its load."""
        assert self._v is not None
        used = self.load / (self._normal(self._v) * self._grip)
        out: Array = np.tan(np.arcsin(used) / SHAPE) / self._stiff
        return out

    def _follow(self, asked: Array, creep: Array, run_up: Array) -> None:
        """Update the motors' torque. creep (N,): positive where a wheel slips with its effort."""
        limiter = self._limiter
        change = np.where(creep > limiter.creep, -limiter.cut, limiter.back)
        self.limit = np.clip(self.limit + DT * change, 0.0, 1.0)
        most, stop = (RUN_UP[1] - run_up) / (RUN_UP[1] - RUN_UP[0]), run_up / STOP
        given = np.clip(np.where(asked * (self._v or 0.0) > 0.0, most, stop), 0.0, 1.0)
        self.torque = self.torque + DT / LAG_S * (asked * self.limit * given - self.torque)
