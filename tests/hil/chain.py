"""Pieces of the chain tests: message sets, processes, recordings, and what the wire says."""

import csv
import itertools
import shutil
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import gateway
from dbc.candump.reader import Reader
from dbc.codec import Codec, bind
from dbc.e2e import COUNTERS, MAX_DELTA, Check, Receiver, counter_of, crc_ok
from dbc.spec import MessageSpec
from gateway.core.codes import Flag
from gateway.io.transport import EMCY_ID, HEARTBEAT_ID
from gateway.reports.expectations import FlagTrack
from gateway.settings.config import shipped_dbc
from tests.dbc_text import with_cycles
from tests.programs import await_state

PATIENCE_S = 90.0
TICK_NS = 10_000_000
FLAGS_ID = 0x1A0
MOST_BETWEEN_TICKS_NS = 18_000_000
"""A live loop that was once later than this had no processor: a tick is missing."""
MOST_LATE = 0.1
"""Of a message's frames: later than that, stamps say little of when something was measured."""
SOON_NS = 300_000_000
"""After a machine has stood still: all messages have come again, and flags have been decided."""
ATTEMPTS = 6
"""A failure counts if the machine did not stall; it may do so this often less one."""


class Setting(NamedTuple):
    """A message set, the configuration that names it, and the bus options of both programs."""

    codec: Codec
    config: Path
    nodes: tuple[int, ...]
    bus: tuple[str, ...]
    drives: Mapping[int, MessageSpec]
    """The drives' messages by id."""


class Change(NamedTuple):
    """A flag, and when it came on the wire."""

    t_ns: int
    flag: Flag


def stale_ns(spec):
    """Age at which a message is stale: three cycles and a tick."""
    return 3 * spec.cycle_ns + TICK_NS


def setting(vcan, folder, drives, *, fd=False, slower=False):
    """The shipped message set, or a copy of the classic one for a slower bus."""
    dbc = shipped_dbc("traction_fd.dbc" if fd else "traction.dbc")
    if slower:
        dbc = for_slower_bus(dbc, folder)
    nodes = tuple(range(1, drives + 1))
    calibration = Path(gateway.__path__[0]) / "bench_calibration.toml"
    config = folder / "train.toml"
    config.write_text(
        f'[dbc]\nfile = "{dbc}"\n[thermal]\ncalibration = "{calibration}"\n'
        + "".join(f"[[drive]]\nnode = {n}\n" for n in nodes)
    )
    bus = ("-i", "socketcan", "-c", vcan.name, *(["--fd"] if fd else []))
    codec = bind(dbc, nodes)
    drives = {m.can_id: m for m in codec.messages if m.node in nodes and not m.is_gateway}
    return Setting(codec, config, nodes, bus, drives)


def for_slower_bus(dbc, folder):
    """A copy of the classic DBC that says so, as users make it: 40 % of the frames.

    Currents and voltages every 5 ms instead of 2, Motion every 20 instead of 10.
    """
    bases = {0x180: 5, 0x280: 5, 0x380: 20}
    cycles = {base + node: ms for base, ms in bases.items() for node in range(1, 17)}
    return with_cycles(dbc, folder / "slower.dbc", cycles)


@contextmanager
def memory_folder():
    """A folder in memory: writing to the host's files stops a user-mode kernel altogether."""
    folder = Path(tempfile.mkdtemp(dir="/dev/shm"))
    try:
        yield folder
    finally:
        shutil.rmtree(folder)


def favoured(vcan, priority):
    """What a command line begins with.

    In a kernel of our own, with one processor, somebody must wait: other work for the drives, and
    they for the gateway (`-R`: those that `hil` starts, too).
    """
    return ["chrt", "-R", "-f", str(priority)] if vcan.own_kernel else []


def program(vcan, verb, *words):
    """A command line of ours."""
    first = favoured(vcan, 10 if verb == "sim" else 20)
    return [*first, sys.executable, "-m", "gateway", verb, *words]


class Recording:
    """candump beside the others; `end` gives the log. It lives through a link that is down."""

    def __init__(self, vcan, folder, name=""):
        """name: the interface, or "any" for those, too, that are not there yet."""
        name = name or vcan.name
        folder.mkdir(parents=True)
        self._folder = folder
        before = vcan.listeners(name)
        # The kernel stamps frames and keeps them, so it can wait until nobody else has work to do.
        idle = ["chrt", "-i", "0"] if vcan.own_kernel else []
        self._process = vcan.start(
            *(*idle, "candump", "-l", "-D", "-r", str(256 << 20), name),
            cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        # It makes its file once it listens; a gateway that comes to a late link listens, too.
        wait_for(lambda: any(folder.iterdir()) and vcan.listeners(name) > before, "candump")

    def end(self):
        """Call it when the bus is quiet: candump sleeps once it has read all."""
        (log,) = self._folder.glob("candump-*.log")
        await_state(self._process.pid, "S")
        self._process.terminate()
        self._process.wait(timeout=PATIENCE_S)
        return log


class FlagSocket:
    """The gateway's adhesion frames only, as they come: next to no work for a slow machine."""

    def __init__(self, vcan, codec):
        self._codec = codec
        self._raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        only = struct.pack("=II", FLAGS_ID, 0x7FF)
        self._raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, only)
        self._raw.bind((vcan.name,))
        self._raw.settimeout(PATIENCE_S)

    def until(self, nodes, flag):
        """Wait for a frame that says `flag` for all `nodes`."""
        deadline = time.monotonic() + PATIENCE_S
        spec = self._codec.by_id[FLAGS_ID]
        while time.monotonic() < deadline:
            try:
                data = self._raw.recv(16)[8:]
            except OSError:  # told once that the link is down
                continue
            values = self._codec.decode(spec, data)
            if all(values[f"Adhesion{n}"].raw == flag for n in nodes):
                return
        raise AssertionError(f"{flag.name} of {nodes}: not within {PATIENCE_S} s")

    def close(self):
        self._raw.close()


