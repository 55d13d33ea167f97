"""Families of random runs on which detectors are evaluated, each a pure function of the seed.

Each family tests something different; ranges are the bench motor's and scale to others per unit.
Two sets of seeds: thresholds may be tuned on `DEVELOPMENT`; `REPORTING` is not looked at before
reporting.

May know: scenarios. May not know: any detector.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np

from gateway.study.scenarios_groups import (
    MISMATCHES,
    OPEN_AT_S,
    SLIP_LENGTH_S,
    Mismatch,
    braked,
    slipping,
)
from gateway.study.scenarios_random import (
    DEPTH,
    LENGTH_S,
    LOAD_NM,
    ONSET_S,
    RAMP_S,
    TAIL_S,
    PerUnit,
    between,
    random_scenario,
    sign,
)
from sim.physics.plant import BENCH, MOTORS, TRAIN, TRAINS
from sim.scenario import Scenario, parse

DEVELOPMENT: Final = range(30)
"""Seeds that anything may be tuned on."""
REPORTING: Final = range(1000, 1060)
"""Seeds that are not looked at before reporting."""

STREAM: Final = 21
"""Purpose of the random streams; the family's number follows."""
GROUP_STREAM: Final = 1000
ON_IT: Final = {"drive": 1}
Table = dict[str, Any]
Rng = np.random.Generator

QUIET_VAR: Final = 2e-4
"""Noise of a clean sensor on the bench motor, A^2."""
ROUGH_VAR: Final = 1e-2
ROUGH_OFFSET_A: Final = 0.1
ROUGH: Final[Table] = {"R_s_within": 0.2, "L_s_within": 0.05, "psi_pm_within": 0.03}
ROUGH_SHARE: Final = 0.1
ROUGH_LOST: Final = 0.01
ROUGH_ONSET_S: Final = (2.5, 3.5)
BUS_DRIVES: Final = 4
"""Most drives that fit onto 1 Mbit/s; with more the bus has no bit rate, like a log or vcan."""
HARD_S: Final = 20.0
HARD_NM: Final = 28.0
"""The driver's limit of effort: dry rail carries 29 Nm at 60 m/s and 39 Nm at 10 m/s."""
BRAKE_AT_S: Final = 0.3
BRAKE: Final = 6.4
"""Hardest change of speed, over the one at rated torque: an emergency brake of 1.4 m/s^2 for the
train of the 350 kW motor. The bench motor's ranges stay far below it."""
WET_NM: Final = 20.0
"""Load that wet rail (friction 0.3) carries on the bench."""


class Family(NamedTuple):
    """One kind of random run. `common`: all drives lose adhesion together."""

    title: str
    make: Callable[[int, Rng, PerUnit], Scenario]
    common: bool = False
    healthy: bool = False
    motor: str | None = None
    """The family's own motor, used whatever motor is asked for."""


def draw(family: str, seed: int, motor: str = "bench") -> Scenario:
    """The scenario of this family and seed. Raises KeyError for an unknown family or motor."""
    chosen = ALL[family]
    # The families of a group share one stream: their runs differ only in the group's subject.
    groups = [name for name, group in GROUPS.items() if family in group]
    number = GROUP_STREAM if groups else list(FAMILIES).index(family)
    rng = np.random.default_rng([seed, STREAM, number])
    return chosen.make(seed, rng, PerUnit(chosen.motor or motor))


def _loss(rng: Rng, drive: int, at_s: float, length: tuple[float, float] = LENGTH_S) -> Table:
    return {
        "at_s": round(at_s, 4), "for_s": between(rng, length), "drive": drive,
        "kind": "adhesion_loss", "depth": between(rng, DEPTH),
        "ramp_s": between(rng, (0.0, RAMP_S)),
    }  # fmt: skip


def _run(what: str, seed: int, unit: PerUnit, table: Table) -> Scenario:
    """A scenario with the settings that all families share; ends `TAIL_S` after its last loss."""
    ends = [e["at_s"] + e["for_s"] for e in table.get("event", ()) if "for_s" in e]
    whole: Table = {
        "title": f"{what} {seed}", "seed": seed, "drives": 3,
        "duration_s": round(max(ends, default=0.0) + TAIL_S, 4), "motor": {"name": unit.name},
        "sensors": {"current_noise_var": unit.noise(QUIET_VAR)}, **table,
    }  # fmt: skip
    if whole["drives"] > BUS_DRIVES:
        whole["bus"] = {"bitrate": 0}
    return parse(whole, whole["title"])


