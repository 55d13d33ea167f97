"""The honest train of the storm: recorded once from the simulator, played in a loop.

A loop holds every phase of a run. Its length is a multiple of every classic message's counter
period, so counters go on where one round ends and the next begins; on CAN FD they jump there, once
in 80 s, while the train stands.
"""

from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dbc.codec import Codec
from dbc.frame import MS, SECOND
from dbc.frames import Block, block_of
from sim.physics.adhesion import SPEED_FLOOR_M_S
from sim.physics.plant import TRAIN
from sim.scenario import parse
from sim.simulation import Simulation
from tests.recorded import ROOT, recorded
from tests.simrun import CLASSIC, codec

TICK = 10 * MS
LOOP_S = 80
LOOP_TICKS = LOOP_S * 100
LOOP_NS = LOOP_S * SECOND
NODES = (1, 2, 3)
PHASES = ("start", "standstill", "traction", "braking", "slip")
LEAST_RAD_S = SPEED_FLOOR_M_S / TRAIN.wheel_radius_m
"""Speed of the train, at the rotor, below which creep is not a share of it."""
SHIFT = 1337
"""Ticks from which a second sender's frames are taken."""


def _scenario(creeps):
    """Two rounds: the first brings motors and stamps into their stride."""
    speed = [(0.0, 0.0), (6.0, 0.0), (20.0, 110.0), (40.0, 110.0), (62.0, 0.0)]
    # The first load is what the motors are warm from, about as warm as the rounds keep them.
    pull = [
        (0.0, 13.0), (0.1, 0.5), (5.0, 0.5), (6.0, 20.0), (36.0, 16.0), (42.0, -14.0),
        (61.0, -14.0), (63.0, 0.5),
    ]  # fmt: skip
    losses = [
        (14.0, 1.0, 1, 1.0), (24.0, 1.0, 2, 1.0), (29.0, 0.8, 1, 0.6), (33.0, 0.8, "all", 0.8),
        (48.0, 1.0, 3, 1.0), (54.0, 0.6, 2, 0.7),
    ]  # fmt: skip
    if creeps:
        losses = [
            (12.0, 0.6, 3, 0.05), (17.0, 0.5, 1, 0.1), (22.0, 0.8, 2, 0.05), (27.0, 0.4, 3, 0.15),
            (45.0, 0.8, 1, 0.04), (50.0, 0.5, 2, 0.1),
            (54.0, 0.4, 3, 0.15),
        ]  # fmt: skip
    rounds = (0.0, float(LOOP_S))
    return parse({
        "title": "storm",
        "seed": 7,
        "duration_s": 2 * LOOP_S,
        "drives": len(NODES),
        "slip_limiter": "none" if creeps else "fast",
        "motion": {
            "start": "standstill",
            "profile": [(t + r, w) for r in rounds for t, w in speed],
        },
        "load": {"profile": [(t + r, nm) for r in rounds for t, nm in pull]},
        "event": [
            {"at_s": at + r, "for_s": span, "drive": who, "kind": "adhesion_loss", "depth": depth}
            for r in rounds
            for at, span, who, depth in losses
        ],
    })  # fmt: skip


class Train(NamedTuple):
    """A round of the train: frames of its ticks, and what is so.

    speed rad/s, load Nm, lost, creep (share of the train's speed): (LOOP_TICKS, N); phase
    (LOOP_TICKS,) index into PHASES.
    """

    codec: Codec
    frames: list[Block]
    speed: np.ndarray
    lost: np.ndarray
    load: np.ndarray
    creep: np.ndarray
    phase: np.ndarray

    def sent(self, tick):
        """What the drives send in the 10 ms that end with this tick (from 1)."""
        turn, k = divmod(tick - 1, LOOP_TICKS)
        block = self.frames[k]
        return block._replace(t_ns=block.t_ns + turn * LOOP_NS)

    def elsewhere(self, tick):
        """Frames of the same drives from another time, stamped with this one."""
        at = (tick - 1 + SHIFT) % LOOP_TICKS
        block = self.frames[at]
        return block._replace(t_ns=block.t_ns + (tick - 1 - at) * TICK)


@cache
def train(dbc=CLASSIC, creeps=False):
    """creeps: no drive limits its slip, so wheels run away."""
    sources = ROOT / "dbc", ROOT / "sim", Path(__file__), ROOT / "tests" / "simrun.py"
    kept = recorded("train", lambda: _record(dbc, creeps), sources, dbc.name, creeps)
    frames = Block(*(kept[name] for name in Block._fields[:-1]), [""])
    ends = kept["ends"].tolist()
    blocks = [frames.part(a, b) for a, b in pairwise([0, *ends])]
    more = (kept[name] for name in ("speed", "lost", "load", "creep", "phase"))
    return Train(codec(NODES, dbc), blocks, *more)


def _record(dbc, creeps):
    """From the simulator; frames tick by tick, and the ends of the ticks among them."""
    bound = codec(NODES, dbc)
    simulation = Simulation(_scenario(creeps), bound)
    frames, rolling = [], []
    for k in range(1, 2 * LOOP_TICKS + 1):
        block = block_of(simulation.step((), k * TICK))
        frames.append(block._replace(t_ns=block.t_ns - LOOP_NS))
        rolling.append(simulation._plant.w_train)
    rows = simulation.truth_rows()[-LOOP_TICKS * len(NODES) :]

    def of(name, kind):
        column = [getattr(row, name) for row in rows]
        return np.array(column, dtype=kind).reshape(LOOP_TICKS, len(NODES))

    speed, lost = of("speed_rad_s", float), of("lost", bool)
    v = np.array(rolling[LOOP_TICKS:])[:, None]
    creep = np.abs(speed - v) / np.maximum(np.abs(v), LEAST_RAD_S)
    phase = _phases(speed, lost)
    frames = frames[LOOP_TICKS:]
    assert all(block.names in ([], [""]) for block in frames)
    columns = {
        name: np.concatenate([getattr(block, name) for block in frames])
        for name in Block._fields[:-1]
    }
    ends = np.cumsum([block.size for block in frames])
    truth = {"speed": speed, "lost": lost, "load": of("load_nm", float), "creep": creep}
    return {**columns, "ends": ends, **truth, "phase": phase}


def _phases(speed, lost):
    mean = speed.mean(axis=1)
    rising = np.gradient(mean)
    out = np.full(LOOP_TICKS, PHASES.index("traction"))
    out[rising < -1e-3] = PHASES.index("braking")
    out[np.abs(mean) < 1.0] = PHASES.index("standstill")
    began = int(np.argmax(mean > 1.0))
    out[began : began + 300] = PHASES.index("start")
    out[lost.any(axis=1)] = PHASES.index("slip")
    return out
