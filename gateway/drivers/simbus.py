"""The simulated drives on a bus in real time: the world advances with the monotonic clock."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dbc.frame import MS, SECOND, Nanos
from gateway.drivers.live import Stop, frozen_garbage, stop_on_signals
from gateway.drivers.realtime import Ticker
from gateway.drivers.transport import Transport
from sim.simulation import Simulation

FINEST_NS: Final[Nanos] = 2 * MS
"""Shortest step; else half of the fastest cycle. Frames leave at most a step late."""
MAILBOX_CYCLES: Final = 6
"""A real ECU has a mailbox per message: after a stall it sends the newest, not the backlog. Older
than this many of the fastest cycles was overwritten; it stays below half a counter period, so
that halves of one sample still pair."""


def run_on_bus(
    simulation: Simulation,
    transport: Transport,
    seconds: float,
    after_step: Callable[[], None],
    stop: Stop | None = None,
) -> int:
    """Run for `seconds` or until SIGINT or SIGTERM; then close the transport.

    Missed ticks are caught up by the simulation itself: it always advances to the true time.
    Returns how many frames a stall of this process has made too old to be sent.
    """
    overwritten = 0
    mailbox = MAILBOX_CYCLES * simulation.fastest_cycle_ns
    stop = stop or Stop()
    ticker = Ticker(max(FINEST_NS, simulation.fastest_cycle_ns // 2))
    end = round(seconds * SECOND)
    start: Nanos | None = None
    try:
        with stop_on_signals(stop), frozen_garbage():
            while not stop.requested:
                now = ticker.wait().now_ns
                start = now if start is None else start
                world = min(now - start, end)
                for frame in simulation.step(transport.receive(0.0), world):
                    if world - frame.t_ns <= mailbox:
                        transport.send(frame)
                    else:
                        overwritten += 1
                after_step()
                if world >= end:
                    break
    finally:
        transport.close()
    return overwritten
