"""The main job on a real bus: drives in one process, gateway in another, candump beside them."""

import csv
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from dbc.candump.reader import Reader
from gateway.cli import main
from gateway.core.codes import Flag, Reason
from gateway.reports.expectations import FlagTrack
from tests.hil.chain import (
    ATTEMPTS,
    FLAGS_ID,
    PATIENCE_S,
    SOON_NS,
    TICK_NS,
    FlagSocket,
    Recording,
    Setting,
    changes,
    drives_ns,
    excused,
    farewell_ns,
    lost_spans,
    memory_folder,
    own_frames,
    program,
    setting,
    stalls,
)
from tests.hil.inside import STALLS

pytestmark = [pytest.mark.vcan, pytest.mark.slow]

UNKNOWN, ADHERING, LOST = Flag.UNKNOWN, Flag.GOOD, Flag.BAD
DOUBT_TICKS = 10
SCENARIO = """
title = "a full loss in the middle"
seed = 10
duration_s = {seconds}
drives = {drives}
[[event]]
at_s = 2.5
for_s = 1.0
drive = 1
kind = "adhesion_loss"
depth = 1.0
"""


class Run(NamedTuple):
    """What a run of the chain left behind."""

    used: Setting
    log: Path
    truth: Path
    sent: int
    """Frames the gateway says it has sent."""
    late: int
    """Frames that it has not sent, because they were too late."""
    timing: Path
    """Its report of the timing."""


@pytest.fixture
def folder():
    with memory_folder() as path:
        yield path


