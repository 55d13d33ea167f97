"""The core in the storm: a seed's faults, tick by tick, watched by the oracle.

python -m tests.storm --seeds 0-19 --ticks 100000
"""

from __future__ import annotations

import subprocess
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np

import gateway
from dbc.block import join
from gateway.config import parse
from gateway.core import Gateway
from gateway.health import REJECTED
from sim.hostile import KINDS, NOTHING, Arrived, HostileBus, plan
from tests.storm.oracle import Oracle, Violation
from tests.storm.train import LOOP_TICKS, NODES, PHASES, TICK, train

CALIBRATION = Path(gateway.__path__[0]) / "bench_calibration.toml"
QUEUE = 278
"""Frames that the kernel keeps for a process that does not read; the newest are lost."""
MOST_FOUND = 20
FD_SEEDS = 1000
ENDS = ("decoded", "error_frame", "remote", "own", "canopen", "unknown_id", *REJECTED)
"""Every frame ends in exactly one of these counters."""


def commit_of(folder: Path) -> str:
    """Which commit the code in a repository is of, `-dirty` if it was changed since.

    The soak's own results do not count: they grow by each seed.
    """

    def git(*words: str) -> str:
        done = subprocess.run(
            ["git", "-C", str(folder), *words], capture_output=True, text=True, check=False
        )
        return done.stdout.strip()

    paths = ":/", ":(top,exclude)tests/storm/soak.jsonl"
    changed = git("status", "--porcelain", "--untracked-files=no", "--", *paths)
    return (git("rev-parse", "--short", "HEAD") or "unknown") + ("-dirty" if changed else "")


COMMIT = commit_of(Path(__file__).parent)
"""Of this process: what it runs is what it has loaded, whatever is committed while it does."""


class Result(NamedTuple):
    """What a seed came to.

    said: ticks by (flag, state), over all drives; met: ticks by (fault, phase, drive), drive 0 for
    all of them.
    """

    seed: int
    ticks: int
    found: list[Violation]
    said: Counter[tuple[str, int]]
    met: Counter[tuple[str, str, int]]
    frames: int
    rejected: Counter[str]

    def text(self) -> str:
        """The violations, and the command and commit that repeat them."""
        lines = [f"  tick {v.tick} drive {v.drive} {v.rule}: {v.what}" for v in self.found]
        again = f"python -m tests.storm --seeds {self.seed} --ticks {self.ticks} # on {COMMIT}"
        return "\n".join([f"seed {self.seed}: {again}", *lines])


def config_of(seed: int):
    """EKF and UKF, all detectors, classic CAN and, from seed 1000 on, CAN FD: by seed."""
    return parse({
        "dbc": {"file": "traction_fd.dbc" if seed >= FD_SEEDS else "traction.dbc"},
        "estimator": {"kind": ("ekf", "ekf", "ukf")[seed % 3]},
        "adhesion": {"detector": ("vb", "median", "kmeans", "vmp")[seed // 3 % 4]},
        "thermal": {"calibration": str(CALIBRATION)},
    })  # fmt: skip


def weather(seed: int, ticks: int, between: float = 350.0) -> Result:
    """Run one seed. between: mean ticks from one fault to the next."""
    config = config_of(seed)
    honest = train(config.dbc_path)
    ids = [
        [spec.can_id for spec in honest.codec.messages if spec.name.startswith(f"Drive{n}_")
         and not spec.is_gateway]
        for n in NODES
    ]  # fmt: skip
    bus = HostileBus(plan(seed, ticks, len(NODES), between), ids, seed)
    met: Counter[tuple[str, str, int]] = Counter()
    counts: Counter[str] = Counter()
    found: list[Violation] = []
    said: Counter[tuple[str, int]] = Counter()

    def start(tick: int) -> tuple[Gateway, Oracle]:
        return Gateway(config, honest.codec, (tick - 1) * TICK), Oracle(honest.codec, config, tick)

    def end() -> None:
        nonlocal counts
        counts += core.inbox.counts
        found.extend(oracle.found)
        said.update(oracle.said)
        seen = core.inbox.counts
        if seen["received"] != sum(seen[name] for name in ENDS):
            found.append(Violation(tick, "counted", 0, f"frames do not add up: {dict(seen)}"))

    core, oracle = start(1)
    waiting, stopped = NOTHING, 0
    tick = 0
    for tick in range(1, ticks + 1):
        now = tick * TICK
        came = bus.carry(honest.sent(tick), lambda: honest.elsewhere(tick), tick, now)  # noqa: B023
        faults = bus.active(tick)
        k = (tick - 1) % LOOP_TICKS
        for fault in faults:
            met[
                fault.kind, PHASES[honest.phase[k]], 0 if fault.drive is None else fault.drive + 1
            ] += 1
        if stopped or any(f.kind == "process_stop" for f in faults):
            dropped = max(waiting.block.size + came.block.size - QUEUE, 0)
            core.doubt.note_lost(dropped)
            oracle.note_lost(dropped)
            waiting = _queued(waiting, came)
            if any(f.kind == "process_stop" for f in faults):
                stopped += 1
                continue
            came, waiting = waiting, NOTHING
            core.doubt.note_overrun(stopped)
            stopped = 0
        if any(f.kind == "restart" and f.first == tick for f in faults):
            end()
            core, oracle = start(tick)
        out = core.step(came.block, now)
        oracle.look(tick, came, out, core.said, honest.speed[k], faults)
        if len(oracle.found) >= MOST_FOUND:
            break
    end()
    return Result(seed, tick, found, said, met, counts["received"], counts)


def _queued(waiting: Arrived, came: Arrived) -> Arrived:
    block = join(waiting.block, came.block).part(0, QUEUE)
    return Arrived(block, np.concatenate([waiting.genuine, came.genuine])[:QUEUE])


def uncovered(met: Counter[tuple]) -> list[tuple[str, str]]:
    """Pairs of fault and phase that were never met."""
    seen = {(kind, phase) for kind, phase, *_ in met}
    return [(kind, phase) for kind in KINDS for phase in PHASES if (kind, phase) not in seen]
