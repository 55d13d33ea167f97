"""`python -m bench.real_wheels`: a robot's driven wheels, judged by the whole gateway.

Three omnidirectional wheels; currents, set and actual speeds every 31 ms (tests/data/README.md).
`--terrain`: a vehicle of four wheels on asphalt and on ice; current and speed of its two sides at
6.5 Hz. Each wheel, or side, becomes a drive: its speed is the rotor's, its current over RATED_A the
torque over the rated one, and phase currents and voltages follow in closed form, as in
`held_world`. So the machine is ours; what the wheels carry, how fast they turn, and all the
noise of it, are real.
"""

from __future__ import annotations

import argparse
import csv
import gzip
import math
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import uniform_filter1d

from dbc.arrays import Array, Flags, Ints
from dbc.codec import Codec, bind
from dbc.e2e import protect
from dbc.frame import MS, SECOND, Frame
from gateway.core.codes import Flag
from gateway.core.gateway import Gateway
from gateway.settings.config import BENCH_MOTOR, Config, parse
from gateway.study.held_world import phasors

DATA: Final = Path(__file__).parents[1] / "tests" / "data" / "wheels" / "robot.csv.gz"
TERRAIN: Final = DATA.parent / "terrain"
TERRAIN_A: Final = 15.0
"""Taken for the rated current of a side of the vehicle; the most seen is 22 A."""
RAD_PER_M: Final = 40.0
"""Of a rotor, for a metre that its side rolls: gears and wheels are not known. 31 rad/s at most."""
TURNS_RAD_S: Final = 5.0
"""Of both rotors, from which on the vehicle is taken to drive."""
STRAIGHT: Final = 0.05
"""Difference of the rotors' speeds, of the faster one, up to which it drives straight."""
RATED_A: Final = 3.0
"""Taken for the motors' rated current, which the source does not give; the most seen is 2.9 A."""
INERTIA_KG_M2: Final = 0.005
"""Of a rotor; small, so that the load is the motor's torque."""
PERIOD_S: Final = 2e-3
SPEED_SAMPLES: Final = 7
"""A wheel's speed is a count of ticks in 31 ms, 2.8 rad/s each: mean of so many, 0.2 s."""
CURRENT_SAMPLES: Final = 3
DRIVEN: Final = 1.0
"""rad/s of set speed from which on a wheel is driven; the third of a straight run rolls along."""
ALIKE: Final = 1.05
"""Set speeds within this factor: the wheels turn alike, as those of a train do."""
ON_DRAG_A: Final = 0.6
"""Mean current of a wheel from which on the floor drags; on the table it is 0.2 to 0.35 A."""
SKIP_S: Final = 1.5
"""Left out at the start: the robot speeds up."""


