"""Labelled trains for thermal fault detection: four 350 kW motors, duty, disturbances, a fault.

Two time bases. `DAYS`: the paper's, 360 samples in 100 days, the fault from day 50 (sample 180) to
day 75 (270). `BENCH`: what a bench sees on CAN, one sample a second for two hours.

The difficulty: each motor has its own disturbances, which no sensor measures: cooling air 3 %,
local air 1 K, bearing friction 8 % (one sigma, each a slow random course on top of a constant of
the motor), and ageing as a jump diffusion, which a new train does not have yet. The true effect of
a fault is only 3 to 12 K.

May know: heat. May not know: any method of detection.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from dbc.arrays import Array, Flags, Ints
from gateway.study.thermal_heat import MEASURED, MOTORS, NODES, Ills, heat_record, no_ills, settled
from sim.physics.plant import TRACTION_350KW

Rng = np.random.Generator

STREAM: Final = 30
"""Purpose of the random streams; purposes within a train follow."""
TRAIN, RUN = range(2)

AIR_SPREAD, LOCAL_AIR_K, FRICTION_SPREAD, CURRENT_SPREAD = 0.03, 1.0, 0.08, 0.01
READING_NOISE_K: Final = 0.25
RESOLUTION_K: Final = 0.1
OFFSET_K: Final = 0.7


class Base(NamedTuple):
    """A time base: K samples `sample_s` apart, simulated in steps of `step_s`.

    memory_s: time constant of the disturbances' courses; onset, length: ranges, samples.
    """

    name: str
    samples: int
    sample_s: float
    step_s: float
    memory_s: float
    onset: tuple[int, int]
    length: tuple[int, int]
    ageing: float
    """Largest drift of the cooling in the record, as a share of the air."""


DAYS: Final = Base("days", 360, 24_000.0, 60.0, 2 * 86_400.0, (180, 180), (90, 90), 0.12)
BENCH: Final = Base("bench", 7200, 1.0, 1.0, 900.0, (2400, 3600), (1200, 2400), 0.0)
BASES: Final = {base.name: base for base in (DAYS, BENCH)}
KINDS: Final = (
    "overheating", "cooling_loss", "bearing", "winding_resistance", "sensor_bias", "intermittent",
)  # fmt: skip
CREEP: Final = "sensor_creep"
"""A sensor that drifts as slowly as heat does; it does not count in the benchmark's sums."""
SENSOR_KINDS: Final = ("sensor_bias", "intermittent", CREEP)
SIZE_K: Final = (3.0, 12.0)
"""True effect at the sensor that shows it most. Where samples are hours apart: settled, at the mean
duty; otherwise the largest effect that is reached while the fault lasts."""
MOST_BLOCKED, MOST_MORE = 0.9, 1e5
"""Largest share of the air that a fault can take; largest amount of any other fault."""
INTERMITTENT_K: Final = (15.0, 40.0)
INTERMITTENT_SHARE: Final = 0.05
"""Share of wrong readings, in bursts, while the connector is loose."""


class Fault(NamedTuple):
    """Kind, place and time of a fault.

    kind: of `KINDS`; motor; point: 0..2 for sensors and bearings, else -1; begin, end: samples.
    """

    kind: str
    motor: int
    point: int
    begin: int
    end: int
    size_k: float


class Labelled(NamedTuple):
    """A train's record and its truth.

    temperature (K, M, 3) degC as read, true (K, M, 3) without noise; at (K,): steps; current_square
    (L, M), speed (L,), ambient (L,) as measured; effect (K, M, 3) K: readings less those without
    the fault, noise aside.
    """

    temperature: Array
    true: Array
    at: Ints
    current_square: Array
    speed: Array
    ambient: Array
    step_s: float
    effect: Array
    fault: Fault | None

    @property
    def faulty(self) -> Flags:
        """(K,) whether a fault is injected."""
        label = np.zeros(len(self.at), dtype=np.bool_)
        if self.fault is not None:
            label[self.fault.begin : self.fault.end] = True
        return label


