"""The gateway on a bus in real time: receive, step, send, once per tick.

All frames are sent from this loop, and none is left to the kernel to repeat, so a hung loop stops
its flags and its heartbeat within one period.
"""

from __future__ import annotations

import gc
import logging
import signal
import threading
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from types import FrameType
from typing import TYPE_CHECKING

from dbc.frame import Frame, Nanos
from gateway.io.canopen_node import CanopenNode, meant
from gateway.io.endings import Ended
from gateway.io.realtime import Ticker
from gateway.io.timing import Timing
from gateway.io.transport import LinkState, SendResult, Status, Transport

if TYPE_CHECKING:
    from gateway.core.gateway import Gateway

log = logging.getLogger(__name__)

FAREWELL = 3
"""Ticks with unknown flags that are sent before the gateway stops on purpose."""
INTRUDER = (
    "another node sends with the gateway's identifiers (a second gateway, or a played log that "
    "contains gateway frames). Flags are unknown until 10 s after the last such frame, unless "
    "[bus] on_intruder is set or flags are authenticated; CommFault stays Fault until a restart: "
    "find the other sender, then restart the gateway"
)
OLDEST = 2
"""Age in ticks above which a step's frames are not sent any more: the process stalled between
deciding and sending, and the next step has newer values. A tick that only starts late does send."""
TIMING_TICKS = 100
"""Ticks between two reports of timing to the core."""


@dataclass(slots=True)
class LiveSnapshot:
    """State of the loop for displays; one object, updated in place every tick."""

    status: Status
    timing: Timing
    now_ns: Nanos = 0
    tick: int = 0
    missed: int = 0
    """Ticks missed so far."""
    sent: Sequence[Frame] = ()
    """Frames of the last tick."""
    results: Sequence[SendResult] = ()
    """What became of each of them."""


class Stop:
    """A request to end, from a signal or from the program."""

    def __init__(self) -> None:
        self.requested = False
        self.ended: Ended | None = None
        """The signal that requested the end; None if the program did."""

    def __call__(self) -> None:
        """Request the end."""
        self.requested = True


@contextmanager
def stop_on_signals(stop: Stop) -> Iterator[None]:
    """Request the end on SIGTERM or SIGINT; a second one acts as before, in case the loop hangs."""
    kinds = (signal.SIGTERM, signal.SIGINT)
    before = {kind: signal.getsignal(kind) for kind in kinds}

    def restore() -> None:
        for kind, handler in before.items():
            signal.signal(kind, handler)

    def handle(number: int, _frame: FrameType | None) -> None:
        stop.ended = Ended(number)
        stop()
        restore()

    for kind in kinds:
        signal.signal(kind, handle)
    try:
        yield
    finally:
        restore()


def run_live(
    gateway: Gateway,
    transport: Transport,
    node: CanopenNode,
    ticker: Ticker,
    *,
    stop: Stop | None = None,
    errors: Callable[[], Collection[int]] = tuple,
    on_tick: Callable[[LiveSnapshot], None] | None = None,
    on_end: Callable[[], None] | None = None,
) -> LiveSnapshot:
    """Run until `stop` is requested (also by SIGTERM and SIGINT when in the main thread).

    `transport` is open. `errors` returns the active `GatewayError` codes.
    `on_tick` is called after the frames are sent and must return quickly; `on_end` is called when
    the loop has ended. Ends with three ticks of unknown flags and closes the transport, also if the
    core raises (a programming error, which is passed on to the caller).
    """
    stop = stop or Stop()
    # In another thread the caller ends the loop by `stop`.
    in_main = threading.current_thread() is threading.main_thread()
    with stop_on_signals(stop) if in_main else nullcontext(), frozen_garbage():
        try:
            return _loop(gateway, transport, node, ticker, stop, errors, on_tick)
        finally:
            if on_end is not None:
                on_end()
            _farewell(gateway, transport, ticker)
            transport.close()


def _loop(
    gateway: Gateway,
    transport: Transport,
    node: CanopenNode,
    ticker: Ticker,
    stop: Stop,
    errors: Callable[[], Collection[int]],
    on_tick: Callable[[LiveSnapshot], None] | None,
) -> LiveSnapshot:
    clock, integrity, status = ticker.clock, gateway.integrity, transport.status
    # A gateway that only listens receives the frames of another one, which is then no intruder.
    integrity.watching = not (status.hears_itself or status.silent)
    drops = status.kernel_drops
    timing = Timing(ticker.lateness)
    seen = LiveSnapshot(transport.status, timing)
    state: LinkState | None = None
    note = ""
    report = TIMING_TICKS
    while not stop.requested:
        tick = ticker.wait()
        if tick.missed:
            integrity.note_overrun(tick.missed)
        if tick.number >= report:
            report = tick.number + TIMING_TICKS
            gateway.note_timing(
                timing.latency.quantile(0.99) // 1000, timing.lateness.quantile(0.99) // 1000
            )
        block = transport.receive()
        if status.kernel_drops != drops:
            integrity.note_lost(status.kernel_drops - drops)
            drops = status.kernel_drops
        now = clock()
        alone = not integrity.intruder
        out = gateway.step(block, now)
        stepped = clock()
        if alone and integrity.intruder:
            log.error("%s", INTRUDER)
        node.set_errors(errors())
        oldest = now + OLDEST * ticker.period_ns
        results = [
            transport.send(frame) if clock() <= oldest else status.count(SendResult.LATE)
            for frame in out
        ]
        events = node.step(meant(block), now)
        results += [transport.send(frame) for frame in events]
        out += events
        timing.record(gateway.decided_ns, tick.now_ns, now, stepped, clock())
        seen.now_ns = now
        seen.tick = tick.number
        seen.missed = ticker.missed
        seen.sent = out
        seen.results = results
        if status.state is not state or (status.note and status.note != note):
            state = status.state
            _say_link(status)
        note = status.note
        if on_tick is not None:
            on_tick(seen)
    return seen


def _farewell(gateway: Gateway, transport: Transport, ticker: Ticker) -> None:
    """Send unknown flags three times, a tick apart, so that no receiver keeps the last flags."""
    for _ in range(FAREWELL):
        tick = ticker.wait()
        for frame in gateway.unknown_frames(tick.now_ns):
            transport.send(frame)


def _say_link(status: Status) -> None:
    level = logging.INFO if status.state is LinkState.UP else logging.WARNING
    log.log(level, "bus is %s%s", status.state, f": {status.note}" if status.note else "")


@contextmanager
def frozen_garbage() -> Iterator[None]:
    """Exempt all existing objects from collection, so that a full one does not take 100 ms."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
