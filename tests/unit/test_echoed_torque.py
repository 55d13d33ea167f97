"""A drive that sends the torque it is asked for, where only that is a witness of its load.

Above ten samples of current a revolution its load comes from its own speed and torque. Its wheel
has lost its grip, its slip control has taken the current back, and its `Motion` says all is well.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from dbc.e2e import protect
from dbc.frame import SECOND
from dbc.frames import Block, block_of
from gateway.core.codes import Flag
from gateway.core.gateway import Gateway
from gateway.settings.config import parse
from sim.scenario import parse as scenario
from sim.simulation import Simulation
from tests.simrun import CLASSIC, codec

NODES, TICK = (1, 2, 3), 10_000_000
LOSS_S, LAST_S, END_S = 2.0, 1.5, 4.5
SPEED = 380.0
"""rad/s, electrical: eight samples of current a revolution."""
BOUND = codec(NODES, CLASSIC)
MOTION = BOUND.by_name["Drive2_Motion"]
TORQUE = MOTION.signals[MOTION.column("Torque")]
MASK = (1 << TORQUE.length) - 1 << TORQUE.start


def blocks(depth: float, seed: int) -> Iterator[Block]:
    """Frames by tick: from the loss on, drive 2's torque is the one of before."""
    lost = {"at_s": LOSS_S, "for_s": LAST_S, "drive": 2, "kind": "adhesion_loss", "depth": depth}
    world = scenario({
        "title": "echo", "seed": seed, "duration_s": END_S, "drives": 3, "event": [lost],
        "motion": {"start": "rolling", "profile": [(0.0, SPEED), (END_S, SPEED)]},
        "load": {"torque_nm": 18.0},
    })  # fmt: skip
    simulation = Simulation(world, BOUND, nodes=NODES)
    kept = 0
    for k in range(1, round(END_S * SECOND / TICK)):
        block = block_of(simulation.step((), k * TICK))
        for row in range(block.size):
            if block.can_id[row] != MOTION.can_id:
                continue
            word = int.from_bytes(block.data[row, : MOTION.length].tobytes(), "little")
            if not LOSS_S <= k * TICK / SECOND < LOSS_S + LAST_S:
                kept = word & MASK
                continue
            payload = bytearray((word & ~MASK | kept).to_bytes(MOTION.length, "little"))
            counter = MOTION.signals[MOTION.column("Counter")]
            protect(MOTION, payload, word >> counter.start & ((1 << counter.length) - 1))
            block.data[row, : MOTION.length] = list(payload)
        yield block


@pytest.mark.parametrize("detector", ["switching", "vb"])
@pytest.mark.parametrize("depth", [0.95, 0.7])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_torque_that_no_current_makes_is_not_believed(detector, depth, seed):
    core = Gateway(parse({"adhesion": {"detector": detector}}), BOUND, 0)
    said: dict[int, list[Flag]] = {node: [] for node in NODES}
    for k, block in enumerate(blocks(depth, seed), start=1):
        core.step(block, k * TICK)
        for drive in core.view.drives:
            said[drive.node].append(drive.adhesion)
    begin, end = round(LOSS_S * 100), round((LOSS_S + LAST_S) * 100)
    assert Flag.GOOD not in said[2][begin + 20 : end]
    assert set(said[2][begin - 50 : begin]) == {Flag.GOOD}
    assert said[2][-1] is Flag.GOOD
    for node in (1, 3):
        assert set(said[node][begin - 50 :]) == {Flag.GOOD}