def wait_for(fulfilled, what):
    """Poll a condition; the machine may be very slow."""
    deadline = time.monotonic() + PATIENCE_S
    while not fulfilled():
        assert time.monotonic() < deadline, f"{what}: not within {PATIENCE_S} s"
        time.sleep(0.05)


Changes = dict[tuple[str, int], list[Change]]


def changes(log, codec, nodes, until_ns=None):
    """Changes of every flag in a log, its first value included; node 0: of the set."""
    track = FlagTrack(codec, nodes)
    track.store(f for f in Reader(log) if until_ns is None or f.t_ns < until_ns)
    found = {}
    for key, seen in track.seen.items():
        kept = found.setdefault(key, [])
        for t_ns, flag in seen:
            if not kept or kept[-1].flag is not flag:
                kept.append(Change(t_ns, flag))
    return found


def farewell_ns(log):
    """When the gateway began to say goodbye: three last flag frames of unknown."""
    return [f.t_ns for f in Reader(log) if f.can_id == FLAGS_ID][-3]


def stalled(log, used, *, injected=False):
    """How the machine stood still or lost frames while the drives were there; empty if not.

    Judged from the wire; nothing here looks at flags. A drive whose program has no processor is
    silent, a gateway that has none is late. `injected`: the scenario itself makes single drives
    silent or loses their frames.
    """
    frames = list(Reader(log))
    heard = [f for f in frames if f.can_id in used.drives]
    there = range(heard[0].t_ns, heard[-1].t_ns + 1)
    ticks = [f for f in frames if f.can_id == FLAGS_ID and f.t_ns in there]
    found = [_away("the gateway", ticks, MOST_BETWEEN_TICKS_NS)]
    if injected:
        fastest = min(used.drives.values(), key=stale_ns)
        found.append(_away("the drives", heard, stale_ns(fastest)))
    else:
        for can_id, spec in used.drives.items():
            own = [f for f in heard if f.can_id == can_id]
            found += [_away(spec.name, own, stale_ns(spec)), _jumped(spec, own), _late(spec, own)]
    return next(filter(None, found), "")


def stalls(log, used):
    """(from, to) in ns of every time in which the machine stood still; none on a quiet one.

    A flag that becomes unknown then, or soon after, does what it should.
    """
    frames = list(Reader(log))
    heard = [f.t_ns for f in frames if f.can_id in used.drives]
    limits = {i: 2 * spec.cycle_ns + TICK_NS for i, spec in used.drives.items()}
    limits[FLAGS_ID] = MOST_BETWEEN_TICKS_NS
    found = []
    for can_id, limit_ns in limits.items():
        own = [f.t_ns for f in frames if f.can_id == can_id and heard[0] <= f.t_ns <= heard[-1]]
        found += [(a, b + SOON_NS) for a, b in itertools.pairwise(own) if b - a > limit_ns]
    return sorted(found)


@contextmanager
def excused(log, used, *, injected=False):
    """A failure on a machine that stalled says nothing: it is printed and passed over."""
    try:
        yield
    except AssertionError as failure:
        why = stalled(log, used, injected=injected)
        if not why:
            raise
        print(f"does not count ({why}): {failure}")


def _away(who, frames, limit_ns):
    longest = max((b.t_ns - a.t_ns for a, b in itertools.pairwise(frames)), default=limit_ns + 1)
    return f"{who}: away for {longest / 1e6:.0f} ms" if longest > limit_ns else ""


def _jumped(spec, frames):
    """More frames in a row are missing than the protection tolerates."""
    counters = [counter_of(spec, f.data) or 0 for f in frames]
    steps = [(b - a) % COUNTERS[spec.profile] for a, b in itertools.pairwise(counters)]
    jumps = sum(not 1 <= step <= MAX_DELTA for step in steps)
    return f"{spec.name}: {jumps} jumps of the counter" if jumps else ""


def _late(spec, frames):
    """Too many frames have waited for a processor and come in bursts."""
    gaps = [b.t_ns - a.t_ns for a, b in itertools.pairwise(frames)]
    late = sum(gap > 2 * spec.cycle_ns for gap in gaps)
    return f"{spec.name}: {late} of {len(gaps)} late" if late > MOST_LATE * len(gaps) else ""


def drives_ns(log, used):
    """Stamps of everything that drives sent."""
    return [f.t_ns for f in Reader(log) if f.can_id in used.drives]


def own_frames(log, codec, late=0):
    """Number of the gateway's frames; each one is protected well and follows the one before.

    late: how many were not sent because they were too late, and are missing between them.
    """
    receivers = {m.can_id: Receiver(m) for m in codec.messages if m.is_gateway}
    count = gaps = 0
    for frame in Reader(log):
        receiver = receivers.get(frame.can_id)
        count += receiver is not None or frame.can_id in (HEARTBEAT_ID, EMCY_ID)
        if receiver is not None:
            assert crc_ok(codec.by_id[frame.can_id], frame.data)
            checked = receiver.check(frame.data)
            assert checked is not Check.REPEATED
            gaps += checked is not Check.OK
    assert late or not gaps
    return count


def lost_spans(truth, drive):
    """(from, to) in s where `sim --truth` says that the drive had no adhesion."""
    spans = []
    with truth.open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if int(row["drive"]) == drive]
    for before, row in itertools.pairwise(rows):
        if row["lost"] > before["lost"]:
            spans.append((float(row["t_s"]), float(row["t_s"])))
        if row["lost"] == "1":
            spans[-1] = (spans[-1][0], float(row["t_s"]))
    return spans
