"""What the chain tests take for a machine that stalled; needs no bus."""

from types import SimpleNamespace

import pytest

from dbc.candump.writer import Writer
from dbc.frame import MS, Frame
from sim.scenario import parse_text
from sim.simulation import Simulation
from tests.hil.chain import FLAGS_ID, SOON_NS, excused, setting, stalled, stalls

SCENARIO = 'title = "t"\nseed = 1\nduration_s = 1\ndrives = 2\n'
SECOND_DRIVE = (0x182, 0x282, 0x382, 0x1C2, 0x482)


@pytest.fixture(params=["classic", "fd", "slower"])
def used(request, tmp_path):
    vcan = SimpleNamespace(name="vcan0")
    kind = request.param
    return setting(vcan, tmp_path, 2, fd=kind == "fd", slower=kind == "slower")


@pytest.fixture
def frames(used):
    """Half a second of drives, and the gateway's ticks from before to after."""
    simulation = Simulation(parse_text(SCENARIO, "t"), used.codec, start_ns=200 * MS)
    drives = simulation.step((), 700 * MS)
    return sorted([*drives, *(Frame(k * 10 * MS, FLAGS_ID, bytes(8)) for k in range(100))])


@pytest.fixture
def log(tmp_path):
    def write(frames):
        with Writer(tmp_path / "x.log") as writer:
            for frame in frames:
                writer.write(frame._replace(channel="vcan0"))
        return tmp_path / "x.log"

    return write


def test_a_quiet_run_is_one(used, frames, log):
    assert stalled(log(frames), used) == ""


def test_a_drive_spoke_in_bursts(used, frames, log):
    """Each batch within the time limit of its messages; nothing is missing."""
    spec = min(used.drives.values(), key=lambda spec: spec.cycle_ns)
    batch = 4 * spec.cycle_ns
    late = [
        f._replace(t_ns=f.t_ns // batch * batch + f.t_ns % spec.cycle_ns)
        if f.can_id == spec.can_id else f for f in frames
    ]  # fmt: skip
    assert stalled(log(sorted(late)), used).startswith(f"{spec.name}: ")


def test_the_gateway_was_away(used, frames, log):
    left = [f for f in frames if f.can_id != FLAGS_ID or f.t_ns != 400 * MS]
    assert stalled(log(left), used) == "the gateway: away for 20 ms"
    assert stalled(log(left), used, injected=True) == "the gateway: away for 20 ms"
    left.append(Frame(407 * MS, FLAGS_ID, bytes(8)))
    assert stalled(log(sorted(left)), used) == ""


def test_when_it_stood_still_is_known_to_the_frame(used, frames, log):
    assert stalls(log(frames), used) == []
    left = [f for f in frames if f.can_id != FLAGS_ID or f.t_ns != 400 * MS]
    assert stalls(log(left), used) == [(390 * MS, 410 * MS + SOON_NS)]
    left = [f for f in frames if f.can_id not in SECOND_DRIVE or not 400 < f.t_ns / MS < 440]
    found = stalls(log(left), used)
    assert found
    assert all(begun <= 400 * MS and ended >= 440 * MS + SOON_NS for begun, ended in found)


def test_outside_the_drives_time_the_gateway_may_do_as_it_likes(used, frames, log):
    left = [f for f in frames if f.can_id != FLAGS_ID or 150 * MS < f.t_ns < 750 * MS]
    assert stalled(log(left), used) == ""


def test_all_drives_were_silent(used, frames, log):
    left = [f for f in frames if f.can_id == FLAGS_ID or not 400 * MS < f.t_ns < 440 * MS]
    assert ": away for 4" in stalled(log(left), used)
    assert "the drives: away for 4" in stalled(log(left), used, injected=True)


def test_one_drive_was_silent(used, frames, log):
    left = [f for f in frames if f.can_id not in SECOND_DRIVE or not 400 < f.t_ns / MS < 440]
    assert stalled(log(left), used).startswith("Drive2_")
    assert stalled(log(left), used, injected=True) == ""


def test_frames_were_lost_in_a_row(used, frames, log):
    motion = [f for f in frames if f.can_id == 0x381]
    # All stamps are close together: what arrives says that time has gone on without the others.
    assert stalled(log(f for f in frames if f not in motion[5:7]), used) == ""
    late = [f._replace(t_ns=f.t_ns - 30 * MS) if f in motion[8:] else f for f in frames]
    left = sorted(f for f in late if f not in motion[5:8])
    assert stalled(log(left), used) == "Drive1_Motion: 1 jumps of the counter"


def test_only_what_failed_on_such_a_machine_is_passed_over(used, frames, log, capsys):
    good, bad = log(frames), [f for f in frames if f.can_id == FLAGS_ID or f.t_ns < 400 * MS]
    with pytest.raises(AssertionError, match="wrong"), excused(good, used):
        raise AssertionError("wrong")
    bad += [f for f in frames if f.can_id in used.drives and f.t_ns > 500 * MS]
    with excused(log(sorted(bad)), used):
        raise AssertionError("wrong")
    assert "away for 1" in capsys.readouterr().out
    with pytest.raises(ValueError, match="other"), excused(log(sorted(bad)), used):
        raise ValueError("other")
