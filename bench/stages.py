"""Where a tick's time goes: a replay, `run` and `step`, and the stations one by one.

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
from statistics import median
from typing import Any, Final

import numpy as np
from _traction_core import lib

from bench.speed import best, quiet
from bench.wire import log_of, whole
from dbc.codec import Codec, bind
from dbc.frames import Block
from dbc.records import pointer
from gateway.core.gateway import Gateway
from gateway.settings.config import Config, shipped_dbc

HEADER = ("stage", "per tick", "share of `run`")
NODES: Final = (1, 2, 3)
CALL: Final = "a call without a station, its timer included"


class Recorded:
    """A log cut into ticks, and gateways for it."""

    def __init__(self, log: Path, codec: Codec) -> None:
        """Read all of it."""
        self.codec = codec
        self.config = Config.model_validate({"drive": [{"node": node} for node in NODES]})
        self.frames = whole(log)
        self.first, self.period = self.frames.t_ns.item(0), self.config.loop.period_ns
        self.nows = np.arange(self.first, self.frames.t_ns.item(-1), self.period)
        self.ends = np.searchsorted(self.frames.t_ns, self.nows, "right")

    def gateway(self) -> Gateway:
        """One that has seen nothing."""
        return Gateway(self.config, self.codec, self.first)

    def many(self) -> None:
        """Ticks by `run`, as many in a call as there can be."""
        gateway, done = self.gateway(), 0
        while done < len(self.ends):
            begin = self.ends.item(done - 1) if done else 0
            block = self.frames.part(begin, self.frames.size)
            done += gateway.run(block, self.ends[done:] - begin, self.nows.item(done))[0]

    def ticks(self) -> list[tuple[Block, int]]:
        """Frames and time of each."""
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

    def receive(at: tuple[Any, ...], n: int, now: int) -> None:
        lib.receive_frames(receiver, n, *at, now)
        lib.check_integrity(g.integrity, receiver.tick.own, now)
        lib.bus_load_tick(g.load, now)
        lib.bus_load_receive(g.load, receiver, n, at[1], at[2], at[3])

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


def one_by_one(recorded: Recorded, ticks: list[tuple[Block, int]]) -> dict[str, float]:
    """s per tick of each station. Raises AssertionError where something else is sent."""
    gateway = recorded.gateway()
    most = max(block.size for block, _ in ticks)
    gateway.inbox.receiver.make_room(2 * most)
    gateway.bank.make_room(len(gateway.inbox.receiver.room.drive))
    gateway.link()
    calls = stations(gateway)
    spent: dict[str, list[float]] = {name: [] for name in calls}
    sent: list[bytes] = []
    for block, now in ticks:
        at = (
            pointer("int64_t", block.t_ns), pointer("uint32_t", block.can_id),
            pointer("uint8_t", block.flags), pointer("uint8_t", block.length),
            pointer("uint8_t", block.data),
        )  # fmt: skip
        gateway.pointer.sent_count = 0
        for name, call in calls.items():
            began = time.perf_counter()
            call(at, block.size, now)
            spent[name].append(time.perf_counter() - began)
        count = gateway.pointer.sent_count
        sent += [frame.data for frame in gateway.outbox.frames_of(gateway.sent[:count])]
    assert sent == recorded.steps(ticks), "the stations do not send what a tick sends"
    return {name: sum(seconds) / len(seconds) for name, seconds in spent.items()}


def rows() -> list[tuple[str, ...]]:
    """One row per stage; the first is the whole replay."""
    with tempfile.TemporaryDirectory() as name:
        log = log_of(Path(name), "traction.dbc")
        replayed = best(partial(quiet, "replay", str(log), "-o", str(Path(name) / "out.log")))
        recorded = Recorded(log, bind(shipped_dbc("traction.dbc"), NODES))
    ticks = recorded.ticks()
    count = len(ticks)
    run_s, step_s = best(recorded.many) / count, best(lambda: recorded.steps(ticks)) / count
    turns = [one_by_one(recorded, ticks) for _ in range(3)]
    out = [
        ("replay, log read and flags written", replayed / count),
        ("`run`, many ticks a call", run_s),
        ("`step`, a tick a call, frames as objects", step_s),
        *((name, median(turn[name] for turn in turns)) for name in turns[0]),
    ]
    return [
        (what, f"{1e6 * spent:.2f} us", f"{100.0 * spent / run_s:.0f} %") for what, spent in out
    ]
