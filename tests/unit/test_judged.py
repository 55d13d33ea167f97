"""What cannot be judged is unknown and accuses nobody: little load, wrong commands, cut-outs."""

from __future__ import annotations

from functools import cache

import pytest

from dbc.e2e import protect
from dbc.frame import Frame
from gateway.core.codes import Flag, Health, Reason
from gateway.core.gateway import Gateway
from gateway.settings.config import parse
from sim.simulation import Simulation
from tests.simrun import TICK, codec, scenario

SPEED = 150.0
RATED_NM = 30.0
FAULT_S = (2.0, 4.0)
SECONDS = 5.0


@cache
def recorded(load: float, drives: int, lost: bool = False) -> list[list[Frame]]:
    """Frames by tick; load per unit of rated torque; lost: wheel 1 carries nothing, 1.5 to 3 s."""
    loss = {"at_s": 1.5, "for_s": 1.5, "drive": 1, "kind": "adhesion_loss", "depth": 1.0}
    run = scenario(
        seed=5, duration_s=SECONDS, drives=drives, event=[loss] if lost else [],
        motion={"profile": [(0.0, SPEED)]}, load={"torque_nm": load * RATED_NM},
    )  # fmt: skip
    nodes = tuple(range(1, drives + 1))
    simulation = Simulation(run, codec(nodes), nodes=nodes)
    return [simulation.step((), k * TICK) for k in range(1, round(SECONDS * 100) + 1)]


def with_status(frames: list[list[Frame]], factor: float = 1.0, state: int = 2, begin: float = 2.0):
    """The first drive's `Status` with another command or state, from `begin` to 4 s."""
    spec = codec((1, 2, 3)).by_name["Drive1_Status"]
    out = []
    for tick in frames:
        changed = []
        for frame in tick:
            if frame.can_id == spec.can_id and begin <= frame.t_ns * 1e-9 < FAULT_S[1]:
                data = bytearray(frame.data)
                command = round(int.from_bytes(data[4:6], "little", signed=True) * factor)
                data[4:6] = command.to_bytes(2, "little", signed=True)
                data[6] = (data[6] & 0xF0) | state
                protect(spec, data, frame.data[1] & 0x0F)
                changed.append(frame._replace(data=bytes(data)))
            else:
                changed.append(frame)
        out.append(changed)
    return out


def judged(frames: list[list[Frame]], drives: int):
    """Per tick: the drives as the gateway sees them."""
    core = Gateway(
        parse({"drive": [{"node": n + 1} for n in range(drives)]}),
        codec(tuple(range(1, drives + 1))),
        0,
    )
    rows = []
    for k, tick in enumerate(frames, 1):
        core.step(tick, k * TICK)
        rows.append(core.view.drives)
    return rows


def flags(rows, drive: int, begin: float, end: float) -> set[Flag]:
    return {row[drive].adhesion for row in rows[round(begin * 100) : round(end * 100)]}


@pytest.mark.parametrize("load", [0.09, -0.09])
def test_a_wheel_lost_at_little_load_is_never_adhering(load):
    rows = judged(recorded(load, 3, lost=True), 3)
    assert Flag.GOOD not in flags(rows, 0, 1.6, 3.0)
    assert Flag.BAD not in flags(rows, 1, 0.0, SECONDS) | flags(rows, 2, 0.0, SECONDS)


def test_a_drive_that_coasts_alone_is_unknown():
    rows = judged(recorded(0.03, 1), 1)
    assert flags(rows, 0, 0.5, SECONDS) == {Flag.UNKNOWN}
    assert rows[-1][0].adhesion_reason is Reason.TOO_FEW_DRIVES


def test_drives_that_coast_together_adhere():
    rows = judged(recorded(0.03, 3), 3)
    assert all(flags(rows, drive, 0.5, SECONDS) == {Flag.GOOD} for drive in range(3))


