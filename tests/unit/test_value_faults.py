"""Wrong values behind right counters and checksums: what they are, and what the flags make of them.

Clear cases: steady drives, 60 % of rated torque, one drive wrong for 1.5 s.
"""

import math
from itertools import product

import numpy as np
import pytest

from dbc.e2e import crc_ok
from gateway.core.codes import Flag
from gateway.core.gateway import Gateway
from tests.simrun import CLASSIC, FD_FILE, codec
from tests.storm.value_faults import KINDS_OF_CURRENT, VALUE_KINDS, ValueFaults
from tests.value_cases import (
    FILTERS,
    MOTOR_NAMES,
    NODES,
    SPEEDS,
    TICK,
    Case,
    config_of,
    driven,
    honest,
    run_case,
)

REACTION_MS, AGAIN_MS = 200, 3000
MATTERS = 0.15
"""Of rated current, root mean square: less need not be noticed."""
BUSES = (False, True)
AHEAD = 50
"""Ticks before the fault."""


def frames_of(kind, fd, ticks=20, drive=1):
    """(honest, sent) by tick, the fault from tick AHEAD + 1 on; and the faults' own record."""
    blocks = honest(200.0, "bench", fd, AHEAD + 2 * ticks)
    faults = ValueFaults(codec(NODES, FD_FILE if fd else CLASSIC), NODES)
    out = []
    for k, sent in enumerate(blocks):
        now = AHEAD <= k < AHEAD + ticks
        out.append((sent, faults.apply([(kind, drive)] if now else [], sent), faults.error))
    return out


def currents(block, node, fd):
    """Physical currents of a drive, by frame: (Ia, Ib, Ic), or (Ia, Ib) of eight samples."""
    bound = codec(NODES, FD_FILE if fd else CLASSIC)
    spec = bound.by_name[f"Drive{node}_{'Samples' if fd else 'PhaseCurrents'}"]
    names = [s.name for s in spec.signals if s.name[:2] in ("Ia", "Ib", "Ic")]
    out = []
    for frame in block.frames():
        if frame.can_id == spec.can_id:
            readings = bound.decode(spec, frame.data)
            out.append([readings[name].value for name in names])
    return out


@pytest.mark.parametrize("fd", BUSES)
@pytest.mark.parametrize("kind", VALUE_KINDS)
def test_headers_are_right_and_only_one_drive_and_time_is_touched(kind, fd):
    bound = codec(NODES, FD_FILE if fd else CLASSIC)
    touched = 0
    for k, (true, sent, error) in enumerate(frames_of(kind, fd)):
        for one, other in zip(true.frames(), sent.frames(), strict=True):
            spec = bound.by_id.get(one.can_id)
            if one == other:
                continue
            touched += 1
            assert AHEAD <= k < AHEAD + 20
            assert spec.node == 2
            assert other._replace(data=one.data) == one
            assert crc_ok(spec, other.data)
            header = slice(2, 3) if spec.is_fd else slice(1, 2)
            mask = 0xFF if spec.is_fd else 0x0F
            assert other.data[header][0] & mask == one.data[header][0] & mask
        assert not error.current_a[[0, 2]].any()
    # A steady drive's speed stands by itself.
    assert touched > 15 or kind == "held_motion"


@pytest.mark.parametrize("fd", BUSES)
def test_what_each_kind_does_to_the_currents(fd):
    step = 0.05 if fd else 0.02

    def at(kind, tick=AHEAD + 5):
        rows = frames_of(kind, fd)
        return (currents(rows[tick][0], 2, fd), currents(rows[tick][1], 2, fd), rows)

    true, sent, rows = at("held")
    assert sent == [currents(rows[AHEAD - 1][0], 2, fd)[-1]] * len(true)
    true, sent, rows = at("late")
    assert sent == [currents(rows[AHEAD + 4][0], 2, fd)[-1], *true[:-1]]
    true, sent, rows = at("other_drive")
    assert sent == currents(rows[AHEAD + 5][0], 3, fd)
    true, sent, _ = at("sign_turned")
    assert sent == [[-x for x in row] for row in true]
    true, sent, _ = at("tenth")
    assert np.allclose(sent, np.array(true) / 10.0, atol=0.51 * step)
    true, sent, _ = at("tenfold")
    most = np.abs(np.array(true)).max() * 10.0
    assert np.abs(np.array(sent)).max() == pytest.approx(min(most, 8190 * step if fd else 655.32))
    true, sent, _ = at("swapped")
    width = 2 if fd else 3
    a, b = np.array(true).reshape(-1, width), np.array(sent).reshape(-1, width)
    assert np.array_equal(a[:, [1, 0]], b[:, :2])
    true, sent, _ = at("rotated")
    a, b = np.array(true).reshape(-1, width), np.array(sent).reshape(-1, width)
    third = a[:, 2] if not fd else -a[:, 0] - a[:, 1]
    assert np.allclose(b[:, 0], a[:, 1])
    assert np.allclose(b[:, 1], third)