def train(
    seed: int, base: Base, kind: str | None, number: int = 0, *, new: bool = False
) -> Labelled:
    """Simulate run `number` of the train `seed`: the same motors, with another duty and weather.

    kind: of `KINDS`, or None for a healthy run; new: the cooling does not age. A pure function of
    its arguments.
    """
    own = np.random.default_rng([seed, STREAM, TRAIN])
    rng = np.random.default_rng([seed, STREAM, RUN, list(BASES).index(base.name), number])
    steps = round(base.samples * base.sample_s / base.step_s)
    at = (np.arange(1, base.samples + 1) * base.sample_s / base.step_s).round().astype(int) - 1
    torque, speed, ambient = _duty(rng, base, steps)
    motor = TRACTION_350KW
    amps = torque / (1.5 * motor.pole_pairs * motor.psi_pm)
    share = 1.0 + CURRENT_SPREAD * clipped(own, MOTORS)
    square = np.outer(amps**2, share**2)
    air = _course(own, rng, base, steps, AIR_SPREAD) * _ageing(
        rng, 0.0 if new else base.ageing, steps
    )
    friction = _course(own, rng, base, steps, FRICTION_SPREAD)
    local = ambient[:, None] + LOCAL_AIR_K * (_course(own, rng, base, steps, 1.0) - 1.0)
    fault = fault_of(rng, base, kind) if kind else None
    healthy = heat_record(base.step_s, square, speed, (local, air, friction), no_ills(steps), at)
    real, error = healthy, np.zeros_like(healthy)
    if fault is not None and fault.kind in SENSOR_KINDS:
        error[:, fault.motor, fault.point] = sensor_error(rng, base, fault)
    elif fault is not None:

        def ill(share: float) -> Array:
            ills = _ills(fault, base, square, speed, share)
            return heat_record(base.step_s, square, speed, (local, air, friction), ills, at)

        real = ill(1.0) if base is DAYS else _reaching(fault.size_k, ill, healthy)
    offset = OFFSET_K * clipped(own, (MOTORS, len(MEASURED)))
    noise = READING_NOISE_K * rng.standard_normal(real.shape)
    true = real + offset + error
    reading = np.round((true + noise) / RESOLUTION_K) * RESOLUTION_K
    seen = ambient + 0.3 * rng.standard_normal(steps)
    effect = real - healthy + error
    return Labelled(reading, true, at, square, speed, seen, base.step_s, effect, fault)


def clipped(rng: Rng, shape: int | tuple[int, ...]) -> Array:
    """Draw from a normal distribution with standard deviation 1, clipped to 2.5."""
    out: Array = np.clip(rng.standard_normal(shape), -2.5, 2.5)
    return out


def wandering(rng: Rng, shape: tuple[int, ...], memory: float) -> Array:
    """Random course with standard deviation 1, clipped to 2.5, and this time constant in steps."""
    from scipy.signal import lfilter

    keep = np.exp(-1.0 / memory)
    white = rng.standard_normal(shape)
    white[0] /= np.sqrt(1.0 - keep**2)
    return np.clip(lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], white, axis=0), -2.5, 2.5)


def _course(own: Rng, rng: Rng, base: Base, steps: int, sigma: float) -> Array:
    """Factors (L, M) that wander around a constant of each motor, with the base's memory."""
    wander = wandering(rng, (steps, MOTORS), base.memory_s / base.step_s)
    return np.asarray(1.0 + sigma * (clipped(own, MOTORS) + wander) / 1.5)


def _ageing(rng: Rng, most: float, steps: int) -> Array:
    """Share (L, M) of the air that dirt leaves: drift, Brownian motion, and jumps (a cleaning).

    most: largest drift in the whole record.
    """
    if not most:
        return np.ones((steps, MOTORS))
    share = 1.0 / steps
    drift = most * rng.uniform(0.3, 1.0, MOTORS) * share
    walk = 0.3 * most * np.sqrt(share) * rng.standard_normal((steps, MOTORS))
    jumps = (rng.random((steps, MOTORS)) < 2.0 * share) * rng.normal(
        0.0, 0.3 * most, (steps, MOTORS)
    )
    return np.clip(1.0 - np.cumsum(drift + walk + jumps, axis=0), 0.85, 1.1)


def _duty(rng: Rng, base: Base, steps: int) -> tuple[Array, Array, Array]:
    """Torque Nm, rotor speed rad/s, ambient degC, (L,) each: legs between stops; the weather."""
    rated = TRACTION_350KW.T_rated
    torque, speed = np.empty(steps), np.empty(steps)
    at, now = 0, 0.0
    while at < steps:
        top = rng.uniform(150.0, 420.0)
        for kind in ("pull", "cruise", "coast", "brake", "stand"):
            # The same bits as draws of `uniform` one by one.
            pull, cruise, coast, brake, stand, *share = rng.random(8).tolist()
            for_s = {
                "pull": 120.0 + 240.0 * pull, "cruise": 120.0 + 1380.0 * cruise,
                "coast": 30.0 + 170.0 * coast, "brake": 60.0 + 120.0 * brake,
                "stand": 60.0 + 340.0 * stand,
            }[kind]  # fmt: skip
            n = min(max(round(for_s / base.step_s), 1), steps - at)
            end = {"pull": top, "cruise": top, "coast": 0.9 * top, "brake": 0.0, "stand": 0.0}[kind]
            level = {
                "pull": 0.6 + 0.4 * share[0], "cruise": 0.15 + (0.45 - 0.15) * share[1],
                "coast": 0.0, "brake": -(0.4 + 0.5 * share[2]), "stand": 0.0,
            }[kind]  # fmt: skip
            torque[at : at + n] = level * rated
            speed[at : at + n] = now + (end - now) / n * np.arange(n)
            at, now = at + n, end
            if at >= steps:
                break
    t = np.arange(steps) * base.step_s
    day = 6.0 * np.sin(2.0 * np.pi * t / 86_400.0 + rng.uniform(0.0, 2.0 * np.pi))
    season = rng.uniform(-5.0, 25.0) + 8.0 * np.sin(
        2.0 * np.pi * t / (200.0 * 86_400.0) + rng.uniform(0.0, 2.0 * np.pi)
    )
    return torque, speed, season + day


