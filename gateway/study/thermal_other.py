"""A second world of labelled trains, of another structure than `thermal_dataset`.

One sample a second. Only the form of the labels and the kinds of faults are shared. What differs:
the number of nodes (3 to 8) and motors (1 to 16, some parked), cooling by direction, sun and
tunnels, sensors that lag, drift, share a channel and are coarse, losses that no signal shows. Every
range is what a train in service has; its reason stands beside it.

May know: heat. May not know: any method of detection.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from gateway.study import thermal_network as heat
from gateway.study.thermal_dataset import (
    BENCH,
    MOST_BLOCKED,
    SENSOR_KINDS,
    Base,
    Fault,
    Labelled,
    clipped,
    fault_of,
    sensor_error,
)
from gateway.study.thermal_network import Network, network, settle, warm
from sim.physics.plant import TRACTION_350KW

Array = NDArray[np.float64]
Rng = np.random.Generator

STREAM: Final = 31
TRAIN, RUN = range(2)
MOTORS: Final = (1, 2, 3, 4, 4, 6, 8, 12, 16)
"""Of a train: a shunter to a train of four powered coaches; four is the commonest."""
DUTIES: Final = {
    "metro": (60.0, 110.0, 30.0, 0.9), "regional": (150.0, 420.0, 60.0, 0.8),
    "freight": (300.0, 1500.0, 240.0, 0.7),
}  # fmt: skip
"""Shortest and longest time between stops, s; at a stop, s; share of the rated torque."""


class Train(NamedTuple):
    """What stays with a train: numbers of M motors, measured by nobody but for `resolution_k`."""

    net: Network
    current: Array
    direction: Array
    iron: Array
    rub: Array
    side: Array
    offset_k: Array
    gain: Array
    sensor_lag_s: Array
    ambient_lag_s: float
    load_lag_s: float
    noise_k: float
    resolution_k: float
    channel_k: float
    duty: str


def train(
    seed: int, base: Base, kind: str | None, number: int = 0, *, new: bool = True
) -> Labelled:
    """As `thermal_dataset.train`, of the other world; within two hours nothing ages.

    Raises ValueError for samples hours apart: its sensors and weather are those of minutes.
    """
    if base is not BENCH:
        raise ValueError("the other world has only the bench base")
    del new
    own = np.random.default_rng([seed, STREAM, TRAIN])
    rng = np.random.default_rng([seed, STREAM, RUN, number])
    t, steps = _train(own), base.samples
    motors = len(t.current)
    torque, speed, way = _duty(rng, t.duty, steps)
    # One motor in ten runs of a longer train is cut out: it turns without current.
    parked = (np.arange(motors) == rng.integers(0, motors)) & (motors > 3) & (rng.random() < 0.1)
    amps = np.abs(torque) / (1.5 * TRACTION_350KW.pole_pairs * TRACTION_350KW.psi_pm)
    square = np.outer(amps**2, t.current**2 * ~parked)
    air, ambient = _weather(rng, t, steps)
    error = _slow_errors(rng, t, steps)
    truth = (square, speed, way, air)
    given = _flows(rng, t, truth)
    healthy = _felt(t, warm(t.net, settle(t.net, *given), *given))
    wrong, effect = None, np.zeros_like(healthy)
    if kind:
        wrong = fault_of(rng, base, kind)._replace(motor=_driven(rng, parked))
        effect = _effect(rng, t, base, wrong, truth)
    true = healthy * t.gain + t.offset_k + error + effect
    noise = t.noise_k * rng.standard_normal(true.shape)
    # A Pt100 in its usual transmitter ends at 200 degC.
    read = np.clip(np.round((true + noise) / t.resolution_k) * t.resolution_k, -40.0, 200.0)
    # The load comes late and averaged: torque reference, filters, and the message's cycle.
    seen_square, seen_speed = (_lagged(x, t.load_lag_s) for x in (square, np.abs(speed)))
    seen_air = np.round(_lagged(ambient, t.ambient_lag_s) * 2.0) / 2.0
    at = np.arange(steps)
    return Labelled(read, true, at, seen_square, seen_speed, seen_air, base.step_s, effect, wrong)


def _train(own: Rng) -> Train:
    motors = int(own.choice(MOTORS))
    # The make of motor differs from a mean one by a third, motors of a make by 4 % (tolerances).
    make, alike = np.exp(0.3 * own.standard_normal(18)), own.standard_normal((motors, 18))
    like = make * np.exp(0.04 * np.clip(alike, -2.5, 2.5))
    return Train(
        network(int(own.integers(3, 9)), like[:, :8], like[:, 8:]),
        # Diameters of wheels differ by some millimetres, and with them slips and currents.
        current=1.0 + 0.015 * clipped(own, motors),
        # The leading motor of a bogie gets more air than the one in its wake; they swap.
        direction=0.03 * clipped(own, motors),
        iron=own.uniform(0.7, 1.4) * (1.0 + 0.03 * clipped(own, motors)),
        rub=0.5 * (1.0 + 0.1 * clipped(own, (motors, 2))),
        side=own.choice([0.0, 1.0], motors),
        # Class B Pt100: 0.3 K + 0.5 %; gains within that.
        offset_k=0.5 * clipped(own, (motors, 3)),
        gain=1.0 + 0.003 * clipped(own, (motors, 3)),
        # Bead in a winding 3 to 15 s; in the bore of a shield up to a minute.
        sensor_lag_s=own.uniform([3.0, 10.0, 10.0], [15.0, 60.0, 60.0]),
        # Under the roof, in a housing.
        ambient_lag_s=float(own.uniform(60.0, 300.0)),
        load_lag_s=float(own.uniform(0.5, 5.0)),
        noise_k=float(own.uniform(0.05, 0.4)),
        resolution_k=float(own.choice([0.1, 0.25, 0.5, 1.0])),
        # Reference and supply of a motor's three inputs are one.
        channel_k=float(own.uniform(0.05, 0.3)),
        duty=str(own.choice(list(DUTIES))),
    )


def _lagged(x: Array, lag_s: float) -> Array:
    """First-order lag along the first axis, from its first value on."""
    keep = np.exp(-1.0 / lag_s)
    start = keep * x[:1]
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], x, axis=0, zi=start)[0])


def _wander(rng: Rng, shape: tuple[int, ...], memory_s: float) -> Array:
    """Course of standard deviation 1, clipped to 2.5, with this memory."""
    keep = np.exp(-1.0 / memory_s)
    white = rng.standard_normal(shape)
    white[0] /= np.sqrt(1.0 - keep**2)
    return np.clip(lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], white, axis=0), -2.5, 2.5)


def _duty(rng: Rng, duty: str, steps: int) -> tuple[Array, Array, Array]:
    """(L,) torque Nm, rotor speed rad/s, direction +-1: legs between stops."""
    shortest, longest, stop_s, pull = DUTIES[duty]
    # The hour of the day: at night trains are light, in the peak full.
    load = 0.85 + 0.15 * np.sin(2.0 * np.pi * (rng.uniform() + np.arange(steps) / 86_400.0))
    torque, speed, way = np.zeros(steps), np.zeros(steps), np.ones(steps)
    at, sign = 0, float(rng.choice([-1.0, 1.0]))
    while at < steps:
        n = round(rng.uniform(shortest, longest))
        top, up, down = rng.uniform(120.0, 400.0), 0.25 + 0.1 * rng.random(), 0.15
        # A shape of 0 to 1 over the leg: pull, hold, coast, brake.
        leg = np.linspace(0.0, 1.0, n)
        ramp = np.minimum(np.minimum(leg / up, 1.0), (1.0 - leg) / down)
        rises, falls = leg < up, leg > 1.0 - down
        push = np.where(rises, pull, np.where(falls, -0.8 * pull, 0.25 * rng.uniform(0.4, 1.4)))
        push[(leg > 0.75) & ~falls] = 0.0
        end = min(at + n, steps)
        torque[at:end], speed[at:end] = push[: end - at], top * ramp[: end - at]
        # One stop in eight is a terminus.
        sign = -sign if rng.random() < 0.125 else sign
        way[at:] = sign
        at = end + round(stop_s * rng.uniform(0.5, 2.0))
    return torque * load * TRACTION_350KW.T_rated, speed, way


def _weather(rng: Rng, t: Train, steps: int) -> tuple[Array, Array]:
    """(L, M) degC at the motors, (L,) degC of the open air: season, gusts, sun and tunnels."""
    season = rng.uniform(-10.0, 32.0)
    open_air = season + 0.5 * _wander(rng, (steps,), 1200.0)
    tunnel = np.zeros(steps, dtype=np.bool_)
    for _ in range(int(rng.integers(0, 5))):
        at = int(rng.integers(0, steps))
        tunnel[at : at + int(rng.uniform(30.0, 600.0))] = True
    # A tunnel has the year's mean, some 14 degC; half of its air comes in with the train.
    ambient = _lagged(np.where(tunnel, 0.5 * open_air + 0.5 * 14.0, open_air), 20.0)
    clear = np.clip(0.5 + _wander(rng, (steps,), 1500.0), 0.0, 1.0) * rng.choice([0.0, 1.0])
    # The sunny side of the ballast and the frame: up to 3 K, which come and go in minutes.
    sun = _lagged(3.0 * clear * ~tunnel, 300.0)[:, None] * t.side
    draught = 0.5 * _wander(rng, (steps, len(t.side)), 900.0)
    return ambient[:, None] + sun + draught, ambient


def _slow_errors(rng: Rng, t: Train, steps: int) -> Array:
    """(L, M, 3) K that sensors are off by in health: drift, and what a channel shares."""
    motors = len(t.side)
    # Self-heating and thermal voltages: a fifth of a kelvin in an hour.
    drift = 0.15 * _wander(rng, (steps, motors, 3), 3600.0)
    channel = t.channel_k * _wander(rng, (steps, motors), 600.0)
    return np.asarray(drift + channel[:, :, None])


def _flows(
    rng: Rng, t: Train, truth: tuple[Array, Array, Array, Array]
) -> tuple[Array, Array, Array, Array]:
    """What `warm` takes, of healthy motors."""
    square, speed, way, air = truth
    steps, motors = square.shape
    flows, cooling = np.zeros((steps, motors, 8)), np.empty((steps, motors, 8))
    copper = 1.5 * TRACTION_350KW.R_s * square
    # Iron: hysteresis and eddies, 1.5th power; magnets' part in the rotor. The inverter's ripple
    # adds a tenth of the copper loss below the speed at which its pulse pattern changes.
    iron = 0.75 * speed[:, None] ** 1.5 * t.iron
    ripple = 0.1 * copper * (speed < 180.0)[:, None]
    flows[:, :, heat.CORE], flows[:, :, heat.ROTOR] = (
        0.8 * iron + 0.5 * ripple,
        0.2 * iron + 0.5 * ripple,
    )
    friction = speed[:, None, None] * t.rub * (1.0 + 0.04 * _wander(rng, (steps, motors, 2), 900.0))
    flows[:, :, [heat.DRIVE_END, heat.OTHER_END]] = friction
    flows[:, :, heat.GEARBOX] = 1.2 * speed[:, None]
    fan = speed[:, None] ** 0.8 * (1.0 + way[:, None] * t.direction)
    fan = fan * (1.0 + 0.02 * _wander(rng, (steps, motors), 900.0))
    cooling[:] = heat.STILL + heat.MOVING * fan[:, :, None]
    return flows, copper, cooling, air


def _felt(t: Train, true: Array) -> Array:
    """(L, M, 3) degC as the sensors feel it."""
    out = np.empty_like(true)
    for q, lag in enumerate(t.sensor_lag_s.tolist()):
        out[:, :, q] = _lagged(true[:, :, q], lag)
    return out


def _driven(rng: Rng, parked: NDArray[np.bool_]) -> int:
    """A motor that has current: a fault of one that has none is nobody's."""
    return int(rng.choice(np.flatnonzero(~parked)))