@pytest.mark.parametrize("fd", BUSES)
@pytest.mark.parametrize("kind", KINDS_OF_CURRENT)
def test_not_available_and_saturated_codes_stay_legal(kind, fd):
    bound = codec(NODES, FD_FILE if fd else CLASSIC)
    spec = bound.by_name[f"Drive2_{'Samples' if fd else 'PhaseCurrents'}"]
    block = honest(200.0, "bench", fd, 10)[5]
    mine = np.flatnonzero(block.can_id == spec.can_id)[0]
    for values in ({}, dict.fromkeys((s.name for s in spec.signals[2:]), 1e9)):
        data = block.data.copy()
        data[mine, : spec.length] = np.frombuffer(bound.encode(spec, values), dtype=np.uint8)
        sent = ValueFaults(bound, NODES).apply([(kind, 1)], block._replace(data=data))
        for signal in spec.signals:
            if signal.name[:2] in ("Ia", "Ib", "Ic"):
                readings = bound.decode(spec, sent.data[mine, : spec.length].tobytes())
                raw = readings[signal.name].raw
                assert raw == signal.not_available or signal.raw_min <= raw <= signal.raw_max


def test_a_held_drive_stands_in_all_that_it_says_and_goes_on_counting():
    rows = frames_of("held_drive", fd=True)
    bound = codec(NODES, FD_FILE)
    said = {}
    counted = {}
    for _, sent, _ in rows[AHEAD : AHEAD + 20]:
        for frame in sent.frames():
            spec = bound.by_id.get(frame.can_id)
            if spec is not None and spec.node == 2:
                readings = bound.decode(spec, frame.data)
                heads = [readings.pop(n, None) for n in ("Crc", "Counter", "SampleIndex")]
                said.setdefault(spec.kind, set()).add(repr(readings))
                counted.setdefault(spec.kind, set()).add(heads[1].raw)
    assert set(said) == {"Samples", "Motion", "Status", "Temperatures"}
    assert all(len(values) == 1 for values in said.values())
    assert len(counted["Samples"]) == 200
    assert len(counted["Motion"]) == 16, "all values of its counter"


def test_the_error_is_that_of_what_was_sent():
    rows = frames_of("sign_turned", fd=False)
    true = np.array(currents(rows[AHEAD + 5][0], 2, fd=False))
    assert rows[AHEAD + 5][2].current_a[1] == pytest.approx(2.0 * np.sqrt((true**2).mean()))
    assert rows[AHEAD - 1][2].current_a[1] == 0.0
    assert rows[AHEAD + 20][2].current_a[1] == 0.0


# ---- what the gateway makes of it ----------------------------------------------------------------


