"""The core in the storm: a seed's faults, tick by tick, watched by the oracle.

python -m tests.storm --seeds 0-19 --ticks 100000
"""

from collections import Counter
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

import gateway
from dbc.frames import Block, join
from gateway.core.codes import REJECTED
from gateway.core.gateway import Gateway
from gateway.settings.config import parse
from tests.provenance import code_of, commit_of
from tests.storm.bus_faults import BUS_KINDS, KINDS, NOTHING, Arrived, Fault, HostileBus, plan
from tests.storm.oracle import Oracle, Violation
from tests.storm.train import LOOP_TICKS, NODES, PHASES, TICK, train
from tests.storm.value_faults import Error, ValueFaults
from tests.storm.values import truth_at

CALIBRATION = Path(gateway.__path__[0]) / "bench_calibration.toml"
QUEUE = 278
"""Frames that the kernel keeps for a process that does not read; the newest are lost."""
MOST_FOUND = 20
FD_SEEDS = 1000
VALUE_SEEDS = range(2000, 3000)
"""Seeds whose drives also send wrong values, half of them on a train without a slip limit.

Those of before bring what they always did: a seed in a report or a test stays the same storm.
"""
MOST_TICKS = 64
"""Of a gateway that is stepped several ticks in a call."""
_LENGTHS, _FIRST = 3, 4
"""Purposes of random streams: the plan of faults and their chances have the first two."""
ENDS = ("decoded", "error_frame", "remote", "own", "canopen", "unknown_id", *REJECTED)
"""Every frame ends in exactly one of these counters."""


COMMIT = commit_of(Path(__file__).parent)
"""Of this process: what it runs is what it has loaded, whatever is committed while it does."""
CODE = code_of(Path(__file__).parents[2])
"""The same of everything that a storm needs, this file and the oracle included."""


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

    def text(self):
        """The violations, and the command and commit that repeat them."""
        lines = [f"  tick {v.tick} drive {v.drive} {v.rule}: {v.what}" for v in self.found]
        again = f"python -m tests.storm --seeds {self.seed} --ticks {self.ticks} # on {COMMIT}"
        return "\n".join([f"seed {self.seed}: {again}", *lines])