@pytest.mark.parametrize("drives", [1, 2, 3])
@pytest.mark.parametrize("factor", [0.0, 0.1, 0.4])
def test_a_load_without_a_command_is_invalid_input(factor, drives):
    rows = judged(with_status(recorded(0.6, drives), factor), drives)
    assert flags(rows, 0, 2.5, 4.0) == {Flag.UNKNOWN}
    assert rows[350][0].adhesion_reason in (Reason.RANGE, Reason.TOO_FEW_DRIVES)
    if factor > 0.1:
        assert rows[350][0].health is Health.INPUT_INVALID
    for other in range(1, drives):
        assert flags(rows, other, 1.0, SECONDS) == {Flag.GOOD}
    assert rows[-1][0].adhesion is Flag.GOOD


@pytest.mark.parametrize("drives", [2, 3])
@pytest.mark.parametrize("factor", [3.0, 10.0])
@pytest.mark.parametrize("begin", [0.0, 2.0])
def test_a_command_far_beyond_all_others_accuses_nobody(factor, drives, begin):
    rows = judged(with_status(recorded(0.6, drives), factor, begin=begin), drives)
    for drive in range(drives):
        assert Flag.BAD not in flags(rows, drive, 0.0, SECONDS)
    for other in range(1, drives):
        assert flags(rows, other, 1.0, SECONDS) == {Flag.GOOD}


@pytest.mark.parametrize("drives", [1, 2, 3])
@pytest.mark.parametrize("state", [0, 1, 3])
def test_a_drive_that_is_cut_out_is_unknown_and_says_why(state, drives):
    rows = judged(with_status(recorded(0.6, drives), state=state), drives)
    assert flags(rows, 0, 2.2, 4.0) == {Flag.UNKNOWN}
    assert rows[300][0].adhesion_reason is Reason.NOT_AVAILABLE
    assert rows[-1][0].adhesion is Flag.GOOD, "and it clears when the drive is back"
    for other in range(1, drives):
        assert flags(rows, other, 1.0, SECONDS) == {Flag.GOOD}


@pytest.mark.parametrize("drives", [1, 2, 3])
def test_a_command_of_the_wrong_sign_is_invalid_input_and_no_loss(drives):
    rows = judged(with_status(recorded(0.6, drives), factor=-1.0), drives)
    assert flags(rows, 0, 2.5, 4.0) == {Flag.UNKNOWN}
    assert rows[350][0].health is Health.INPUT_INVALID
    for drive in range(drives):
        assert Flag.BAD not in flags(rows, drive, 0.0, SECONDS)


def test_a_drive_cut_out_while_it_is_lost_keeps_its_flag_and_stops_nobody_from_learning():
    """The contract: unknown never clears bad. Diameters of the others are learnt meanwhile."""
    frames = with_status(recorded(0.6, 3, lost=True), state=0)
    core = Gateway(parse({"drive": [{"node": n} for n in (1, 2, 3)]}), codec((1, 2, 3)), 0)
    learnt = []
    for k, tick in enumerate(frames, 1):
        core.step(tick, k * TICK)
        learnt.append(core.adhesion.rotors["learnt_s"].tolist())
        if 220 <= k < 400:
            assert core.view.drives[0].adhesion is Flag.BAD
    assert core.view.drives[0].adhesion is Flag.GOOD, "and it clears when the drive is back"
    for other in (1, 2):
        assert learnt[390][other] > learnt[220][other] + 1.0


def test_a_wheel_lost_while_its_command_reads_zero_is_never_adhering():
    rows = judged(with_status(recorded(0.6, 3, lost=True), factor=0.0, begin=0.0), 3)
    assert Flag.GOOD not in flags(rows, 0, 1.6, 3.0)


def test_a_loss_beside_motion_that_is_stamped_late_is_told_a_tick_later_at_most():
    """A service that reads once a tick stamps what was measured at its begin at its end."""
    ids = {codec((1, 2, 3)).by_name[f"Drive{n}_Motion"].can_id for n in (1, 2, 3)}

    def tick_of_loss(late: bool) -> int:
        frames = [
            [f._replace(t_ns=(k + 1) * TICK) if late and f.can_id in ids else f for f in tick]
            for k, tick in enumerate(recorded(0.6, 3, lost=True))
        ]
        return [row[0].adhesion for row in judged(frames, 3)].index(Flag.BAD)

    assert 150 <= tick_of_loss(late=False) <= 153
    assert tick_of_loss(late=True) <= tick_of_loss(late=False) + 1
