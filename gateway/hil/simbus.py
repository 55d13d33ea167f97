"""The simulated drives on a bus in real time: the world advances with the monotonic clock."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Final

from dbc.frame import MS, SECOND, Frame, Nanos
from gateway.io.live import Stop, frozen_garbage, stop_on_signals
from gateway.io.realtime import Ticker
from gateway.io.transport import Transport
from sim.simulation import Simulation

FINEST_NS: Final[Nanos] = 2 * MS
"""Shortest step; else half of the fastest cycle. Frames leave at most a step late."""
NEWEST: Final = 6
"""Frames of an id that still leave when this process stalled: a real ECU has a mailbox per message
and sends the newest, not the backlog. Six stay below half a counter period of the classic
messages, so that halves of one sample still pair and no turn of the counter is missed."""
NEWEST_FD: Final = 12
"""The same for FD frames, whose counters turn late: a time slice of a kernel at 100 Hz."""


def newest(frames: Sequence[Frame]) -> list[Frame]:
    """The frames that mailboxes still hold: of every id the last `NEWEST`, in the same order."""
    after = Counter(frame.can_id for frame in frames)
    kept = []
    for frame in frames:
        after[frame.can_id] -= 1
        if after[frame.can_id] < (NEWEST_FD if frame.is_fd else NEWEST):
            kept.append(frame)
    return kept


def run_on_bus(
    simulation: Simulation,
    transport: Transport,
    seconds: float,
    after_step: Callable[[], None],
    stop: Stop | None = None,
) -> int:
    """Run for `seconds` or until SIGINT or SIGTERM (`stop` knows which); close the transport.

    Missed ticks are caught up by the simulation itself: it always advances to the true time.
    Returns how many frames stalls of this process have made too old to be sent.
    """
    overwritten = 0
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
                frames = simulation.step(transport.receive(0.0), world)
                held = newest(frames)
                overwritten += len(frames) - len(held)
                for frame in held:
                    transport.send(frame)
                after_step()
                if world >= end:
                    break
    finally:
        transport.close()
    return overwritten