def run_chain(vcan, folder, used, seconds):
    """Gateway, drives and candump, from the gateway's first frame to its last."""
    scenario, truth = folder / "s.toml", folder / "truth.csv"
    scenario.write_text(SCENARIO.format(seconds=seconds, drives=len(used.nodes)))
    recording = Recording(vcan, folder / "record")
    flags = FlagSocket(vcan, used.codec)
    timing = folder / "timing"
    words = ("run", *used.bus, "--quiet", "--config", str(used.config), "--results", str(timing))
    gateway = vcan.start(*program(vcan, *words), stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    flags.until(used.nodes, UNKNOWN)
    flags.close()
    words = ("sim", str(scenario), *used.bus, "--dbc", str(used.codec.path), "--truth", str(truth))
    drives = subprocess.run(program(vcan, *words), check=False, capture_output=True)
    assert drives.returncode == 0, drives.stderr.decode()
    time.sleep(1.0)
    gateway.terminate()
    output, errors = gateway.communicate(timeout=PATIENCE_S)
    assert gateway.returncode == 0, errors.decode()
    said = rb"sent (\d+), refused 0, queue full 0, link down 0; kernel drops 0.* be sent (\d+)"
    found = re.search(said, output)
    assert found is not None, output.decode()
    sent, late = (int(text) for text in found.groups())
    return Run(used, recording.end(), truth, sent, late, timing)


def checked_run(vcan, folder, drives, seconds, fd):
    """A run whose wire and replay are right.

    It is tried again where the machine stalled; classic then at a rate that a slower one carries,
    at last with two drives. A machine that stalls every time shows only that what the gateway sends
    is well protected and has no gap but for what was too late.
    """
    for k in range(ATTEMPTS):
        here = folder / f"run{k}"
        here.mkdir()
        count = drives if k < ATTEMPTS // 2 else 2
        used = setting(vcan, here, count, fd=fd, slower=k > 0 and not fd)
        run = run_chain(vcan, here, used, seconds)
        with excused(run.log, used):
            check_wire(run)
            check_replay(run)
            return run
        assert own_frames(run.log, used.codec, run.late) == run.sent > 1000
    pytest.skip(STALLS)


def check_wire(run):
    """The recording says what happened, without a gap and well protected."""
    used = run.used
    codec, nodes = used.codec, used.nodes
    assert own_frames(run.log, codec) == run.sent > 1000
    seen = changes(run.log, codec, nodes, farewell_ns(run.log))
    stood = stalls(run.log, used)
    said = without_doubts(seen["adhesion", 1], stood)
    assert [c.flag for c in said] == [UNKNOWN, ADHERING, LOST, ADHERING, UNKNOWN]
    for node in nodes[1:]:
        other = without_doubts(seen["adhesion", node], stood, 0)
        assert [c.flag for c in other] == [UNKNOWN, ADHERING, UNKNOWN]
    ((onset, end),) = lost_spans(run.truth, 1)
    heard = drives_ns(run.log, used)
    assert -0.02 < (said[2].t_ns - heard[0]) / 1e9 - onset < 0.3
    assert 0.0 < (said[3].t_ns - heard[0]) / 1e9 - end < 1.0
    # Silent drives are unknown, and known to be gone.
    assert 0 < said[4].t_ns - heard[-1] < 20 * TICK_NS
    assert seen["comm", 0][-1].flag is Flag.BAD


def without_doubts(said, stood=(), ticks=DOUBT_TICKS):
    """Without an unknown of a few ticks between two verdicts, or one while the machine stood still.

    Where stamps jitter, the ticks about the edges of a loss leave it open: neither adhering nor
    lost. stood: of `stalls`.
    """
    kept = []
    for c in said:
        if len(kept) > 1 and kept[-1].flag is UNKNOWN:
            begun = kept[-1].t_ns
            if c.t_ns - begun <= ticks * TICK_NS or any(a <= begun <= b for a, b in stood):
                kept.pop()
        if not kept or kept[-1].flag is not c.flag:
            kept.append(c)
    return kept


def by_ticks(said, t_ns):
    """The flag at each time, which is none before the first change."""
    changed_ns = np.array([c.t_ns for c in said])
    return np.array([c.flag for c in said])[np.searchsorted(changed_ns, t_ns, "right") - 1]


def check_replay(run):
    """A replay of the recording says the same, each verdict within two ticks.

    What one leaves open and the other does not are a few ticks: live stamps are those of the wire,
    a part of a tick later than the tick.
    """
    used = run.used
    again, stood = run.log.with_name("replayed.log"), stalls(run.log, used)
    assert main(["replay", str(run.log), "-o", str(again), "--config", str(used.config)]) == 0
    live = changes(run.log, used.codec, used.nodes, farewell_ns(run.log))
    replayed = changes(again, used.codec, used.nodes)
    assert live.keys() == replayed.keys()
    for key, of_wire in live.items():
        said, repeated = (without_doubts(each, stood) for each in (of_wire, replayed[key]))
        assert [c.flag for c in repeated] == [c.flag for c in said], (key, of_wire, replayed[key])
        first = max(of_wire[0].t_ns, replayed[key][0].t_ns)
        t_ns = np.arange(first, said[-1].t_ns + 100 * TICK_NS, TICK_NS)
        one, other = by_ticks(of_wire, t_ns), by_ticks(replayed[key], t_ns)
        opposite = (one != other) & (one != UNKNOWN) & (other != UNKNOWN)
        assert opposite.sum() <= 2 * (len(said) - 1), (key, of_wire, replayed[key])
        # What a gateway that stood still left open a replay decides.
        doubted = len(stood) * (SOON_NS // TICK_NS) + 2 * DOUBT_TICKS
        assert (one != other).sum() <= doubted + 2 * (len(said) - 1), (key, of_wire)


def test_main_job_and_its_replay(vcan, folder):
    run = checked_run(vcan, folder, drives=3, seconds=6.0, fd=False)
    cantools = Path(sys.executable).with_name("cantools")
    decoded = subprocess.run(
        [str(cantools), "decode", "--single-line", str(run.used.codec.path)],
        input=run.log.read_bytes(), capture_output=True, check=True,
    ).stdout.decode()  # fmt: skip
    assert "Adhesion1: AdhesionLost" in decoded
    assert "Adhesion2: Adhering" in decoded
    assert "Adhesion2: AdhesionLost" not in decoded
    assert "Detector: Switching" in decoded
    # Every tick with new samples was measured, from the kernel's stamp to the flag on the bus.
    with (run.timing / "timing.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["stage"] == "frame to flag"]
    assert sum(int(row["count"]) for row in rows) > 400
    on_bus = [float(us) for us in re.findall(r"LatencyP99: (\d+)", decoded)]
    assert on_bus
    assert 0.0 < on_bus[-1] <= float(rows[-1]["below_us"])


def test_main_job_on_can_fd(vcan, folder):
    run = checked_run(vcan, folder, drives=2, seconds=6.0, fd=True)
    text = run.log.read_text()
    assert " 181##" in text
    assert " 1A0#" in text


def test_late_interface_and_a_link_that_goes_and_comes(vcan, folder):
    """Flags are unknown when the drives cannot be heard, and come back by themselves."""
    used = setting(vcan, folder, drives=3, slower=vcan.own_kernel)
    codec, nodes = used.codec, used.nodes
    scenario = folder / "s.toml"
    scenario.write_text(SCENARIO.format(seconds=600, drives=3).split("[[event]]")[0])
    vcan.link("delete")
    words = ("run", *used.bus, "--quiet", "--config", str(used.config))
    gateway = vcan.start(*program(vcan, *words), stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert gateway.stderr is not None
    assert b"bus is absent" in gateway.stderr.readline()
    vcan.link("create")
    recording = Recording(vcan, folder / "record")
    flags = FlagSocket(vcan, codec)
    words = ("sim", str(scenario), *used.bus, "--dbc", str(used.codec.path))
    drives = vcan.start(*program(vcan, *words), stderr=subprocess.DEVNULL)
    flags.until(nodes, ADHERING)
    flags.close()
    vcan.link("down")
    down_ns = time.time_ns()
    time.sleep(0.5)
    flags = FlagSocket(vcan, codec)
    up_ns = time.time_ns()
    vcan.link("up")
    flags.until(nodes, ADHERING)
    flags.close()
    for process in (drives, gateway):
        process.send_signal(signal.SIGTERM)
        process.wait(timeout=PATIENCE_S)
        # Drives that a signal ends have not come to the end of their scenario.
        assert process.returncode == (128 + signal.SIGTERM if process is drives else 0)
    log = recording.end()

    said = [f for f in Reader(log) if f.can_id == FLAGS_ID]
    assert not [f for f in said if down_ns < f.t_ns < up_ns]
    first = next(f for f in said if f.t_ns > up_ns)
    reason = codec.decode(codec.by_id[FLAGS_ID], first.data)["Reason"].raw
    # Depends on what the drives sent before it: nothing, the first frame after the gap in their
    # counters, or enough for the filters to start again.
    assert Reason(int(reason)) in (Reason.STALE, Reason.SEQUENCE, Reason.STARTING)
    track = FlagTrack(codec, nodes)
    track.store(said)
    for node in nodes:
        flag = track.seen["adhesion", node]
        assert ADHERING in {state for t_ns, state in flag if t_ns < down_ns}
        # The very first frame after the silence takes the last good verdict back.
        assert (first.t_ns, UNKNOWN) in flag
        assert ADHERING in {state for t_ns, state in flag if t_ns > up_ns}
        assert LOST not in {state for _, state in flag}