def fault_of(rng: Rng, base: Base, kind: str) -> Fault:
    """Draw place, time and size of a fault of this kind; the motor is one of `MOTORS`."""
    begin = int(rng.integers(base.onset[0], base.onset[1] + 1))
    length = int(rng.integers(base.length[0], base.length[1] + 1))
    any_point, end = int(rng.integers(0, 3)), int(rng.integers(1, 3))
    point = any_point if kind in SENSOR_KINDS else end if kind == "bearing" else -1
    # The paper's fault is in coach 4; with a fixed motor, methods could learn which one it is.
    motor = 3 if base is DAYS else int(rng.integers(0, MOTORS))
    limits = INTERMITTENT_K if kind == "intermittent" else SIZE_K
    return Fault(kind, motor, point, begin, min(begin + length, base.samples),
                 float(rng.uniform(*limits)))  # fmt: skip


def _reaching(size_k: float, ill: Callable[[float], Array], healthy: Array) -> Array:
    """Temperatures (K, M, 3) degC with a fault whose largest effect is `size_k`, if possible.

    ill: temperatures for a share of the fault; a share of 1 would reach `size_k` when settled.
    """
    share = 1.0
    for _ in range(4):
        real = ill(share)
        reached = float((real - healthy).max())
        if abs(reached - size_k) < 0.05 * size_k:
            break
        share *= min(size_k / max(reached, 1e-3), 30.0)
    return real


def _ills(fault: Fault, base: Base, square: Array, speed: Array, share: float) -> Ills:
    """Causes of a fault of heat, sized by its true effect.

    With a share of 1, the point that shows it most settles `size_k` warmer, at the mean duty.
    """
    ills = no_ills(len(speed))._replace(motor=fault.motor)
    per = base.sample_s / base.step_s
    when = slice(round(fault.begin * per), round(fault.end * per))
    mean = (float(square[:, fault.motor].mean()), float(np.abs(speed).mean()))
    healthy = settled(*mean, 0.0, 1.0, np.zeros(NODES))

    def most(amount: float) -> float:
        """Temperature rise, K, at the point that shows it most, for this amount of the fault."""
        heat = (amount if fault.kind in ("overheating", "bearing") else 0.0) * np.eye(NODES)
        air = amount if fault.kind == "cooling_loss" else 0.0
        copper = 1.0 + amount if fault.kind == "winding_resistance" else 1.0
        return float((settled(*mean, air, copper, heat[ills.node]) - healthy).max())

    if fault.kind == "bearing":
        ills = ills._replace(node=MEASURED[fault.point])
    limit = MOST_BLOCKED if fault.kind == "cooling_loss" else MOST_MORE
    amount = min(share * _amount(most, fault.size_k, limit), limit)
    if fault.kind == "overheating":
        ills.heat[when] = amount
    elif fault.kind == "bearing":
        # Friction makes heat only while the rotor turns.
        ills.heat[when] = amount * np.abs(speed[when]) / max(mean[1], 1e-9)
    elif fault.kind == "cooling_loss":
        ills.blocked[when] = amount
    elif fault.kind == "winding_resistance":
        ills.resistance[when] = 1.0 + amount
    return ills


def _amount(effect: Callable[[float], float], wanted: float, most: float) -> float:
    """The amount (<= most) that has the wanted effect, by bisection; the effect rises with it."""
    low, high = 0.0, most
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if effect(middle) < wanted else (low, middle)
    return high


def sensor_error(rng: Rng, base: Base, fault: Fault) -> Array:
    """Error (K,) in K, of either sign: a sudden or creeping bias, or a loose connector's bursts."""
    error = np.zeros(base.samples)
    length = fault.end - fault.begin
    sign = float(rng.choice([-1.0, 1.0]))
    if fault.kind == "sensor_bias":
        error[fault.begin : fault.end] = sign * fault.size_k
        return error
    if fault.kind == CREEP:
        ramp = rng.uniform(0.25, 1.0) * length
        error[fault.begin : fault.end] = (
            sign * fault.size_k * np.minimum(np.arange(1, length + 1) / ramp, 1.0)
        )
        return error
    burst = max(round(5.0 / base.sample_s), 1)
    begins = np.flatnonzero(rng.random(length) < INTERMITTENT_SHARE / burst)
    for begin in begins.tolist():
        until = min(begin + burst, length)
        error[fault.begin + begin : fault.begin + until] = sign * fault.size_k
    return error