def config_of(seed):
    """EKF and UKF, detectors (`median` is much like `kmeans`), by seed.

    Classic CAN, from seed 1000 on CAN FD, of those with wrong values half and half.
    """
    fd = seed // 24 % 2 == 1 if seed in VALUE_SEEDS else seed >= FD_SEEDS
    return parse({
        "dbc": {"file": "traction_fd.dbc" if fd else "traction.dbc"},
        "estimator": {"kind": ("ekf", "ekf", "ukf")[seed % 3]},
        "adhesion": {"detector": ("vb", "switching", "kmeans", "vmp")[seed // 3 % 4]},
        "thermal": {"calibration": str(CALIBRATION)},
    })  # fmt: skip


def in_calls(seed):
    """Whether this seed's gateway does several ticks in a call, as in a replay, by default.

    Every filter with every detector is stepped both ways.
    """
    return seed // 12 % 2 == 1


def creeps(seed):
    """Whether no drive of this seed's train limits its slip, so that wheels run away."""
    return seed in VALUE_SEEDS and seed // 48 % 2 == 1


def train_of(seed):
    """The honest train of a seed."""
    return train(config_of(seed).dbc_path, creeps(seed))


def first_of(seed):
    """First tick: short storms with wrong values begin anywhere in the train's round."""
    if seed not in VALUE_SEEDS:
        return 1
    return 1 + int(np.random.default_rng([seed, _FIRST]).integers(LOOP_TICKS))


def faults_of(seed, ticks, between=350.0):
    """The plan of a seed, from its first tick on."""
    kinds = KINDS if seed in VALUE_SEEDS else BUS_KINDS
    ahead = first_of(seed) - 1
    return [
        fault._replace(first=fault.first + ahead, last=fault.last + ahead)
        for fault in plan(seed, ticks, len(NODES), between, kinds)
    ]


class Tick(NamedTuple):
    """What there is at one tick.

    phase: how far the train's round has come, in ticks; error: of the values that drives sent.
    """

    tick: int
    came: Arrived
    phase: int
    faults: list[Fault]
    error: Error


class Watched:
    """A gateway from its start on, an oracle beside it, and what both came to."""

    def __init__(self, config, honest, tick, lengths):
        """tick: the first; lengths: of calls of several ticks, None for single steps."""
        self._core = Gateway(config, honest.codec, (tick - 1) * TICK)
        self._oracle = Oracle(honest.codec, config, tick)
        self._honest, self._lengths, self._length = honest, lengths, 1
        self._waiting = []
        self._fed = 0
        """Frames that the gateway was given."""

    @property
    def found(self):
        """Rules broken so far, in ticks that are done."""
        return self._oracle.found

    def stood(self, missed, dropped):
        """Before a tick: the process has stood for so many, and so many frames are lost unread."""
        self._flush()
        self._core.integrity.note_lost(dropped)
        self._oracle.note_lost(dropped)
        if missed:
            self._core.integrity.note_overrun(missed)

    def take(self, tick):
        """One tick, or one more of those that wait to be done together."""
        if self._lengths is None:
            self._fed += tick.came.block.size
            out = self._core.step(tick.came.block, tick.tick * TICK)
            self._look(tick, out, self._core.status)
            return
        self._waiting.append(tick)
        if len(self._waiting) >= self._length:
            self._flush()
            self._length = int(self._lengths.integers(1, MOST_TICKS + 1))

    def end(self, tick):
        """Frames by what became of them, and ticks by what was said."""
        self._flush()
        seen = self._core.inbox.counts
        if not seen["received"] == self._fed == sum(seen[name] for name in ENDS):
            self.found.append(Violation(tick, "counted", 0, f"frames do not add up: {dict(seen)}"))
        return seen, self._oracle.said

    def _flush(self):
        waiting, self._waiting = self._waiting, []
        if not waiting:
            return
        block, ends = _joined([tick.came.block for tick in waiting])
        self._fed += block.size
        out = {}
        done = first = 0
        while done < len(ends):
            rest = block.part(first, block.size)
            at = waiting[done].tick * TICK
            more, went = self._core.run(rest, ends[done:] - first, at)
            for frame in chain.from_iterable(sent.frames() for sent in went):
                out.setdefault(frame.t_ns, []).append(frame)
            done += more
            first = int(ends[done - 1])
        for tick in waiting:
            self._look(tick, out.pop(tick.tick * TICK, []), None)
        if out:
            what = f"frames of no tick: {out}"
            self.found.append(Violation(waiting[-1].tick, "form", 0, what))

    def _look(self, tick, out, status):
        truth = truth_at(self._honest, tick.phase, tick.error)
        self._oracle.look(tick.tick, tick.came, out, status, truth, tick.faults)


def weather(seed, ticks, between=350.0, several=None):
    """Run one seed.

    between: mean ticks from one fault to the next; several: whether the gateway does several ticks
    in a call, None for what `in_calls` says.
    """
    config, honest = config_of(seed), train_of(seed)
    ids = [
        [spec.can_id for spec in honest.codec.messages if spec.name.startswith(f"Drive{n}_")
         and not spec.is_gateway]
        for n in NODES
    ]  # fmt: skip
    values = ValueFaults(honest.codec, NODES)
    bus = HostileBus(faults_of(seed, ticks, between), ids, seed, values)
    several = in_calls(seed) if several is None else several
    lengths = np.random.default_rng([seed, _LENGTHS]) if several else None
    met = Counter()
    counts = Counter()
    found = []
    said = Counter()

    def end():
        came, told = watched.end(tick)
        counts.update(came)
        said.update(told)
        found.extend(watched.found)

    first = first_of(seed)
    watched = Watched(config, honest, first, lengths)
    waiting, stopped = NOTHING, 0
    tick = first - 1
    for tick in range(first, first + ticks):
        now = tick * TICK
        came = bus.carry(honest.sent(tick), lambda: honest.elsewhere(tick), tick, now)  # noqa: B023
        faults = list(bus.active(tick))
        k = (tick - 1) % LOOP_TICKS
        kinds = {fault.kind for fault in faults}
        for fault in faults:
            met[
                fault.kind, PHASES[honest.phase[k]], 0 if fault.drive is None else fault.drive + 1
            ] += 1
        if stopped or "process_stop" in kinds:
            dropped = max(waiting.block.size + came.block.size - QUEUE, 0)
            waiting = _queued(waiting, came)
            stands = "process_stop" in kinds
            watched.stood(0 if stands else stopped, dropped)
            if stands:
                stopped += 1
                continue
            came, waiting, stopped = waiting, NOTHING, 0
        if any(f.kind == "restart" and f.first == tick for f in faults):
            end()
            watched = Watched(config, honest, tick, lengths)
        watched.take(Tick(tick, came, k, faults, values.error))
        if len(watched.found) >= MOST_FOUND:
            break
    end()
    done = tick - first + 1
    return Result(seed, done, found, said, met, counts["received"], counts)


def _joined(blocks):
    """One behind the other, and where each ends. Of channels nobody asks here."""
    columns = zip(*(block[:6] for block in blocks), strict=True)
    one = [np.concatenate(column) for column in columns]
    channel = np.zeros(len(one[0]), dtype=np.uint16)
    return Block(*one, channel, ["bus"]), np.cumsum([block.size for block in blocks])


def _queued(waiting, came):
    block = join(waiting.block, came.block).part(0, QUEUE)
    return Arrived(block, np.concatenate([waiting.genuine, came.genuine])[:QUEUE])


def uncovered(met, kinds=BUS_KINDS):
    """Pairs of fault and phase that were never met."""
    seen = {(kind, phase) for kind, phase, *_ in met}
    return [(kind, phase) for kind in kinds for phase in PHASES if (kind, phase) not in seen]
