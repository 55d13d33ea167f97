"""Section 5 of paper `adhesion` on the simulator: the plant alone, and its frames in a log.

Both have the same start angles and the same loads, and the same noise where a path without a bus
takes the same samples as a bus.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.arrays import Array
from dbc.codec import Codec, bind
from gateway.core.codes import Health
from gateway.io.whole_file import whole
from gateway.reports.figures import Span
from gateway.settings.config import load, shipped_dbc
from gateway.study import reproduction as table_1
from gateway.study import reproduction_loads as bench
from gateway.study.reproduction_loads import Filter, Record
from gateway.study.reproduction_paths import Course
from gateway.study.reproduction_report import StandingStart
from sim.drive_spread import Variety
from sim.faults import Schedule
from sim.physics import plant as columns
from sim.physics.plant import MOTORS, Plant, rail_array
from sim.physics.sensors import CurrentSensors
from sim.profile import Profile
from sim.scenario import Scenario
from sim.scenario_schema import Motion
from sim.simulation import PERIOD_NS, Simulation, start_angles

NAME: Final = "paper_section5"
SLOW: Final = 16
"""Periods of 125 us in the 2 ms of the classic bus."""
STANDING_S: Final = 0.5
RAMP_S: Final = 0.25


class Bus(NamedTuple):
    """A bus: name of its way in the comparison, DBC, ticks per second (one per sample or frame)."""

    way: str
    dbc: str
    rate_hz: int

    @property
    def log(self) -> str:
        """File name of the log."""
        return f"section5_{self.way.split()[0].lower()}.log"


BUSES: Final = (Bus("FD bus", "traction_fd.dbc", 1000), Bus("classic bus", "traction.dbc", 500))


class World(NamedTuple):
    """The truth: rows (T, N, 10) of the plant, one per 125 us; start (N, 5) true state at t = 0."""

    scenario: Scenario
    rows: Array
    start: Array

    @property
    def t_ns(self) -> NDArray[np.int64]:
        """Time of each row."""
        return np.arange(1, len(self.rows) + 1, dtype=np.int64) * PERIOD_NS

    @property
    def t_s(self) -> Array:
        """Time of each row, s."""
        return np.asarray(self.t_ns * 1e-9, dtype=np.float64)

    @property
    def load(self) -> Array:
        """True load (T, N), Nm."""
        return self.rows[..., columns.LOAD]

    @property
    def speed(self) -> Array:
        """True speed (T, N), electrical rad/s."""
        return self.rows[..., columns.SPEED] * MOTORS[self.scenario.motor.name].pole_pairs


def simulate(scenario: Scenario) -> World:
    """Simulate the plant of a preset-load scenario without a bus, as `sim.Simulation` does."""
    motor = MOTORS[scenario.motor.name]
    n = scenario.drives
    count = round(scenario.duration_s * 1e9) // PERIOD_NS
    t_s = np.arange(count, dtype=np.float64) * (PERIOD_NS * 1e-9)
    schedule, profile = Schedule(scenario, motor), Profile(scenario, motor.pole_pairs)
    w_ref, w_acc, load = profile.at(t_s)
    rolling = scenario.motion.start == "rolling"
    plant = Plant(
        motor,
        start_angles(scenario),
        on_rail=False,
        w_0=w_ref[0] if rolling else 0.0,
        load_0=load[0],
        p=Variety(scenario, motor).p,
    )
    start = np.zeros((n, 5))
    start[:, 2] = motor.pole_pairs * plant.drives.w_m
    start[:, 3] = plant.drives.theta_e
    start[:, 4] = load[0]
    cut = np.zeros((len(t_s), n), dtype=np.bool_)
    rails = np.repeat(rail_array(schedule.rails(0.0))[None], len(t_s), axis=0)
    rows = plant.advance(w_ref, w_acc, load, schedule.carry(t_s, load), cut, rails)
    return World(scenario, rows, start)


def measure(world: World, every: int, phases: int, steps: tuple[float, float]) -> Record:
    """Sample every `every` periods, from `phases` currents; steps (A, V) of rounding, 0 for none.

    The noise equals that of the bus that takes the same samples: the sensors draw per sample.
    """
    sensors, n = world.scenario.sensors, world.scenario.drives
    noise = CurrentSensors(
        world.scenario.seed, n, sensors.current_noise_var, 0.0, 1.0, sensors.current_range_a
    )
    count = len(world.rows) // every
    whole = world.rows[: count * every].reshape(count, every, n, -1)
    volts = whole[..., columns.U_ALPHA : columns.U_BETA + 1].mean(axis=1)
    amps = noise.read(whole[:, -1, :, columns.I_ALPHA : columns.I_BETA + 1])
    return bench.record(volts, amps[..., :phases], every, *steps)


def without_bus(world: World) -> list[Course]:
    """Loads of the ways without a bus, by the paper's and the product's filter."""
    exact = (0.0, 0.0)
    ways = (
        ("8 kHz", 1, 2, exact),
        ("8 kHz, rounded", 1, 2, wire_steps(BUSES[0])),
        ("2 ms", SLOW, 3, exact),
        ("2 ms, rounded", SLOW, 3, wire_steps(BUSES[1])),
    )
    courses = []
    for way, every, phases, steps in ways:
        samples = measure(world, every, phases, steps)
        t_ns = world.t_ns[every - 1 :: every]
        for belief in (bench.PAPER, bench.PRODUCT):
            load = bench.estimate(samples, belief, *bench.unit_start(world.start)).load
            courses.append(Course(way, belief.name, t_ns, load))
    return courses


@cache
def _codec(dbc: str) -> Codec:
    """A shipped DBC bound for the drives of the default configuration."""
    return bind(shipped_dbc(dbc), load(None).nodes)


def wire_steps(bus: Bus) -> tuple[float, float]:
    """Resolution of currents (A) and voltages (V) in the messages of a bus."""
    codec = _codec(bus.dbc)
    names = ("Ia", "Ualpha", "Ia_0", "Ualpha_0")
    specs = [codec.by_name[f"Drive1_{m}"] for m in ("PhaseCurrents", "StatorVoltages", "Samples")
             if f"Drive1_{m}" in codec.by_name]  # fmt: skip
    amps, volts = (s.scale for spec in specs for s in spec.signals if s.name in names)
    return amps, volts


def write_log(scenario: Scenario, bus: Bus, path: Path) -> None:
    """Write the drives' frames as a candump log, as `sim` does. Raises OSError."""
    from dbc.candump.writer import Writer

    simulation = Simulation(scenario, _codec(bus.dbc))
    with whole(path) as part, Writer(part, "vcan0") as writer:
        for tick in range(round(scenario.duration_s * 100) + 1):
            for frame in simulation.step((), tick * 10_000_000):
                writer.write(frame)


