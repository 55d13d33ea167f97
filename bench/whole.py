"""Whole processes: start, a short log, a long one. Time from the first fork to the last exit.

References run in turns with ours. Peak memory is what the kernel says of a process that a small one
starts: one that is started from here would begin with what is in memory here.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Final, NamedTuple

from bench.speed import as_installed, quiet
from bench.wire import whole
from dbc.candump.reader import Reader
from dbc.candump.writer import Writer
from dbc.frame import SECOND
from gateway.settings.config import shipped_dbc

HEADER = ("figure", "measured", "reference in the same run", "ratio", "peak memory")
ROUNDS: Final = 9
SHORT_S: Final = 21.0
MINUTES: Final = (2, 20)
"""Of the long logs: one of `LONG_S` that is recorded, and it again and again."""
LONG_S: Final = 120.0
BARE: Final = ("-c", "pass")
_MEASURE: Final = """
import json, os, sys, time
null = os.open(os.devnull, os.O_WRONLY)
act = [(os.POSIX_SPAWN_DUP2, null, 1)]
began = time.perf_counter()
pid = os.posix_spawn(sys.argv[1], sys.argv[1:], os.environ, file_actions=act)
_, status, usage = os.wait4(pid, 0)
spent = time.perf_counter() - began
print(json.dumps([spent, usage.ru_maxrss / 1024, os.waitstatus_to_exitcode(status)]))
"""


class Spent(NamedTuple):
    """Of a whole process: s, MB at its peak."""

    seconds: float
    peak_mb: float


def process(*words: str) -> Spent:
    """A process of Python. Raises AssertionError unless it ends with 0."""
    command = [sys.executable, "-I", "-S", "-c", _MEASURE, sys.executable, *words]
    done = subprocess.run(command, check=True, capture_output=True, text=True, env=as_installed())
    seconds, peak, code = json.loads(done.stdout)
    assert code == 0, (words, done.stderr)
    return Spent(seconds, peak)


def ours(*words: str) -> tuple[str, ...]:
    return ("-m", "gateway", *words)


def in_turns(rounds: int, *commands: Sequence[str]) -> list[list[Spent]]:
    """Each command once a round, after a round that does not count; a list for each of them."""
    for command in commands:
        process(*command)
    turns = [[process(*command) for command in commands] for _ in range(rounds)]
    return [list(each) for each in zip(*turns, strict=True)]


def starts() -> list[tuple[str, ...]]:
    """What a command takes before it works."""
    train = str(Path("examples/train.toml").resolve())
    commands = {"--help": ours("--help"), "check examples/train.toml": ours("check", train)}
    bare, *each = in_turns(ROUNDS, BARE, *commands.values())
    least = median(one.seconds for one in bare)
    out = []
    for name, spent in zip(commands, each, strict=True):
        more = median(a.seconds - b.seconds for a, b in zip(spent, bare, strict=True))
        out.append((
            f"start of `{name}`, above a bare Python", f"{1e3 * more:.0f} ms",
            f"`python -c pass` {1e3 * least:.0f} ms, {_peak(bare)}", "", _peak(spent),
        ))  # fmt: skip
    return out


def short(folder: Path) -> tuple[list[tuple[str, ...]], float]:
    """A log of 21 s against the chain; and how many frames a second the chain does."""
    log, dbc = folder / "short.log", shipped_dbc("traction.dbc")
    quiet("sim", "healthy", "--duration", str(SHORT_S), "-o", str(log))
    frames = whole(log).size
    replay = ours("replay", str(log), "-o", str(folder / "flags.log"))
    mine, theirs = in_turns(3, replay, ("-m", "bench.chain", str(log), str(dbc)))
    a, b = (median(one.seconds for one in each) for each in (mine, theirs))
    row = (
        f"replay of a log of {SHORT_S:.0f} s ({frames / 1e3:.0f} k frames)", f"{a:.2f} s",
        f"LogReader + cantools + filterpy {b:.2f} s, {_peak(theirs)}", f"{b / a:.1f} x",
        _peak(mine),
    )  # fmt: skip
    return [row], frames / b


def long(folder: Path, chain_hz: float) -> list[tuple[str, ...]]:
    """Logs of two lengths. chain_hz: frames a second of the chain, whole process."""
    part = folder / "part.log"
    quiet("sim", "healthy", "--duration", str(LONG_S), "-o", str(part))
    out = []
    for minutes in MINUTES:
        log = folder / f"{minutes}.log"
        frames = repeated(part, log, round(60 * minutes / LONG_S))
        (mine,) = in_turns(3, ours("replay", str(log), "-o", str(folder / "flags.log")))
        seconds = median(one.seconds for one in mine)
        out.append((
            f"replay of a log of {minutes} min ({frames / 1e6:.2f} M frames)",
            f"{seconds:.2f} s, {frames / seconds / 1e6:.2f} M frames/s",
            f"chain {chain_hz / 1e3:.1f} k frames/s", f"{frames / seconds / chain_hz:.0f} x",
            _peak(mine),
        ))  # fmt: skip
        log.unlink()
    return out


def repeated(part: Path, log: Path, times: int) -> int:
    """A log so many times behind itself, each later; how many frames that is.

    At a seam the counters of all messages jump, as after a pause of the bus.
    """
    count, length = 0, round((LONG_S + 1.0) * SECOND)
    with Writer(log) as out:
        for k in range(times):
            for block in Reader(part).blocks():
                out.write_block(block._replace(t_ns=block.t_ns + k * length))
                count += block.size
    return count


def _peak(spent: Sequence[Spent]) -> str:
    return f"{max(one.peak_mb for one in spent):.0f} MB"


def rows() -> list[tuple[str, ...]]:
    with tempfile.TemporaryDirectory() as name:
        against_chain, chain_hz = short(Path(name))
        return [*starts(), *against_chain, *long(Path(name), chain_hz)]
