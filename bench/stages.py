"""Where a tick's time goes: a replay, `run` and `step`, and the stations one by one.

Of each PIECE of ticks the shortest of ROUNDS counts, so that other work of the machine changes
little.

Stations are called from Python in the order of `gateway/core/tick.c`, each with a timer around it:
a call and its timer cost as much as the row without a station shows. What is sent must be what a
whole tick sends. `finish_tick` is the rest of a tick: temperatures, flags, transmission.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from _traction_core import lib

from bench.speed import best, quiet
from bench.wire import log_of, whole
from dbc.codec import Codec, bind
from dbc.frames import Block
from gateway.core.gateway import Gateway
from gateway.settings.config import Config, shipped_dbc

HEADER = ("stage", "per tick", "share of `run`")
NODES: Final = (1, 2, 3)
PIECE: Final = 25
"""Ticks that are timed together."""
ROUNDS: Final = 9
CALL: Final = "a call without a station, its timer included"


class Recorded:
    """A log cut into ticks, and gateways for it."""

    def __init__(self, log: Path, codec: Codec) -> None:
        self.codec = codec
        self.config = Config.model_validate({"drive": [{"node": node} for node in NODES]})
        self.frames = whole(log)
        self.first, self.period = self.frames.t_ns.item(0), self.config.loop.period_ns
        self.nows = np.arange(self.first, self.frames.t_ns.item(-1), self.period)
        self.ends = np.searchsorted(self.frames.t_ns, self.nows, "right")

    def gateway(self) -> Gateway:
        return Gateway(self.config, self.codec, self.first)

    def many(self) -> list[float]:
        """Ticks by `run`, up to PIECE in a call: s of each call."""
        gateway, done, spent = self.gateway(), 0, []
        while done < len(self.ends):
            begin = self.ends.item(done - 1) if done else 0
            ends = self.ends[done : done + PIECE - done % PIECE]
            block = self.frames.part(begin, ends.item(-1))
            began = time.perf_counter()
            stepped = gateway.run(block, ends - begin, self.nows.item(done))[0]
            spent.append(time.perf_counter() - began)
            done += stepped
        return spent

    def pieces(self, ticks: list[tuple[Block, int]]) -> list[float]:
        """Ticks by `step`: s of each PIECE of them."""
        gateway, spent = self.gateway(), []
        for k in range(0, len(ticks), PIECE):
            part = ticks[k : k + PIECE]
            began = time.perf_counter()
            for block, now in part:
                gateway.step(block, now)
            spent.append(time.perf_counter() - began)
        return spent

    def ticks(self) -> list[tuple[Block, int]]:
        begins = [0, *self.ends.tolist()]
        parts = zip(begins, begins[1:], self.nows.tolist(), strict=False)
        return [(self.frames.part(begin, end).ordered(), now) for begin, end, now in parts]

    def steps(self, ticks: list[tuple[Block, int]]) -> list[bytes]:
        """Ticks by `step`; the data of all that was sent."""
        gateway = self.gateway()
        return [frame.data for block, now in ticks for frame in gateway.step(block, now)]


def stations(gateway: Gateway) -> dict[str, Callable[..., object]]:
    """In the order of `tick.c`; each is called with a block's columns, its size and now."""
    g: Any = gateway.pointer
    receiver, inputs, status = g.receiver, g.inputs, g.status

    def receive(at: Any, n: int, now: int) -> None:
        lib.receive_frames(receiver, at, 0, n, now)
        lib.check_integrity(g.integrity, receiver.tick.own, now)
        lib.bus_load_tick(g.load, now)
        lib.bus_load_receive(g.load, receiver, at, 0, n)

    def timeouts(_at: object, _n: int, now: int) -> None:
        lib.check_timeouts(receiver, now)
        for k in range(g.drive_count):
            inputs[k].heartbeat_lost = lib.is_node_lost(receiver.supervision, k, now)

    return {
        CALL: lambda _at, _n, _now: lib.is_overrun(g.integrity),
        "receive_frames: verify, decode, pair; integrity, bus load": receive,
        "check_timeouts, heartbeats": timeouts,
        "assess_inputs": lambda _at, _n, now: lib.assess_inputs(
            receiver, g.channels, g.integrity.intruder, now, inputs
        ),
        "run_filters": lambda _at, _n, now: lib.run_filters(
            g.estimator, receiver, inputs, g.estimates, now
        ),
        "observe_load": lambda _at, _n, now: lib.observe_load(g.motion, now),
        "detect_loss": lambda _at, _n, now: lib.detect_loss(
            g.adhesion, g.estimates, inputs, receiver.drives, status, now
        ),
        "finish_tick: temperatures, flags, transmit": lambda _at, _n, now: lib.finish_tick(g, now),
    }


def shortest(task: Callable[[], list[float]]) -> float:
    """s of all pieces together, each the shortest of ROUNDS."""
    return float(np.min([task() for _ in range(ROUNDS)], axis=0).sum())


def one_by_one(recorded: Recorded, ticks: list[tuple[Block, int]]) -> dict[str, list[float]]:
    """s of each station in every tick. Raises AssertionError where something else is sent."""
    gateway = recorded.gateway()
    most = max(block.size for block, _ in ticks)
    gateway.inbox.receiver.reserve(2 * most)
    gateway.bank.reserve(gateway.inbox.receiver.sample_rows)
    gateway.link()
    calls = stations(gateway)
    spent: dict[str, list[float]] = {name: [] for name in calls}
    sent: list[bytes] = []
    for block, now in ticks:
        at = block.columns()
        gateway.pointer.sent_count = 0
        for name, call in calls.items():
            began = time.perf_counter()
            call(at, block.size, now)
            spent[name].append(time.perf_counter() - began)
        count = gateway.pointer.sent_count
        sent += [frame.data for frame in gateway.outbox.frames_of(gateway.sent[:count])]
    assert sent == recorded.steps(ticks), "the stations do not send what a tick sends"
    return spent


def rows() -> list[tuple[str, ...]]:
    with tempfile.TemporaryDirectory() as name:
        log = log_of(Path(name), "traction.dbc")
        replayed = best(partial(quiet, "replay", str(log), "-o", str(Path(name) / "out.log")))
        recorded = Recorded(log, bind(shipped_dbc("traction.dbc"), NODES))
    ticks = recorded.ticks()
    count = len(ticks)
    run_s = shortest(recorded.many) / count
    step_s = shortest(lambda: recorded.pieces(ticks)) / count
    turns = [one_by_one(recorded, ticks) for _ in range(ROUNDS)]
    out = [
        ("replay, log read and flags written", replayed / count),
        ("`run`, 25 ticks a call", run_s),
        ("`step`, a tick a call, frames as objects", step_s),
        # Of each tick the shortest of all turns.
        *((name, np.min([t[name] for t in turns], axis=0).mean().item()) for name in turns[0]),
    ]
    return [
        (what, f"{1e6 * spent:.2f} us", f"{100.0 * spent / run_s:.0f} %") for what, spent in out
    ]
