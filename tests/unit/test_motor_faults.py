"""Faults of a motor (the 350 kW one turns beyond ten samples a revolution), and echoed torque."""

import pytest

from dbc.e2e import protect
from dbc.frame import SECOND
from dbc.frames import block_of
from gateway.core.codes import Flag, Health, Reason
from gateway.core.gateway import Gateway
from gateway.settings.config import parse
from gateway.study.evaluation_runs import Plan, fitted, one_run, record
from gateway.study.scenarios_family import draw
from sim.scenario import parse as scenario
from sim.simulation import Simulation
from tests.simrun import CLASSIC, codec

MOTOR = "traction_350kw"
OPEN_S = 1.0


def measured(family, seed):
    plan = Plan((family,), ("vb",), (seed,), motor=MOTOR)
    return one_run(plan, family, seed)[0].flags


@pytest.mark.parametrize(
    ("motor", "seed", "within_s"),
    [(MOTOR, 0, 0.05), (MOTOR, 2, 0.05), (MOTOR, 6, 0.05), (MOTOR, 1, 1.2), ("bench", 0, 1.2)],
)
def test_an_open_phase_is_said(motor, seed, within_s):
    """Where the filters do not reach (0, 2, 6), and where they lose their lock.

    The torque pulsates, so does the load of the observer: it knows nothing of the wheel.
    """
    scenario = draw("off_phase_open", seed, motor)
    config, codec = fitted(Plan((), ("vb",), (), motor=motor), "vb", scenario)
    gateway, views = Gateway(config, codec, 0), []
    for tick, block in enumerate(record(scenario, config, codec).blocks):
        now = tick * config.loop.period_ns
        gateway.step(block, now)
        views.append((now * 1e-9, gateway.view))
    first = [v.drives[0] for t, v in views if OPEN_S - 0.5 < t < OPEN_S]
    rest = [v.drives[0] for t, v in views if t > OPEN_S + within_s]
    assert {d.adhesion for d in first} == {Flag.GOOD}
    assert {(d.adhesion, d.health, d.adhesion_reason) for d in rest} == {
        (Flag.UNKNOWN, Health.INPUT_INVALID, Reason.RANGE)
    }
    soon = {v.drives[0].adhesion for t, v in views if t > OPEN_S + 0.05}
    others = {d.adhesion for t, v in views if 0.3 < t < 2.0 for d in v.drives[1:]}
    assert soon == {Flag.UNKNOWN}
    assert others == {Flag.GOOD}


@pytest.mark.parametrize("seed", [1, 10, 14])
def test_a_flux_off_by_a_fifth_raises_nothing_and_hides_nothing(seed):
    """Seed 14 turns too fast for the filters: the torque is the drive's own, of the data sheet."""
    flags = measured("off_psi_up", seed)
    assert flags.alarms == 0
    assert flags.missed == 0
    assert flags.f1 > 0.75


NODES, TICK = (1, 2, 3), 10_000_000
LOSS_S, LAST_S, END_S = 2.0, 1.5, 4.5
SPEED = 380.0
"""rad/s, electrical: eight samples of current a revolution."""
BOUND = codec(NODES, CLASSIC)
MOTION = BOUND.by_name["Drive2_Motion"]
TORQUE = MOTION.signals[MOTION.column("Torque")]
MASK = (1 << TORQUE.length) - 1 << TORQUE.start


def blocks(depth, seed):
    """Frames by tick: from the loss on, drive 2's torque is the one of before."""
    lost = {"at_s": LOSS_S, "for_s": LAST_S, "drive": 2, "kind": "adhesion_loss", "depth": depth}
    world = scenario({
        "title": "echo", "seed": seed, "duration_s": END_S, "drives": 3, "event": [lost],
        "motion": {"start": "rolling", "profile": [(0.0, SPEED), (END_S, SPEED)]},
        "load": {"torque_nm": 18.0},
    })  # fmt: skip
    simulation = Simulation(world, BOUND)
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
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.thorough)])
def test_a_torque_that_no_current_makes_is_not_believed(detector, depth, seed):
    core = Gateway(parse({"adhesion": {"detector": detector}}), BOUND, 0)
    said = {node: [] for node in NODES}
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
