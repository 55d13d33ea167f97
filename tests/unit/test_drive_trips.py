"""A drive trips while the others pull on: its torque is gone, its `Status` comes up to 0.1 s later.

On the bus this is a load that vanishes at constant speed; `State` Fault in every later `Status`;
and an emergency, at once, from drives that send one.
"""

from functools import cache

import numpy as np
import pytest

from dbc.e2e import protect
from dbc.frame import MS, Frame
from gateway.core.codes import Flag, Reason
from gateway.core.gateway import Gateway
from gateway.settings.config import parse
from sim.simulation import Simulation
from tests.simrun import TICK, codec, run, scenario

AT_S, END_S = 2.02, 4.0
FAULT, OPERATION = 3, 2
OVERCURRENT = b"\x10\x23" + bytes(6)
LATER = round(AT_S * 100)
"""Tick in which it trips."""


@cache
def frames(drives, tripped, state=FAULT, emergencies_ms=(), code=OVERCURRENT):
    """Frames of a run in which some drives trip; state: what their `Status` says from then on."""
    nodes = tuple(range(1, drives + 1))
    events = [{"at_s": AT_S, "drive": node, "kind": "adhesion_loss", "depth": 1.0, "for_s": 5.0}
              for node in tripped]  # fmt: skip
    table = scenario(
        seed=5, duration_s=END_S, drives=drives, motion={"speed": 150.0}, event=events,
        load={"kind": "preset", "torque_nm": 18.0},
    )  # fmt: skip
    bits, out = codec(nodes), []
    told = {bits.by_name[f"Drive{node}_Status"].can_id: f"Drive{node}_Status" for node in tripped}
    for frame in run(Simulation(table, bits), END_S):
        if frame.can_id in told and frame.t_ns > AT_S * 1e9:
            spec = bits.by_name[told[frame.can_id]]
            values = {k: v.value for k, v in bits.decode(spec, frame.data).items()}
            payload = bits.encode(spec, values | {"State": state, "FaultCode": 0x123})
            protect(spec, payload, frame.data[1] & 15)
            out.append(frame._replace(data=bytes(payload)))
        else:
            out.append(frame)
    out += [Frame(round(AT_S * 1e9) + ms * MS, 0x080 + node, code, 0, "can0")
            for node in tripped for ms in emergencies_ms]  # fmt: skip
    return sorted(out, key=lambda frame: (frame.t_ns, frame.can_id))


def judged(drives, *given, detector="switching", **more):
    """Flags and reasons (ticks, N), one a tick."""
    nodes = range(1, drives + 1)
    config = parse({"drive": [{"node": n} for n in nodes], "adhesion": {"detector": detector}})
    core = Gateway(config, codec(tuple(nodes)), 0)
    waiting, at, seen = frames(drives, *given, **more), 0, []
    for now in range(TICK, round(END_S * 1e9) + 1, TICK):
        first = at
        while at < len(waiting) and waiting[at].t_ns <= now:
            at += 1
        core.step(waiting[first:at], now)
        seen.append([(drive.adhesion, drive.adhesion_reason) for drive in core.view.drives])
    flags, reasons = np.array(seen)[LATER:].transpose(2, 0, 1)
    return flags, reasons


@pytest.mark.parametrize("detector", ["switching", "vb"])
@pytest.mark.parametrize(("drives", "tripped"), [(3, (2,)), (3, (1, 3)), (2, (1,)), (3, (1, 2, 3))])
def test_a_drive_that_trips_is_lost_for_no_longer_than_its_status_takes(drives, tripped, detector):
    flags, reasons = judged(drives, tripped, detector=detector)
    gone = np.isin(np.arange(1, drives + 1), tripped)
    assert (flags[:, gone] == Flag.BAD).any(axis=1).sum() <= 15, "0.1 s, and as long as it clears"
    assert (flags[20:, gone] == Flag.UNKNOWN).all()
    assert (reasons[20:, gone] == Reason.NOT_AVAILABLE).all()
    assert (flags[:, ~gone] != Flag.BAD).all()
    assert (flags[20:, ~gone] == Flag.GOOD).all()


@pytest.mark.parametrize("detector", ["switching", "vb"])
@pytest.mark.parametrize(
    ("drives", "tripped"), [(3, (2,)), (3, (1, 3)), (2, (1,)), (3, (1, 2, 3)), (1, (1,))]
)
def test_with_an_emergency_it_is_never_lost(drives, tripped, detector):
    flags, reasons = judged(drives, tripped, emergencies_ms=(2,), detector=detector)
    gone = np.isin(np.arange(1, drives + 1), tripped)
    assert (flags != Flag.BAD).all()
    assert (reasons[20:, gone] == Reason.NOT_AVAILABLE).all()
    assert (flags[20:, ~gone] == Flag.GOOD).all()


@pytest.mark.parametrize("emergencies_ms", [(2,), tuple(range(0, 2000, 30))], ids=["one", "many"])
def test_an_emergency_of_a_drive_that_operates_hides_no_loss(emergencies_ms):
    flags, _ = judged(3, (2,), state=OPERATION, emergencies_ms=emergencies_ms)
    assert (flags[15:, 1] == Flag.BAD).all()
    assert (flags[:, [0, 2]] == Flag.GOOD).all()


@pytest.mark.parametrize("code", [bytes(8), OVERCURRENT[:7]], ids=["no error left", "too short"])
def test_what_reports_no_error_explains_nothing(code):
    flags, _ = judged(3, (2,), state=OPERATION, emergencies_ms=(2,), code=code)
    plain, _ = judged(3, (2,), state=OPERATION)
    assert (flags == plain).all()