def judged(case):
    """The promises; raises where one is broken."""
    outcome = run_case(case)
    assert not outcome.raised
    if case.begin:
        assert all(rows[case.begin - 1].flag is Flag.GOOD for rows in outcome.rows)
    matters = min(outcome.off[20:]) > MATTERS or min(outcome.off_rpm[20:]) > 10.0
    for row in outcome.mine + outcome.after:
        assert row.flag is not Flag.BAD, f"AdhesionLost of a wheel that holds: {row}"
    for row in outcome.mine[REACTION_MS // 10 :]:
        assert not matters or row.flag is Flag.UNKNOWN or row.sensor is Flag.BAD, row
    for rows in outcome.others:
        for row in rows:
            assert row.flag is Flag.GOOD or (not case.begin and row.tick < 150), row
    for row in outcome.after[AGAIN_MS // 10 :]:
        assert row.flag is Flag.GOOD, row


CASES = [
    Case(kind, speed, motor, name, fd)
    for fd, motor, name, speed, kind in product(
        BUSES, MOTOR_NAMES, FILTERS, SPEEDS, KINDS_OF_CURRENT
    )
]
QUICK = {
    case
    for case in CASES
    if case.filter == "ekf" and case.speed == (290.0 if case.motor == "bench" else 100.0)
}
OTHER = {
    case
    for k, (fd, motor, kind) in enumerate(product(BUSES, MOTOR_NAMES, KINDS_OF_CURRENT))
    for name, speed in [[*product(FILTERS, SPEEDS)][k % 6]]
    for case in [Case(kind, speed, motor, name, fd)]
}
"""Each kind on each bus and motor once more, filters and speeds in turn; a change has the UKF's."""


def name_of(case):
    bus = "fd" if case.fd else "classic"
    return f"{case.kind}-{case.speed:.0f}-{case.motor}-{case.filter}-{bus}"


def marks_of(case):
    if case in QUICK:
        return ()
    other = case in OTHER and case.filter == "ukf"
    return pytest.mark.slow if other else [pytest.mark.slow, pytest.mark.thorough]


@pytest.mark.parametrize("case", [pytest.param(c, marks=marks_of(c), id=name_of(c)) for c in CASES])
def test_wrong_currents_are_unknown_and_never_a_loss(case):
    judged(case)


@pytest.mark.parametrize("load", [0.15, 0.25])
@pytest.mark.parametrize("kind", ["tenth", "tenfold", "rotated", "swapped"])
def test_wrong_currents_at_little_load_accuse_nobody(kind, load):
    """Their torque is not far enough from the reported one to be invalid, and far from the load."""
    outcome = run_case(Case(kind, speed=130.0, load=load))
    rows = [*outcome.mine, *outcome.after, *(row for rows in outcome.others for row in rows)]
    assert Flag.BAD not in {row.flag for row in rows}


@pytest.mark.parametrize("fd", BUSES)
@pytest.mark.parametrize("motor", MOTOR_NAMES)
@pytest.mark.parametrize("kind", ["held", "held_drive"])
def test_what_is_held_from_the_start_is_never_believed(kind, motor, fd):
    judged(Case(kind, 200.0, motor, "ekf", fd, begin=0, ticks=300))


@pytest.mark.parametrize("fd", BUSES)
@pytest.mark.parametrize("name", FILTERS)
def test_a_measured_speed_that_stands_while_the_others_rise_is_noticed(name, fd):
    case = Case("held_motion", 100.0, "bench", name, fd, gains=20.0)
    assert min(run_case(case).off_rpm[20:]) > 5.0
    judged(case)


@pytest.mark.parametrize("held_tick", [50, 120, 170], ids=["at rest", "slowing", "nearly at rest"])
def test_a_motion_that_is_held_accuses_nobody_when_its_train_starts(held_tick):
    """At a crawl it alone shows the load; later the train passes the speed at which it stands."""
    fast, still = 40.0 if held_tick > 100 else 0.0, (2.0, 0.0)
    frames = driven(((0.0, fast), still, (2.5, 0.0), (6.0, 80.0)), "bench", False, 600)
    bound = codec(NODES, CLASSIC)
    core, faults = Gateway(config_of(Case("held_motion")), bound, 0), ValueFaults(bound, NODES)
    flags = []
    for tick, sent in enumerate(frames, start=1):
        held = [("held_motion", 1)] if tick > held_tick else []
        core.step(faults.apply(held, sent), tick * TICK)
        flags.append([drive.adhesion for drive in core.view.drives])
    assert all(Flag.BAD not in row for row in flags)
    assert flags[-1] == [Flag.GOOD, Flag.UNKNOWN, Flag.GOOD]


@pytest.mark.parametrize("kind", VALUE_KINDS)
def test_the_cases_matter(kind):
    """Else nothing need be noticed, and the tests above would be about nothing."""
    outcome = run_case(Case(kind, 290.0, gains=20.0 if kind == "held_motion" else 0.0))
    off = outcome.off_rpm if kind == "held_motion" else outcome.off
    assert len(off) > 5
    assert math.fsum(off) / len(off) > MATTERS
