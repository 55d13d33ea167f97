"""A train whose speed is held whatever load it carries: a second world to judge detectors in.

It is independent of `sim/physics/plant.py` and has no mechanics. The rotor turns at a given speed,
as under an ideally stiff control. At every instant the motor's torque equals the load that the
wheel carries; flux, current and voltage follow in closed form:

    i_q = T / (k_p p psi),  i_d = 0;    psi_s = (L i + psi) e^(j theta)
    mean u over a period = R mean i + (psi_s at its end - psi_s at its begin) / dt

Losses have edges of 1 to 8 ms. Sensors, messages and truth are the simulator's. The kinds differ
in how many drives lose adhesion, of how many, with or without `Status` (and so a torque command)
on the bus, and in the healthy time before. Nothing is tuned on this world.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.arrays import Array
from dbc.codec import Codec
from dbc.frames import Block
from gateway.study.scenarios_random import PerUnit, between, sign
from sim.drive_spread import Variety
from sim.faults import Schedule
from sim.physics import plant as columns
from sim.physics.plant import DT, OUT, Plant
from sim.profile import Profile
from sim.scenario import Scenario, parse
from sim.simulation import GRID, Simulation, start_angles

Phasors = NDArray[np.complex128]
TICKS_PER_S: Final = 100
STREAM: Final = 31
RAMP_S: Final = (0.001, 0.008)
LENGTH_S: Final = (0.2, 2.0)
DEPTH: Final = (0.2, 1.0)
TAIL_S: Final = 0.8
STATUS: Final = range(0x1C1, 0x1D1)


def periods(scenario: Scenario) -> int:
    """Number of periods of 125 us in a run, in whole steps of 10 ms."""
    return round(scenario.duration_s * TICKS_PER_S) * GRID


class Played(Plant):
    """A plant under preset load that only plays back rows computed elsewhere."""

    def __init__(self, scenario: Scenario, rows: Array) -> None:
        """Keep `rows` (n, N, 10): columns `plant.OUT` at the end of each period of 125 us."""
        motor = scenario.motor.machine
        still = np.zeros(rows.shape[1])
        super().__init__(motor, still, on_rail=False, w_0=0.0, load_0=0.0)
        self._rows = rows
        self._at = 0

    def advance(self, w_ref: Array, *_others: object) -> Array:
        """The next rows, as many as `w_ref` has. Raises ValueError after the last one."""
        first, self._at = self._at, self._at + len(w_ref)
        if self._at > len(self._rows):
            msg = f"{len(self._rows)} rows played, and the run goes on"
            raise ValueError(msg)
        return self._rows[first : self._at]


class OtherMachine(Simulation):
    """The simulated train with given waveforms in place of its machines."""

    def __init__(self, scenario: Scenario, codec: Codec, rows: Array) -> None:
        """`rows` as in `Played`, for at least `periods(scenario)`."""
        super().__init__(scenario, codec)
        self._plant = Played(scenario, rows)


class Kind(NamedTuple):
    """One kind of run. lost: how many of `drives` lose, None for all; commands: with `Status`."""

    title: str
    drives: int
    lost: int | None
    commands: bool
    onset_s: tuple[float, float] = (0.75, 1.5)
    rough: bool = False
    healthy: bool = False


KINDS: Final = {
    "one": Kind("one of three", 3, 1, commands=True),
    "one_mute": Kind("one of three, no command", 3, 1, commands=False),
    "majority": Kind("two of three, no command", 3, 2, commands=False),
    "majority_late": Kind("the same after 2.5 s", 3, 2, commands=False, onset_s=(2.5, 3.2)),
    "two": Kind("one of two, no command", 2, 1, commands=False),
    "two_commands": Kind("one of two", 2, 1, commands=True),
    "twelve": Kind("four of twelve, no command", 12, 4, commands=False),
    "rough": Kind("one of three, rough", 3, 1, commands=True, onset_s=(2.5, 3.2), rough=True),
    "rough_mute": Kind(
        "one of three, rough, no command", 3, 1, commands=False, onset_s=(2.5, 3.2), rough=True
    ),
    "all": Kind("all of three", 3, None, commands=True),
    "healthy": Kind("nothing lost, load steps", 3, 0, commands=True, healthy=True),
    "healthy_mute": Kind(
        "nothing lost, load steps, no command", 3, 0, commands=False, healthy=True
    ),
}


def draw(name: str, seed: int, motor: str = "bench") -> Scenario:
    """The run of this kind and seed. Raises KeyError for an unknown kind."""
    kind = KINDS[name]
    rng = np.random.default_rng([seed, STREAM, list(KINDS).index(name)])
    unit = PerUnit(motor)
    speed, load = between(rng, unit.speed, 3) * sign(rng), between(rng, (8.0, 30.0)) * sign(rng)
    at = between(rng, kind.onset_s)
    drives = kind.drives
    who = range(drives) if kind.lost is None else rng.choice(drives, kind.lost, replace=False)
    length, depth, all_lose = between(rng, LENGTH_S), between(rng, DEPTH), kind.lost is None
    events: list[dict[str, Any]] = [
        {
            "at_s": round(at + (0.0 if all_lose else between(rng, (0.0, 0.03))), 4),
            "for_s": length if all_lose else between(rng, LENGTH_S),
            "drive": int(d) + 1, "kind": "adhesion_loss",
            "depth": depth if all_lose else between(rng, DEPTH), "ramp_s": between(rng, RAMP_S),
        }
        for d in who
    ]  # fmt: skip
    end = max((e["at_s"] + e["for_s"] for e in events), default=6.0) + TAIL_S
    # The train's demand: it stays, changes slowly, or (healthy) steps now and then.
    profile = [[0.0, unit.nm(load)]]
    if kind.healthy:
        while profile[-1][0] < end - 1.0:
            step = between(rng, (0.01, 0.5))
            begin = profile[-1][0] + between(rng, (0.3, 1.0))
            level = unit.nm(between(rng, (-28.0, 28.0)))
            profile += [[round(begin, 4), profile[-1][1]], [round(begin + step, 4), level]]
    elif rng.random() < 0.5:
        profile.append([round(end, 4), round(profile[0][1] * between(rng, (0.7, 1.3)), 4)])
    table: dict[str, Any] = {
        "title": f"held, {name} {seed}", "seed": seed, "drives": drives,
        "duration_s": round(end, 4), "motor": {"name": motor}, "motion": {"speed": speed},
        "load": {"kind": "preset", "profile": profile, "transition": "linear"}
        if len(profile) > 1
        else {"kind": "preset", "torque_nm": profile[0][1]},
        "sensors": {"current_noise_var": unit.noise(1e-2 if kind.rough else 2e-4)},
        "event": events,
    }  # fmt: skip
    if kind.rough:
        table["load"]["share_within"] = 0.1
        table["mismatch"] = {"R_s_within": 0.2, "L_s_within": 0.05, "psi_pm_within": 0.03}
        table["sensors"]["current_offset_within_a"] = unit.amps(0.1)
        events.append({"at_s": 0.0, "kind": "frame_loss", "depth": 0.01})
    if drives > 4 or not kind.commands:
        table["bus"] = {"bitrate": 0}
    return parse(table, table["title"])


def waveforms(scenario: Scenario) -> Array:
    """Rows (n, N, 10) of a whole run, columns `sim.physics.plant.OUT`."""
    variety, (w_ref, _, demand), carried = courses(scenario, periods(scenario) + 1)
    load = demand[:, None] * variety.share(0.0) * carried
    return electrical(scenario, variety, w_ref[:, None] / variety.p.wheel, load, load, demand)


def courses(scenario: Scenario, n: int) -> tuple[Variety, tuple[Array, Array, Array], Array]:
    """Drives of a run, `Profile.at` and (n, N) share that the rail carries at n instants."""
    motor = scenario.motor.machine
    t_s: Array = DT * np.arange(n, dtype=np.float64)
    profile = Profile(scenario, motor.pole_pairs).at(t_s)
    return Variety(scenario, motor), profile, Schedule(scenario, motor).carry(t_s, profile[2])


def electrical(
    scenario: Scenario, variety: Variety, speed: Array, torque: Array, load: Array, demand: Array
) -> Array:
    """Rows (n, N, 10) of machines with these speeds, rad/s, and torques, Nm, (n + 1, N).

    load (n + 1, N): carried by their wheels, Nm; demand (n + 1,): torque asked of each, Nm.
    """
    motor, p = scenario.motor.machine, variety.p
    turned = DT * np.cumsum(0.5 * (speed[1:] + speed[:-1]), axis=0)
    out = np.empty((len(turned), scenario.drives, OUT))
    for d, theta_0 in enumerate(start_angles(scenario).tolist()):
        theta = theta_0 + motor.pole_pairs * np.concatenate([[0.0], turned[:, d]])
        i_q = torque[:, d] / (motor.k_p * motor.pole_pairs * p.psi_pm[d])
        current, voltage = phasors(p[d], theta, i_q, DT)
        row = out[:, d]
        row[:, columns.I_ALPHA], row[:, columns.I_BETA] = current.real, current.imag
        row[:, columns.U_ALPHA], row[:, columns.U_BETA] = voltage.real, voltage.imag
        row[:, columns.U_DC] = motor.U_dc
        row[:, columns.TORQUE], row[:, columns.LOAD] = torque[1:, d], load[1:, d]
        row[:, columns.SPEED] = speed[1:, d]
        row[:, columns.ANGLE] = theta[1:] % (2.0 * np.pi)
        row[:, columns.COMMAND] = demand[1:]
    return out


def phasors(motor: Any, theta: Array, i_q: Array, period_s: float) -> tuple[Phasors, Phasors]:
    """Current, A, at the end of each period and mean voltage, V, over it, stationary frame.

    theta electrical rad, i_q A, (n + 1,): at the ends of the periods, and at the start.
    """
    along = np.exp(1j * theta)
    current = 1j * i_q * along
    flux = motor.L_s * current + motor.psi_pm * along
    voltage = motor.R_s * 0.5 * (current[1:] + current[:-1]) + np.diff(flux) / period_s
    return current[1:], voltage


def without_status(block: Block) -> Block:
    """The block without `Status`, as if no drive sent its torque command."""
    return block.pick(~np.isin(block.can_id, list(STATUS)))
