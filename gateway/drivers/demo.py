"""The demo: simulated drives and gateway on python-can's embedded `virtual` bus, real time.

One loop steps both sides, so the demonstration needs no second process; every frame really
passes the bus, through the same transport and the same core as in service.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NamedTuple

from dbc.codec import Codec
from dbc.frame import SECOND, Nanos
from gateway.config import Config
from gateway.core import Gateway
from gateway.drivers.bench import for_scenario
from gateway.drivers.canopen_node import CanopenNode
from gateway.drivers.realtime import Ticker
from gateway.drivers.transport import Allow, open_transport
from gateway.drivers.warm import warm_up
from gateway.outbox import GatewayView
from sim.scenario import Scenario
from sim.simulation import Simulation


class Done(NamedTuple):
    """What the demo came to."""

    gateway: Gateway
    truth: list[Any]
    start_ns: Nanos
    first_flag_s: float
    ticks: int
    missed: int


def run_demo(
    scenario: Scenario,
    config: Config,
    codec: Codec,
    channel: str,
    seconds: float,
    watch: Callable[[int, GatewayView], None],
) -> Done:
    """Run for `seconds`; `watch` sees every tick. Truth rows are the simulator's."""
    began = time.monotonic()
    config = for_scenario(config)
    warm_up(config, codec)
    bus = {"interface": "virtual", "channel": channel}
    allow = Allow.from_codec(codec, config.nodes, nmt_master=True)
    ours, theirs = open_transport(bus, allow), open_transport(bus)
    simulation = Simulation(scenario, codec, nodes=config.nodes, self_start=False)
    ticker = Ticker(config.loop.period_ns)
    node = CanopenNode(config.nodes, nmt_master=True)
    truth: list[Any] = []
    first_flag_s = 0.0
    start: Nanos | None = None
    gateway: Gateway | None = None
    tick = 0
    try:
        while True:
            turn = ticker.wait()
            now = turn.now_ns
            if start is None or gateway is None:
                start = now
                gateway = Gateway(config, codec, start)
            for frame in simulation.step(theirs.receive(0.0), now - start):
                theirs.send(frame)
            truth += simulation.truth_rows()
            received = ours.receive(0.0)
            gateway.note_overrun(turn.missed)
            # The bus stamps frames as they pass, so time is read after they have arrived.
            now = ticker.clock()
            for frame in gateway.step(received, now) + node.step(received, now):
                ours.send(frame)
            tick = turn.number
            if not first_flag_s:
                first_flag_s = time.monotonic() - began
            assert gateway.view is not None
            watch(tick, gateway.view)
            if now - start >= seconds * SECOND:
                break
    finally:
        ours.close()
        theirs.close()
    return Done(gateway, truth, start, first_flag_s, tick, ticker.missed)