def _effect(
    rng: Rng, t: Train, base: Base, wrong: Fault, truth: tuple[Array, Array, Array, Array]
) -> Array:
    """(L, M, 3) K: what the fault adds to the readings."""
    square, speed, way, air = truth
    out, one = np.zeros((*square.shape, 3)), slice(wrong.motor, wrong.motor + 1)
    if wrong.kind in SENSOR_KINDS:
        out[:, wrong.motor, wrong.point] = sensor_error(rng, base, wrong)
        return out
    mine = t._replace(
        net=t.net._replace(capacity=t.net.capacity[one], flow=t.net.flow[one]),
        direction=t.direction[one], iron=t.iron[one], rub=t.rub[one],
    )  # fmt: skip
    seed = int(rng.integers(2**32))
    given = _flows(np.random.default_rng(seed), mine, (square[:, one], speed, way, air[:, one]))
    healthy, amount = (
        _felt(mine, warm(mine.net, settle(mine.net, *given), *given)),
        0.3 if wrong.kind == "cooling_loss" else 200.0,
    )
    for _ in range(6):
        ill = _felt(mine, _warm_ill(mine, given, wrong, amount, speed))
        reached = float((ill - healthy).max())
        if abs(reached - wrong.size_k) < 0.05 * wrong.size_k:
            break
        wanted = amount * min(wrong.size_k / max(reached, 1e-3), 30.0)
        amount = min(wanted, MOST_BLOCKED) if wrong.kind == "cooling_loss" else wanted
    out[:, one] = ill - healthy
    return out


def _warm_ill(
    t: Train, given: tuple[Array, Array, Array, Array], wrong: Fault, amount: float, speed: Array
) -> Array:
    """(L, 1, 3) degC of the faulty motor. amount: W, or share of the air or of the resistance."""
    start = settle(t.net, *given)
    flows, copper, cooling, air = (x.copy() for x in given)
    when = slice(wrong.begin, wrong.end)
    if wrong.kind == "overheating":
        flows[when, :, heat.SLOT] += 0.6 * amount
        flows[when, :, heat.END_WINDING] += 0.4 * amount
    elif wrong.kind == "bearing":
        lump = (heat.SLOT, heat.DRIVE_END, heat.OTHER_END)[wrong.point]
        flows[when, :, lump] += amount * (speed[when] / max(speed.mean(), 1e-9))[:, None]
    elif wrong.kind == "cooling_loss":
        cooling[when] *= 1.0 - amount
    else:
        copper[when] *= 1.0 + amount / 200.0
    return warm(t.net, start, flows, copper, cooling, air)
