"""Little load, coasting, brakes, wrong commands, missing messages: unknown, and accuses nobody."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

import gateway
from dbc.e2e import protect
from dbc.frames import block_of
from gateway.core.codes import Flag, Health, Reason
from gateway.core.gateway import Gateway
from gateway.settings.config import parse
from gateway.study.held_world import STATUS
from sim.simulation import Simulation
from tests.sender import CLASSIC, FD_FILE
from tests.simrun import TICK, codec, flags_and_speeds, scenario

SPEED = 150.0
RATED_NM = 30.0
FAULT_S = (2.0, 4.0)
SECONDS = 5.0


@cache
def recorded(load, drives, lost=False):
    """Frames by tick; load per unit of rated torque; lost: wheel 1 carries nothing, 1.5 to 3 s."""
    loss = {"at_s": 1.5, "for_s": 1.5, "drive": 1, "kind": "adhesion_loss", "depth": 1.0}
    run = scenario(
        seed=5, duration_s=SECONDS, drives=drives, event=[loss] if lost else [],
        motion={"profile": [(0.0, SPEED)]}, load={"torque_nm": load * RATED_NM},
    )  # fmt: skip
    simulation = Simulation(run, codec(tuple(run.nodes)))
    return [simulation.step((), k * TICK) for k in range(1, round(SECONDS * 100) + 1)]


def with_status(frames, factor=1.0, state=2, begin=2.0):
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


def judged(frames, drives):
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


def flags(rows, drive, begin, end):
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
    """Until its wheel turns with the others: unknown never clears bad. Their diameters are learnt.

    The rail is good again at 3 s, the drive is cut out from 2 to 4 s.
    """
    frames = with_status(recorded(0.6, 3, lost=True), state=0)
    core = Gateway(parse({"drive": [{"node": n} for n in (1, 2, 3)]}), codec((1, 2, 3)), 0)
    learnt = []
    for k, tick in enumerate(frames, 1):
        core.step(tick, k * TICK)
        learnt.append(core.adhesion.rotors["learnt_s"].tolist())
        if 220 <= k < 300:
            assert core.view.drives[0].adhesion is Flag.BAD
        elif 310 <= k < 400:
            assert core.view.drives[0].adhesion is Flag.UNKNOWN
            assert core.view.drives[0].adhesion_reason is Reason.NOT_AVAILABLE
    assert core.view.drives[0].adhesion is Flag.GOOD, "and it clears when the drive is back"
    for other in (1, 2):
        assert learnt[390][other] > learnt[220][other] + 1.0


def test_a_wheel_lost_while_its_command_reads_zero_is_never_adhering():
    rows = judged(with_status(recorded(0.6, 3, lost=True), factor=0.0, begin=0.0), 3)
    assert Flag.GOOD not in flags(rows, 0, 1.6, 3.0)


def test_a_loss_beside_motion_that_is_stamped_late_is_told_a_tick_later_at_most():
    """A service that reads once a tick stamps what was measured at its begin at its end."""
    ids = {codec((1, 2, 3)).by_name[f"Drive{n}_Motion"].can_id for n in (1, 2, 3)}

    def tick_of_loss(late):
        frames = [
            [f._replace(t_ns=(k + 1) * TICK) if late and f.can_id in ids else f for f in tick]
            for k, tick in enumerate(recorded(0.6, 3, lost=True))
        ]
        return [row[0].adhesion for row in judged(frames, 3)].index(Flag.BAD)

    assert 150 <= tick_of_loss(late=False) <= 153
    assert tick_of_loss(late=True) <= tick_of_loss(late=False) + 1


COASTS_S = 2.2
END_S = 4.0


def said(*, commands, slows=False):
    """Flags and reasons of all drives from half a second after the train has begun to coast."""
    speeds = [[0.0, 120.0], [COASTS_S, 120.0], [END_S, 40.0 if slows else 120.0]]
    train = scenario(
        duration_s=END_S, drives=3, seed=5, motion={"profile": speeds},
        load={"kind": "preset", "transition": "linear",
              "profile": [[0.0, 15.0], [2.0, 15.0], [COASTS_S, 0.0]]},
    )  # fmt: skip
    simulation, gateway, out = Simulation(train, codec()), Gateway(parse({}), codec(), 0), []
    for tick in range(1, round(END_S * 100)):
        block = block_of(simulation.step((), tick * TICK))
        if not commands:
            block = block.pick([can_id not in STATUS for can_id in block.can_id])
        gateway.step(block, tick * TICK)
        if tick >= 100 * (COASTS_S + 0.5):
            out += [(drive.adhesion, drive.adhesion_reason) for drive in gateway.view.drives]
    return set(out)


def test_wheels_that_roll_with_the_others_adhere():
    assert said(commands=True) == {(Flag.GOOD, Reason.NONE)}


@pytest.mark.parametrize("how", [{"commands": False}, {"commands": True, "slows": True}])
def test_nobody_knows_where_more_may_have_been_asked_or_a_brake_slows_them(how):
    """Without commands a train that coasts and one whose wheels are all lost look alike."""
    assert {flag for flag, _ in said(**how)} == {Flag.UNKNOWN}


NODES = (1, 2, 3)
CALIBRATION = Path(gateway.__path__[0]) / "bench_calibration.toml"
FLAGS = ("adhesion", "thermal", "sensor", "comm", "estimator")
SLOW, FAST = 200.0, 600.0
"""Electrical rad/s: above and below ten samples of 2 ms in a revolution."""
DAY = 550
"""Ticks, of which the last 50 are looked at: thermal flags need 5 s."""


@cache
def sent(w_e, path):
    """What drives that turn steadily send, by the tick."""
    run = scenario(seed=3, duration_s=6.0, motion={"profile": [[0.0, w_e]]})
    simulation = Simulation(run, codec(NODES, path))
    return [simulation.step((), now) for now in range(TICK, DAY * TICK + 1, TICK)]


def known(without, w_e, path=CLASSIC):
    """Flags of drive 1 that are known, with those messages of the drives not sent."""
    used = codec(NODES, path)
    tables = {"thermal": {"calibration": str(CALIBRATION)}, "drive": [{"node": n} for n in NODES]}
    core = Gateway(parse(tables), used, 0)
    gone = {m.can_id for m in used.messages if m.name.partition("_")[2] in without}
    assert len(gone) >= len(NODES) * len(without)
    seen = []
    for k, frames in enumerate(sent(w_e, path), 1):
        core.step([f for f in frames if f.can_id not in gone], k * TICK)
        seen.append([getattr(core.view.drives[0], flag) for flag in FLAGS])
    last = np.array(seen[-50:])
    assert not (last == Flag.BAD).any()
    always = (last == Flag.GOOD).all(axis=0)
    assert (always | (last == Flag.UNKNOWN).all(axis=0)).all()
    return {flag for flag, is_known in zip(FLAGS, always, strict=True) if is_known}


@pytest.mark.parametrize(
    ("without", "w_e", "unknown"),
    [
        ((), SLOW, ""),
        ((), FAST, ""),
        (("PhaseCurrents",), SLOW, "adhesion estimator comm"),
        (("StatorVoltages",), FAST, "adhesion estimator comm"),
        (("Motion",), SLOW, "thermal"),
        (("Motion",), FAST, "thermal adhesion estimator"),
        (("Status",), FAST, "thermal"),
        (("Temperatures",), FAST, "thermal sensor"),
        (("Status", "Temperatures"), FAST, "thermal sensor"),
        (("Motion", "Status", "Temperatures"), SLOW, "thermal sensor"),
    ],
)
def test_what_is_unknown_without_a_message(without, w_e, unknown):
    assert known(without, w_e) == set(FLAGS) - set(unknown.split())


def test_on_can_fd_currents_alone_are_enough_at_any_speed():
    without = ("Motion", "Status", "Temperatures")
    assert known(without, FAST, FD_FILE) == {"adhesion", "comm", "estimator"}
    assert known(("Samples",), FAST, FD_FILE) == {"thermal", "sensor"}


MOTOR = "traction_350kw"
LOAD_NM = -283.0
"""Of 796 Nm rated. A rotor that slows by 10 rad/s^2 takes 110 Nm more."""
ONE = {"at_s": 2.0, "for_s": 0.5, "drive": 1, "kind": "adhesion_loss", "depth": 0.8}
ALL = {"at_s": 1.0, "drive": "all", "kind": "adhesion_loss", "depth": 0.3, "ramp_s": 0.5}
BRAKES = [[0.5, 540.0], [8.5, 380.0]]
"""Electrical rad/s: 10 rad/s^2 at the rotor, an emergency brake of 1.4 m/s^2, from 38 m/s."""


def braked(seconds, **changes):
    run = scenario(seed=3, duration_s=seconds, motor={"name": MOTOR}, **changes)
    drives = [{"node": node, "motor": MOTOR} for node in NODES]
    return flags_and_speeds(run, codec(NODES), drive=drives)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_emergency_brake_is_no_loss_of_all(sign):
    profile = [[at, sign * speed] for at, speed in BRAKES]
    load = {"kind": "preset", "torque_nm": sign * LOAD_NM}
    flags, _ = braked(3.0, motion={"profile": profile}, load=load, event=[ONE])
    assert (flags[60:195] == Flag.GOOD).all()
    assert (flags[60:, 1:] == Flag.GOOD).all()
    assert (flags[205:245, 0] == Flag.BAD).all()
    assert (flags[260:, 0] == Flag.GOOD).all()


def test_nobody_knows_for_longer_whether_brakes_or_a_loss_of_all_slow_the_rotors():
    load = {"kind": "preset", "torque_nm": LOAD_NM}
    flags, _ = braked(8.0, motion={"profile": BRAKES}, load=load)
    assert not (flags == Flag.BAD).any()
    assert (flags[60:200] == Flag.GOOD).all()
    assert (flags[550:] == Flag.UNKNOWN).all()


def test_all_wheels_that_slide_gently_are_not_adhering_beyond_a_tenth():
    """Less is missing than an emergency brake would take; nothing limits the slip."""
    load = {"kind": "rail", "torque_nm": LOAD_NM}
    motion = {"profile": [[0.0, 540.0]], "effort_nm": 800.0}
    flags, speeds = braked(8.0, motion=motion, load=load, slip_limiter="none", event=[ALL])
    assert (flags[60:100] == Flag.GOOD).all()
    slid = speeds < 0.9 * speeds[100]
    assert slid[-1].all()
    for drive in range(len(NODES)):
        first = int(np.argmax(slid[:, drive]))
        assert not (flags[first + 20 :, drive] == Flag.GOOD).any()