class Run(NamedTuple):
    """A recording: t_s (T,); of driven wheels (T, N) set speed and speed in rad/s, current in A.

    effort (T, N): the current with the sign of the torque, its noise as far as it is used.
    """

    name: str
    t_s: Array
    wanted: Array
    speed: Array
    current: Array
    effort: Array

    @property
    def straight(self) -> bool:
        """Whether all driven wheels turn alike."""
        middle = np.abs(self.wanted[len(self.wanted) // 2])
        return bool(middle.max() <= ALIKE * middle.min())


@cache
def runs() -> dict[str, Run]:
    rows: dict[str, list[list[float]]] = {}
    with gzip.open(DATA, "rt", encoding="utf-8", newline="") as file:
        for name, *numbers in list(csv.reader(file))[1:]:
            rows.setdefault(name, []).append([float(x or "nan") for x in numbers])
    return {name: _run(name, np.array(table)) for name, table in rows.items()}


def _run(name: str, table: Array) -> Run:
    table = table[np.isfinite(table).all(axis=1)]
    table = table[np.concatenate([[True], np.diff(table[:, 0]) > 0.0])]
    wanted, speed, current = table[:, 1:4], table[:, 4:7], np.abs(table[:, 7:10])
    driven = np.abs(wanted[len(wanted) // 2]) >= DRIVEN
    t_s = (table[:, 0] - table[0, 0]) / 1e3
    wanted, speed, current = wanted[:, driven], speed[:, driven], current[:, driven]
    return Run(
        name, t_s, wanted, uniform_filter1d(speed, SPEED_SAMPLES, axis=0), current,
        np.sign(wanted[len(wanted) // 2]) * uniform_filter1d(current, CURRENT_SAMPLES, axis=0),
    )  # fmt: skip


def frames(run: Run, codec: Codec, rated_a: float = RATED_A) -> list[Frame]:
    """What the drives would send: currents and voltages every 2 ms, `Motion` every 10 ms."""
    t = np.arange(0.0, run.t_s[-1], PERIOD_S)
    out: list[Frame] = []
    for k in range(run.speed.shape[1]):
        w = CubicSpline(run.t_s, run.speed[:, k])
        i_q = np.interp(t, run.t_s, run.effort[:, k]) / rated_a * BENCH_MOTOR.I_rated
        theta = BENCH_MOTOR.pole_pairs * w.antiderivative()(t) + k
        out += _drive(k + 1, codec, t, (theta, w(t), i_q))
    return sorted(out, key=lambda frame: frame.t_ns)


@cache
def terrain() -> dict[str, Run]:
    """All recordings of the vehicle, by name. Its currents have no sign: that of the speed."""
    found = {}
    for path in sorted(TERRAIN.glob("*.csv.gz")):
        with gzip.open(path, "rt", encoding="utf-8", newline="") as file:
            table = np.array([[float(x) for x in row] for row in list(csv.reader(file))[1:]])
        speed, current = RAD_PER_M * table[:, 3:], table[:, 1:3]
        name = path.name.partition(".")[0]
        effort = np.sign(speed) * current
        found[name] = Run(name, table[:, 0] - table[0, 0], speed, speed, current, effort)
    return found


def drives_straight(run: Run) -> Flags:
    """(ticks,): both sides turn, and alike."""
    t_s = 0.01 * np.arange(1, round(run.t_s[-1] * 100.0))
    left, right = (np.abs(np.interp(t_s, run.t_s, run.speed[:, k])) for k in (0, 1))
    faster, slower = np.maximum(left, right), np.minimum(left, right)
    return np.asarray((slower > TURNS_RAD_S) & (faster - slower <= STRAIGHT * faster))


def terrain_line(name: str) -> str:
    """The row of one recording of the vehicle in docs/real_wheels.md."""
    run = terrain()[name]
    flags, straight = judge(run, TERRAIN_A), drives_straight(run)
    seconds = np.count_nonzero(straight) / 100.0
    return f"| {name} | {seconds:.0f} s | {shares(flags[straight].ravel())} |"


def _drive(node: int, codec: Codec, t: Array, motion: tuple[Array, Array, Array]) -> list[Frame]:
    theta, w, i_q = motion
    out = []
    pairs = zip(*phasors(BENCH_MOTOR, theta, i_q, PERIOD_S), strict=True)
    for n, (i, u) in enumerate(pairs, 1):
        b = -0.5 * i.real + math.sqrt(0.75) * i.imag
        t_ns = round(t[n] * SECOND) + node * 7000
        sent = {
            "PhaseCurrents": {"Ia": i.real, "Ib": b, "Ic": -i.real - b},
            "StatorVoltages": {"Ualpha": u.real, "Ubeta": u.imag, "Udc": 540.0},
        }
        if n % 5 == 0:
            sent["Motion"] = {
                "ElectricalAngle": math.degrees(theta[n]) % 360.0,
                "Speed": w[n] * 30.0 / math.pi,
                "Torque": BENCH_MOTOR.torque_nm / BENCH_MOTOR.I_rated * i_q[n],
            }
        for kind, values in sent.items():
            spec = codec.by_name[f"Drive{node}_{kind}"]
            payload = codec.encode(spec, {"Quality": 1, **values})
            protect(spec, payload, n // (5 if kind == "Motion" else 1))
            out.append(Frame(t_ns, spec.can_id, bytes(payload), 0, "vcan0"))
    return out


def config_of(run: Run) -> Config:
    """A drive for each wheel, or side."""
    motor = {**BENCH_MOTOR.model_dump(), "J": INERTIA_KG_M2}
    nodes = range(1, run.speed.shape[1] + 1)
    return parse({
        "motor": {"robot": motor}, "drive": [{"node": n, "motor": "robot"} for n in nodes],
    })  # fmt: skip


def judge(run: Run, rated_a: float = RATED_A) -> Ints:
    """Flags of adhesion (ticks, N), one a tick of 10 ms."""
    config = config_of(run)
    codec = bind(config.dbc_path, config.nodes)
    gateway, waiting, flags, at = Gateway(config, codec, 0), frames(run, codec, rated_a), [], 0
    for tick in range(1, round(run.t_s[-1] * 100.0)):
        now, first = tick * 10 * MS, at
        while at < len(waiting) and waiting[at].t_ns <= now:
            at += 1
        gateway.step(waiting[first:at], now)
        assert gateway.view is not None
        flags.append([int(drive.adhesion) for drive in gateway.view.drives])
    return np.array(flags)


def on_drag(run: Run) -> Flags:
    """(ticks, N): which wheels are on the floor that drags, by their current over half a second."""
    mean = uniform_filter1d(run.current, 16, axis=0) > ON_DRAG_A
    at = np.searchsorted(run.t_s, 0.01 * np.arange(1, round(run.t_s[-1] * 100.0))) - 1
    return np.asarray(mean[at])


def shares(flags: Ints) -> str:
    """Lost, adhering, unknown, in percent of these flags."""
    if not flags.size:
        return "- | - | -"
    each = (Flag.BAD, Flag.GOOD, Flag.UNKNOWN)
    return " | ".join(f"{100.0 * np.mean(flags == one):.1f}" for one in each)


def groups() -> dict[str, list[str]]:
    """Recordings by what is to be seen in them."""
    table = [name for name in runs() if name.startswith("table")]
    return {
        "table, unlike speeds": [name for name in table if not runs()[name].straight],
        "table, straight": [name for name in table if runs()[name].straight],
        "onto another floor": [name for name in runs() if name.startswith("green")],
    }


def lines(rated_a: float) -> list[str]:
    """The tables of docs/real_wheels.md."""
    out = [
        "| recordings | wheels | lost % | adhering % | unknown % |",
        "| --- | --- | --- | --- | --- |",
    ]
    for title, names in groups().items():
        found: dict[str, list[Ints]] = {}
        for name in names:
            run = runs()[name]
            flags, drag = judge(run, rated_a), on_drag(run)
            started = np.arange(len(flags)) * 0.01 >= SKIP_S
            some = started & drag.any(axis=1) & ~drag.all(axis=1)
            found.setdefault("none drags", []).append(flags[started & ~drag.any(axis=1)].ravel())
            found.setdefault("one drags: that one", []).append(flags[some][drag[some]])
            found.setdefault("one drags: the other", []).append(flags[some][~drag[some]])
            found.setdefault("all drag", []).append(flags[started & drag.all(axis=1)].ravel())
        out += [
            f"| {title}, {len(names)} | {who}, {len(each) / 100:.0f} s | {shares(each)} |"
            for who, parts in found.items()
            if len(each := np.concatenate(parts))
        ]
    return out


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("--terrain", action="store_true", help="the vehicle, not the robot")
    parser.add_argument("--rated-a", type=float, nargs="+", default=[RATED_A])
    options = parser.parse_args(arguments)
    if options.terrain:
        head = ["| recording | straight | lost % | adhering % | unknown % |", f"|{' --- |' * 5}"]
        print("\n".join([*head, *map(terrain_line, terrain())]))
        return 0
    for rated_a in options.rated_a:
        print(f"Rated current {rated_a:g} A\n")
        print("\n".join(lines(rated_a)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