def replay_log(path: Path, bus: Bus, belief: Filter) -> Course:
    """Replay a log: loads of tracked drives at the gateway's ticks, NaN where not known."""
    from gateway.core.gateway import Gateway
    from gateway.io.log_file import OneChannel, open_log
    from gateway.io.replay import replay

    noise = {"process_noise": belief.Q, "current_noise_var": belief.R}
    config = load(None, dbc={"file": bus.dbc}, loop={"rate_hz": bus.rate_hz}, estimator=noise)
    codec = _codec(bus.dbc)
    t_ns: list[int] = []
    loads: list[list[float]] = []

    def sink(now: int, _out: list[Any], gateway: Gateway) -> None:
        assert gateway.view is not None
        t_ns.append(now)
        loads.append(
            [
                d.load_nm if d.health is Health.TRACKING and d.load_nm is not None else np.nan
                for d in gateway.view.drives
            ]
        )

    blocks = OneChannel(open_log(path, strict=True).blocks, None)
    replay(blocks, lambda start: Gateway(config, codec, start), config.loop.period_ns, sink)
    return Course(bus.way, belief.name, np.array(t_ns), np.array(loads))


def locked(speed: Array, world: World) -> tuple[bool, ...]:
    """For each drive, whether a filter's speed (T, N) ends within 10 rad/s of the true one."""
    return tuple((np.abs(speed[-1] - world.speed[-1]) < 10.0).tolist())


def standing(scenario: Scenario, seed: int) -> World:
    """Simulate the same loads for `STANDING_S`, from standstill to speed within `RAMP_S`."""
    speed = scenario.motion.speed
    motion = Motion(start="standstill", profile=[(0.0, 0.0), (RAMP_S, speed)])
    return simulate(
        scenario.model_copy(update={"seed": seed, "motion": motion, "duration_s": STANDING_S})
    )


def standing_start(scenario: Scenario, seed: int) -> StandingStart:
    """Start the paper's filter at zero on a standing train; errors by the median method."""
    world = standing(scenario, seed)
    samples = measure(world, 1, 2, (0.0, 0.0))
    found = bench.estimate(samples, bench.PAPER, *bench.unit_start(np.zeros_like(world.start)))
    difference = table_1.differences(found.load)["median"]
    most: list[float] = difference.max(axis=0).tolist()
    return StandingStart(seed, locked(found.speed, world), tuple(most))


def spans(scenario: Scenario) -> list[Span]:
    """Intervals in which drives lose load, for shading."""
    out = [
        Span(e.at_s, e.end_s, d, "lost")
        for e in scenario.event
        for d in scenario.drives_of(e.drive)
    ]
    out += [Span(d.at_s, d.at_s + d.for_s, d.drive, "part") for d in scenario.load.disturbance]
    return [s for s in out if s.start_s < scenario.duration_s]
