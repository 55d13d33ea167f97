"""A second world of labelled trains, with another structure than `thermal_dataset`.

One sample a second. Only the form of the labels and the kinds of faults are shared. Differences:
the number of nodes (3 to 8) and motors (1 to 16, some parked); cooling that depends on direction;
sun and tunnels; sensors that lag, drift, share a channel and are coarse; power losses that no
signal shows. Every range is that of trains in service; the reason is beside it.

May know: heat. May not know: any method of detection.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from scipy.signal import lfilter

from dbc.arrays import Array
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
    wandering,
)
from gateway.study.thermal_network import Network, network, settle, warm
from sim.physics.plant import TRACTION_350KW

Rng = np.random.Generator

STREAM: Final = 31
TRAIN, RUN = range(2)
MOTORS: Final = (1, 2, 3, 4, 4, 6, 8, 12, 16)
"""Motors of a train, from a shunter to a train of four powered coaches; four is commonest."""
DUTIES: Final = {
    "metro": (60.0, 110.0, 30.0, 0.9), "regional": (150.0, 420.0, 60.0, 0.8),
    "freight": (300.0, 1500.0, 240.0, 0.7),
}  # fmt: skip
"""Shortest and longest time between stops, s; time at a stop, s; share of the rated torque."""


class Train(NamedTuple):
    """Constants of a train of M motors; none is measured, except `resolution_k`."""

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
    """As `thermal_dataset.train`, in the other world; nothing ages within two hours.

    Raises ValueError for samples hours apart: sensors and weather here change within minutes.
    """
    if base is not BENCH:
        raise ValueError("the other world has only the bench base")
    del new
    own = np.random.default_rng([seed, STREAM, TRAIN])
    rng = np.random.default_rng([seed, STREAM, RUN, number])
    t, steps = _train(own), base.samples
    motors = len(t.current)
    torque, speed, way = _duty(rng, t.duty, steps)
    # In one of ten runs of a longer train, one motor is cut out: it turns without current.
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
        wrong = fault_of(rng, base, kind)
        # A fault in a motor without current has no effect to detect.
        wrong = wrong._replace(motor=int(rng.choice(np.flatnonzero(~parked))))
        effect = _effect(rng, t, base, wrong, truth)
    true = healthy * t.gain + t.offset_k + error + effect
    noise = t.noise_k * rng.standard_normal(true.shape)
    # The usual transmitter of a Pt100 ends at 200 degC.
    read = np.clip(np.round((true + noise) / t.resolution_k) * t.resolution_k, -40.0, 200.0)
    # Load signals are late and averaged: torque reference, filters, and the message's cycle.
    seen_square, seen_speed = (_lagged(x, t.load_lag_s) for x in (square, np.abs(speed)))
    seen_air = np.round(_lagged(ambient, t.ambient_lag_s) * 2.0) / 2.0
    at = np.arange(steps)
    return Labelled(read, true, at, seen_square, seen_speed, seen_air, base.step_s, effect, wrong)


def _train(own: Rng) -> Train:
    motors = int(own.choice(MOTORS))
    # A make of motor differs from the mean by a third, motors of one make by 4 % (tolerances).
    make, alike = np.exp(0.3 * own.standard_normal(18)), own.standard_normal((motors, 18))
    like = make * np.exp(0.04 * np.clip(alike, -2.5, 2.5))
    return Train(
        network(int(own.integers(3, 9)), like[:, :8], like[:, 8:]),
        # Wheel diameters differ by some millimetres, and so do slips and currents.
        current=1.0 + 0.015 * clipped(own, motors),
        # A bogie's leading motor gets more air than the other; with the direction they swap.
        direction=0.03 * clipped(own, motors),
        iron=own.uniform(0.7, 1.4) * (1.0 + 0.03 * clipped(own, motors)),
        rub=0.5 * (1.0 + 0.1 * clipped(own, (motors, 2))),
        side=own.choice([0.0, 1.0], motors),
        # Class B Pt100: 0.3 K + 0.5 %; gains within that.
        offset_k=0.5 * clipped(own, (motors, 3)),
        gain=1.0 + 0.003 * clipped(own, (motors, 3)),
        # Time constants: bead in a winding 3 to 15 s; in the bore of a shield up to a minute.
        sensor_lag_s=own.uniform([3.0, 10.0, 10.0], [15.0, 60.0, 60.0]),
        # The ambient sensor is under the roof, in a housing.
        ambient_lag_s=float(own.uniform(60.0, 300.0)),
        load_lag_s=float(own.uniform(0.5, 5.0)),
        noise_k=float(own.uniform(0.05, 0.4)),
        resolution_k=float(own.choice([0.1, 0.25, 0.5, 1.0])),
        # The three inputs of a motor share one reference and supply.
        channel_k=float(own.uniform(0.05, 0.3)),
        duty=str(own.choice(list(DUTIES))),
    )


def _lagged(x: Array, lag_s: float) -> Array:
    """Apply a first-order lag along the first axis, started at the first value."""
    keep = np.exp(-1.0 / lag_s)
    start = keep * x[:1]
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], x, axis=0, zi=start)[0])


def _duty(rng: Rng, duty: str, steps: int) -> tuple[Array, Array, Array]:
    """Torque Nm, rotor speed rad/s and direction +-1, (L,) each: legs between stops."""
    shortest, longest, stop_s, pull = DUTIES[duty]
    # Load depends on the hour of the day: trains are light at night and full in the peak.
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
    """Air (L, M) degC at the motors, and (L,) in the open: season, gusts, sun and tunnels."""
    season = rng.uniform(-10.0, 32.0)
    open_air = season + 0.5 * wandering(rng, (steps,), 1200.0)
    tunnel = np.zeros(steps, dtype=np.bool_)
    for _ in range(int(rng.integers(0, 5))):
        at = int(rng.integers(0, steps))
        tunnel[at : at + int(rng.uniform(30.0, 600.0))] = True
    # A tunnel has the mean of the year, about 14 degC; the train brings in half of the air.
    ambient = _lagged(np.where(tunnel, 0.5 * open_air + 0.5 * 14.0, open_air), 20.0)
    clear = np.clip(0.5 + wandering(rng, (steps,), 1500.0), 0.0, 1.0) * rng.choice([0.0, 1.0])
    # Ballast and frame on the sunny side are up to 3 K warmer; this changes within minutes.
    sun = _lagged(3.0 * clear * ~tunnel, 300.0)[:, None] * t.side
    draught = 0.5 * wandering(rng, (steps, len(t.side)), 900.0)
    return ambient[:, None] + sun + draught, ambient


def _slow_errors(rng: Rng, t: Train, steps: int) -> Array:
    """Errors (L, M, 3) of healthy sensors, K: drift, and the part that a channel shares."""
    motors = len(t.side)
    # Self-heating and thermal voltages: a fifth of a kelvin in an hour.
    drift = 0.15 * wandering(rng, (steps, motors, 3), 3600.0)
    channel = t.channel_k * wandering(rng, (steps, motors), 600.0)
    return np.asarray(drift + channel[:, :, None])


def _flows(
    rng: Rng, t: Train, truth: tuple[Array, Array, Array, Array]
) -> tuple[Array, Array, Array, Array]:
    """Arguments of `warm` for healthy motors: heat, copper loss, cooling, air."""
    square, speed, way, air = truth
    steps, motors = square.shape
    flows, cooling = np.zeros((steps, motors, 8)), np.empty((steps, motors, 8))
    copper = 1.5 * TRACTION_350KW.R_s * square
    # Iron: hysteresis and eddies, power 1.5 of speed; the magnets' part is in the rotor. Ripple of
    # the inverter adds a tenth of the copper loss below the speed where its pulse pattern changes.
    iron = 0.75 * speed[:, None] ** 1.5 * t.iron
    ripple = 0.1 * copper * (speed < 180.0)[:, None]
    flows[:, :, heat.CORE], flows[:, :, heat.ROTOR] = (
        0.8 * iron + 0.5 * ripple,
        0.2 * iron + 0.5 * ripple,
    )
    friction = (
        speed[:, None, None] * t.rub * (1.0 + 0.04 * wandering(rng, (steps, motors, 2), 900.0))
    )
    flows[:, :, [heat.DRIVE_END, heat.OTHER_END]] = friction
    flows[:, :, heat.GEARBOX] = 1.2 * speed[:, None]
    fan = speed[:, None] ** 0.8 * (1.0 + way[:, None] * t.direction)
    fan = fan * (1.0 + 0.02 * wandering(rng, (steps, motors), 900.0))
    cooling[:] = heat.STILL + heat.MOVING * fan[:, :, None]
    return flows, copper, cooling, air


def _felt(t: Train, true: Array) -> Array:
    """Temperatures (L, M, 3) degC after the lag of the sensors."""
    out = np.empty_like(true)
    for q, lag in enumerate(t.sensor_lag_s.tolist()):
        out[:, :, q] = _lagged(true[:, :, q], lag)
    return out


def _effect(
    rng: Rng, t: Train, base: Base, wrong: Fault, truth: tuple[Array, Array, Array, Array]
) -> Array:
    """Effect (L, M, 3) of the fault on the readings, K."""
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
    """Temperatures (L, 1, 3) degC of the faulty motor.

    amount: W, or the lost share of the air, or 200 times the added share of the resistance.
    """
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
