"""The demo: simulated drives and gateway on python-can's embedded `virtual` bus.

One loop steps both sides, so the demonstration needs no second process; every frame does pass
the bus, through the same transport and the same core as in service. Time is that of the ticks,
which follow real time; on a machine that cannot keep up, the demo is slow but not wrong.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

from dbc.codec import Codec
from dbc.frame import SECOND, Nanos
from gateway.core.gateway import Gateway
from gateway.io.canopen_node import CanopenNode, meant
from gateway.io.permission import Mode, allowed
from gateway.io.pythoncan import PythonCan
from gateway.io.transport import Guarded
from gateway.settings.config import Config
from sim.ground_truth import Truth
from sim.scenario import Scenario
from sim.simulation import Simulation


class Done(NamedTuple):
    """Result of the demo. pace: simulated over real time, 1 if the machine kept up."""

    gateway: Gateway
    truth: list[Truth]
    first_flag_s: float
    pace: float


def rehearse(scenario: Scenario, config: Config, codec: Codec) -> None:
    """Run three ticks of the drives, so that nothing has to be imported while the clock runs."""
    simulation = Simulation(scenario, codec, self_start=True)
    for tick in range(3):
        simulation.step([], tick * config.loop.period_ns)


def run_demo(
    scenario: Scenario,
    config: Config,
    codec: Codec,
    channel: str,
    seconds: float,
    watch: Callable[[int, Gateway], None],
    began_s: float,
) -> Done:
    """Run for `seconds` from time 0; `watch` is called every tick.

    began_s: start of the program on the monotonic clock.
    """
    now: Nanos = 0

    def clock() -> Nanos:
        return now

    def no_stamp() -> Nanos:
        """Wall clock for PythonCan, always 0, so that frames get the tick's time as their stamp."""
        return 0

    bus = {"interface": "virtual", "channel": channel}
    ours = Guarded(PythonCan(bus, clock, no_stamp), allowed(Mode.HIL, config, codec))
    theirs = PythonCan(bus, clock, no_stamp)
    simulation = Simulation(scenario, codec, self_start=False)
    gateway = Gateway(config, codec, 0)
    node = CanopenNode(config.nodes, nmt_master=True)
    truth: list[Truth] = []
    first_flag_s = 0.0
    ours.open()
    theirs.open()
    start = time.monotonic()
    try:
        for tick in range(round(seconds * config.loop.rate_hz) + 1):
            now = tick * config.loop.period_ns
            time.sleep(max(0.0, start + now / SECOND - time.monotonic()))
            for frame in simulation.step(theirs.receive().frames(), now):
                theirs.send(frame)
            truth += simulation.truth_rows()
            received = ours.receive()
            for frame in gateway.step(received, now) + node.step(meant(received), now):
                ours.send(frame)
            first_flag_s = first_flag_s or time.monotonic() - began_s
            watch(tick, gateway)
    finally:
        ours.close()
        theirs.close()
    took = max(time.monotonic() - start, 1e-9)
    return Done(gateway, truth, first_flag_s, min(1.0, seconds / took))