def _steady(rng: Rng, unit: PerUnit) -> Table:
    """Constant speed and preset load, each of either sign."""
    speed = between(rng, unit.speed, 3) * sign(rng)
    load = unit.nm(between(rng, LOAD_NM) * sign(rng))
    return {"motion": {"speed": speed}, "load": {"kind": "preset", "torque_nm": load}}


def _single(seed: int, _rng: Rng, unit: PerUnit) -> Scenario:
    return random_scenario(seed, unit.name)


def _several(rng: Rng, unit: PerUnit, among: int, count: int) -> Table:
    """`count` of `among` drives lose adhesion within 50 ms, each with its own depth and length."""
    at = between(rng, ONSET_S)
    who = sorted(rng.choice(among, size=count, replace=False).tolist())
    events = [_loss(rng, int(d) + 1, at + between(rng, (0.0, 0.05))) for d in who]
    return {"drives": among, "event": events, **_steady(rng, unit)}


def _majority(seed: int, rng: Rng, unit: PerUnit) -> Scenario:
    drives = int(rng.integers(3, 7))
    count = int(rng.integers(drives // 2 + 1, drives))
    return _run("majority", seed, unit, _several(rng, unit, drives, count))


def _number(drives: int, seed: int, rng: Rng, unit: PerUnit) -> Scenario:
    count = int(rng.integers(1, max(drives // 2, 1) + 1))
    return _run(f"{drives} drives", seed, unit, _several(rng, unit, drives, count))


def _tenable(unit: PerUnit, bench_nm: float) -> float:
    """Acceleration, electrical rad/s^2, for which the train's mass takes `bench_nm`, scaled."""
    motor = MOTORS[unit.name]
    return motor.pole_pairs * unit.nm(bench_nm) / TRAINS.get(unit.name, TRAIN).inertia(motor)


def _hardest(unit: PerUnit) -> float:
    """Deceleration of the hardest brake, electrical rad/s^2."""
    return BRAKE * _tenable(unit, BENCH.T_rated)


def _braking(seed: int, rng: Rng, unit: PerUnit) -> Scenario:
    event = _loss(rng, int(rng.integers(1, 4)), between(rng, ONSET_S))
    low, high = unit.speed
    first, last = between(rng, (0.5 * (low + high), high)), between(rng, (low, 0.4 * high))
    forward = sign(rng)
    end = event["at_s"] + event["for_s"] + TAIL_S
    last = max(last, round(first - _hardest(unit) * (end - BRAKE_AT_S), 4))
    table = {
        "event": [event],
        "motion": {"profile": [[BRAKE_AT_S, forward * first], [round(end, 4), forward * last]]},
        "load": {"kind": "preset", "torque_nm": unit.nm(-forward * between(rng, LOAD_NM))},
    }
    return _run("braking", seed, unit, table)


def _gradual(seed: int, rng: Rng, unit: PerUnit) -> Scenario:
    event = _loss(rng, int(rng.integers(1, 4)), between(rng, ONSET_S), (1.0, 2.5))
    event["ramp_s"] = between(rng, (0.1, 0.4 * event["for_s"]))
    return _run("gradual", seed, unit, {"event": [event], **_steady(rng, unit)})


def _crawl(seed: int, rng: Rng, unit: PerUnit) -> Scenario:
    forward = sign(rng)
    start, rise = between(rng, (0.2, 0.6)), between(rng, (0.3, 1.0))
    top, hold = forward * between(rng, (3.0, 40.0)), between(rng, (1.5, 2.5))
    rise = max(rise, round(abs(top) / _hardest(unit), 4))
    points = np.cumsum([start, rise, hold, rise]).round(4).tolist()
    events = []
    if rng.random() < 0.5:
        at = between(rng, (1.2, 2.2))
        events = [_loss(rng, int(rng.integers(1, 4)), at, (0.3, 1.0))]
    table = {
        "duration_s": points[-1] + 0.5,
        "event": events,
        "motion": {
            "start": "standstill",
            "profile": [[points[0], 0.0], [points[1], top], [points[2], top], [points[3], 0.0]],
        },
        "load": {"kind": "preset", "torque_nm": unit.nm(between(rng, LOAD_NM) * sign(rng))},
    }
    return _run("crawl", seed, unit, table)


def _rough_table(rng: Rng, unit: PerUnit) -> Table:
    """Imperfections of a real train; the scenario draws them per drive, from its own seed."""
    table = _steady(rng, unit)
    table["load"] |= {"share_within": ROUGH_SHARE}
    table["mismatch"] = dict(ROUGH)
    table["sensors"] = {
        "current_noise_var": unit.noise(ROUGH_VAR),
        "current_offset_within_a": unit.amps(ROUGH_OFFSET_A),
    }
    table["event"] = [{"at_s": 0.0, "kind": "frame_loss", "depth": ROUGH_LOST}]
    return table


def _rough(seed: int, rng: Rng, unit: PerUnit) -> Scenario:
    table = _rough_table(rng, unit)
    at = between(rng, ROUGH_ONSET_S)
    table["event"].append(_loss(rng, int(rng.integers(1, 4)), at))
    return _run("rough", seed, unit, table)


def _healthy_rough(seed: int, rng: Rng, unit: PerUnit) -> Scenario:
    return _run("healthy, rough", seed, unit, {**_rough_table(rng, unit), "duration_s": 8.0})


def _large(seed: int, rng: Rng, unit: PerUnit) -> Scenario:
    event = _loss(rng, int(rng.integers(1, 4)), between(rng, (1.2, 2.0)))
    end = event["at_s"] + event["for_s"] + TAIL_S
    forward, first = sign(rng), between(rng, (0.0, unit.speed[1]))
    last = min(max(first + end * between(rng, (-15.0, 15.0)), 0.0), unit.speed[1])
    table = {
        "event": [event],
        "motion": {"profile": [[0.0, forward * first], [end, forward * round(last, 3)]]},
        "load": {"kind": "preset", "torque_nm": unit.nm(between(rng, LOAD_NM) * sign(rng))},
    }
    return _run("large", seed, unit, table)


def _all_together(seed: int, rng: Rng, unit: PerUnit) -> Scenario:
    """A sudden loss under all wheels; the train pulls or brakes, against a gradient or its mass.

    The rail then carries at most three quarters of the demand at the onset.
    """
    low, high = unit.speed
    forward, pull = sign(rng), sign(rng)
    demand = between(rng, (14.0, 28.0))
    share = between(rng, (0.15, 0.7))
    at, length = between(rng, (1.0, 2.0)), between(rng, (0.3, 1.5))
    kind = rng.choice(["leaves", "wet", "number"], p=[0.4, 0.2, 0.4])
    if kind == "wet":
        demand = between(rng, (27.0, 28.0))
    value = round(0.3 * share * demand / WET_NM, 4) if kind == "number" else str(kind)
    end = at + length + 1.5
    # The speed is limited: dry rail must carry the demand again, and it carries less at speed.
    speed = between(rng, (low + 0.2 * (high - low), low + 0.6 * (high - low)), 3)
    inertial = between(rng, (0.0, 0.5 if rng.random() < 0.5 else 0.0))
    slope = pull * _tenable(unit, inertial * demand)
    last = max(speed + slope * end, 0.5 * low)
    table = {
        "drives": int(rng.integers(2, 5)),
        "duration_s": round(end, 4),
        "event": [{"at_s": at, "for_s": length, "drive": "all", "kind": "rail", "value": value}],
        "motion": {
            "profile": [[0.0, forward * speed], [end, forward * round(last, 3)]],
            "effort_nm": unit.nm(between(rng, (1.02, 1.15)) * demand),
        },
        "load": {
            "kind": "rail",
            "torque_nm": unit.nm(forward * pull * (1.0 - inertial) * demand),
        },
    }
    return _run("all together", seed, unit, table)


def _healthy_hard(seed: int, rng: Rng, unit: PerUnit) -> Scenario:
    """Hard traction and braking, gradients, curves and load steps, within what dry rail carries."""
    on_rail = bool(rng.random() < 0.5)
    standing = bool(rng.random() < 0.25)
    low, high = unit.speed
    forward = sign(rng)
    speed = 0.0 if standing else between(rng, (low, 0.8 * high), 3)
    profile = [[0.5, forward * speed]]
    loads = [[0.0, unit.nm(between(rng, (4.0, 8.0)))]]
    while profile[-1][0] < HARD_S:
        began, now = profile[-1][0], abs(profile[-1][1])
        for_s = between(rng, (1.0, 3.0))
        effort = between(rng, (-20.0, 20.0)) if now >= low else 18.0
        then = min(max(now + _tenable(unit, effort) * for_s, min(now, low)), high)
        profile.append([round(began + for_s, 4), forward * round(then, 3)])
        step = between(rng, (0.02, 0.5))
        level = unit.nm(between(rng, (-8.0, 8.0) if on_rail else (-25.0, 25.0)))
        loads += [[round(began + 0.4, 4), loads[-1][1]], [round(began + 0.4 + step, 4), level]]
    curves = [
        {"drive": int(rng.integers(1, 4)), "at_s": between(rng, (0.0, HARD_S)),
         "for_s": between(rng, (1.0, 5.0)), "amount": between(rng, (-0.08, 0.08))}
        for _ in range(8)
    ]  # fmt: skip
    table = {
        "duration_s": HARD_S,
        "motion": {"start": "standstill" if standing else "rolling", "profile": profile,
                   "effort_nm": unit.nm(HARD_NM)},
        "load": {"kind": "rail" if on_rail else "preset", "profile": loads, "curve": curves,
                 "share_within": 0.03, "wheel_within": 0.01},
    }  # fmt: skip
    return _run("healthy, hard", seed, unit, table)


def _mismatched(off: Mismatch, seed: int, rng: Rng, unit: PerUnit) -> Scenario:
    table = _steady(rng, unit)
    loss = _loss(rng, int(rng.integers(2, 4)), between(rng, ROUGH_ONSET_S))
    opened = [{"at_s": OPEN_AT_S, "drive": 1, "kind": "phase_open"}] if off.phase_open else []
    table["event"] = [*opened, loss if off.phase_open or rng.random() < 0.5 else loss | ON_IT]
    table["mismatch"] = {off.motor: [off.factor, 1.0, 1.0]} if off.motor else {}
    table["sensors"] = {
        "current_noise_var": unit.noise(QUIET_VAR), "current_gain_within": off.gain,
        "current_offset_within_a": off.offset_a * unit.amps(1.0),
    }  # fmt: skip
    return _run(off.title, seed, unit, table)


def _slipping(limiter: str, seed: int, rng: Rng, unit: PerUnit) -> Scenario:
    loss = _loss(rng, int(rng.integers(1, 4)), between(rng, ONSET_S), SLIP_LENGTH_S)
    return _run(f"{limiter} slip limiter", seed, unit, slipping(rng, unit, limiter, loss))


def _braked(seed: int, rng: Rng, unit: PerUnit) -> Scenario:
    return _run("friction brakes", seed, unit, braked(rng, unit))


FAMILIES: Final[dict[str, Family]] = {
    "single": Family("one drive of three loses adhesion", _single),
    "majority": Family("more than half of 3 to 6 drives lose adhesion", _majority),
    "n1": Family("a single drive", partial(_number, 1)),
    "n2": Family("one of two drives", partial(_number, 2)),
    "n12": Family("1 to 6 of 12 drives", partial(_number, 12)),
    "n16": Family("1 to 8 of 16 drives", partial(_number, 16)),
    "braking": Family("braking from high speed, both directions", _braking),
    "gradual": Family("losses that grow over 0.1 to 1 s", _gradual),
    "crawl": Family("standstill, crawl and stop, half of them healthy", _crawl),
    "rough": Family("noise 1e-2, unlike motors and loads, offsets, 1 % of frames lost", _rough),
    "large": Family("the 350 kW motor, 0 to 140 Hz", _large, motor="traction_350kw"),
    "all_together": Family("all drives at once on the creep curve", _all_together, common=True),
    "healthy_hard": Family(
        "hard traction and braking, curves, load steps", _healthy_hard, healthy=True
    ),
    "healthy_rough": Family("as rough, nothing lost", _healthy_rough, healthy=True),
}
"""Families by name. A family's place is part of its random stream, so add new ones at the end."""
GROUPS: Final[dict[str, dict[str, Family]]] = {
    "mismatch": {
        name: Family(off.title, partial(_mismatched, off)) for name, off in MISMATCHES.items()
    },
    "slide": {
        "slide_no_limiter": Family(
            "one wheel runs away, no slip limiter", partial(_slipping, "none")
        ),
        "slide_slow_limiter": Family(
            "one wheel slips, slow slip limiter", partial(_slipping, "slow")
        ),
        "slide_braked": Family("friction brakes lock one wheel, motors coast", _braked),
    },
}
"""Families that can be asked for by the name of their group."""
ALL: Final[dict[str, Family]] = {**FAMILIES, **GROUPS["mismatch"], **GROUPS["slide"]}
