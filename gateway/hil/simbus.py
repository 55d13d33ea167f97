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
"""Shortest step; else it is half of the fastest cycle time. Frames are at most a step late."""
NEWEST: Final = 6
"""Frames of an identifier that are still sent after a stall of this process: a real ECU has a
mailbox per message and sends the newest, not the backlog. Six are less than half a counter period
of the classic messages, so that halves of a sample still pair and no counter wrap is missed."""
NEWEST_FD: Final = 12
"""The same for FD frames, whose counters wrap later: a time slice of a kernel at 100 Hz."""


def newest(frames: Sequence[Frame]) -> list[Frame]:
    """Frames still in the mailboxes: per identifier the last `NEWEST` or `NEWEST_FD`, in order."""
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
    """Run for `seconds` or until SIGINT or SIGTERM (`stop` records which); close the transport.

    The simulation catches up missed ticks itself: it always advances to the true time.
    Returns the number of frames that were not sent because a stall had made them too old.
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
                frames = simulation.step(transport.receive().frames(), world)
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
