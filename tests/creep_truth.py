"""Creep and load as they are in a simulated run, beside what `Drive{n}_Adhesion` says of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.codec import bind
from dbc.frames import block_of
from gateway.core.gateway import Gateway
from gateway.settings.config import parse
from gateway.study import roller_world
from gateway.study.worlds import WORLDS
from sim.simulation import GRID, Simulation

Array = NDArray[np.float64]
SIGNALS = ("Quality", "Creep", "CreepSigma", "Utilisation", "UtilisationSigma")
TICK_NS = 10_000_000
MOST = 327.66
"""%: what Creep ends at."""


class Run(NamedTuple):
    """(T, N) truth, and by signal what was sent, NaN: not available; every 20 ms."""

    creep: Array
    used: Array
    sent: dict[str, Array]

    def within(self, name: str, sigmas: float = 2.0) -> tuple[int, int]:
        """How many values of a signal lie within so many sigmas, and how many are known."""
        true = 100.0 * (self.creep if name == "Creep" else self.used)
        known = ~np.isnan(self.sent[name])
        off = np.abs(self.sent[name] - np.clip(true, -MOST, MOST))[known]
        return int((off <= sigmas * self.sent[f"{name}Sigma"][known]).sum()), int(known.sum())


def _on_rail(scenario, codec):
    """A run of our own simulator, and the speed of its train at every tick."""
    machines = Simulation(scenario, codec)
    return machines, lambda _tick: machines._plant.w_train


def _on_rollers(family, scenario, codec, monkeypatch):
    """The same on rollers, whose speed no message and no truth has: noted as the rig turns."""
    speeds, advance = [], roller_world.Rig.advance

    def noted(rig, *given):
        advance(rig, *given)
        speeds.append(rig._v)

    monkeypatch.setattr(roller_world.Rig, "advance", noted)
    machines = WORLDS["roller"].simulate(family, scenario, codec)
    monkeypatch.undo()
    return machines, lambda tick: speeds[tick * GRID]


def run(world, family, seed, monkeypatch, motor="bench", detector="switching"):
    """One run of a world, ours or roller; a drive's wheel is as its scenario says."""
    scenario = WORLDS[world].draw(family, seed, motor)
    nodes = tuple(range(1, scenario.drives + 1))
    drives = [{"node": n, "motor": scenario.motor.name} for n in nodes]
    config = parse({"drive": drives, "adhesion": {"send_creep": True, "detector": detector}})
    codec = bind(config.dbc_path, nodes)
    if world == "roller":
        machines, train = _on_rollers(family, scenario, codec, monkeypatch)
    else:
        machines, train = _on_rail(scenario, codec)
    wheel, rated = machines._variety.p.wheel, config.motors[scenario.motor.name].T_rated
    gateway, rows, speed = Gateway(config, codec, 0), [], []
    ids = {codec.by_name[f"Drive{n}_Adhesion"].can_id: k for k, n in enumerate(nodes)}
    for tick in range(round(scenario.duration_s * 100) + 1):
        block = WORLDS[world].families[family].received(block_of(machines.step((), tick * TICK_NS)))
        frames = [f for f in gateway.step(block, tick * TICK_NS) if f.can_id in ids]
        truth = machines.truth_rows()
        if not frames or not truth:
            continue
        assert [f.can_id for f in frames] == list(ids)
        read = [codec.decode(codec.by_id[f.can_id], f.data) for f in frames]
        rows.append([[one[s].value if one[s].validity != 1 else np.nan for s in SIGNALS]
                     for one in read])  # fmt: skip
        mine = truth[-len(nodes) :]
        v = train(tick)
        speed.append([[t.speed_rad_s * wheel[k] / v - 1.0 if v else np.nan, abs(t.load_nm) / rated]
                      for k, t in enumerate(mine)])  # fmt: skip
    sent, true = np.array(rows, float), np.array(speed)
    return Run(true[..., 0], true[..., 1], {s: sent[..., k] for k, s in enumerate(SIGNALS)})
