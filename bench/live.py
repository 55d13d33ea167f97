"""The live path: what a frame costs from the socket, what a tick costs, how late ticks are.

Where the kernel has no CAN the frames come over a Unix socket pair that carries real `struct
can_frame` bytes, to the same transport. Sixteen drives are the three of the log under other names.
"""

from __future__ import annotations

import gc
import math
import socket
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import cantools
import numpy as np
from can.interfaces.socketcan.socketcan import capture_message

from bench.filters import call_of, us
from bench.judges import verdict_of
from bench.wire import log_of, whole
from dbc.codec import Codec, bind
from dbc.e2e import protect
from dbc.frame import MS, SECOND, Frame
from gateway.core.gateway import Gateway
from gateway.core.supervision import Supervision
from gateway.io.kernel import Kernel, Link
from gateway.io.live import frozen_garbage
from gateway.io.realtime import Ticker
from gateway.io.scheduling import be_ordinary, be_realtime
from gateway.io.socketcan import SocketCan
from gateway.io.transport import SendResult
from gateway.io.wire import pack
from gateway.settings.config import Config, ConfigError, shipped_dbc
from tests.stations import Inbox

HEADER = ("figure", "p50", "p99", "p99.9", "of the period", "reference in the same run")
SECONDS: Final = 12
LATE_S: Final = 4.0
SAMPLES, SUB_STEPS = 5, 16
"""Of a tick: one every 2 ms."""
QUEUE: Final = 1 << 20
SENDS: Final = 20_000
_SO_TIMESTAMPNS: Final = 35


class Pair(Kernel):
    """A Unix socket pair in place of an interface."""

    def __init__(self) -> None:
        self.ours, self.theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.ours.setblocking(False)
        self.ours.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        self.theirs.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, QUEUE)

    def connect(self, channel: str, fd: bool, first: bool = False) -> socket.socket:  # noqa: ARG002
        return self.ours

    def look(self, raw: socket.socket, channel: str) -> Link:  # noqa: ARG002
        return Link(1, up=True, mtu=72)

    def close(self) -> None:
        self.ours.close()
        self.theirs.close()

    def swallow(self) -> None:
        try:
            while self.theirs.recv(72, socket.MSG_DONTWAIT):
                pass
        except BlockingIOError:
            pass


def quantiles(spent: Sequence[float]) -> np.ndarray:
    """50, 99 and 99.9 % of times, s."""
    return np.quantile(spent, (0.5, 0.99, 0.999))


def texts(seconds: np.ndarray, digits: int = 0) -> list[str]:
    return [us(value, digits) for value in seconds]


def ticks_of(log: Path, codec: Codec, drives: int, period_ns: int) -> list[list[Frame]]:
    """Frames of each tick, those of the first three drives once more for every third of them."""
    frames = [f for f in whole(log).frames() if f.t_ns < SECONDS * SECOND]
    out: list[list[Frame]] = [[] for _ in range(SECONDS * SECOND // period_ns + 1)]
    for frame in frames:
        spec = codec.by_id.get(frame.can_id)
        node = spec.node if spec is not None else frame.can_id & 0x7F
        for clone in range(node, drives + 1, 3):
            out[frame.t_ns // period_ns].append(as_node(frame, codec, clone - node))
    return out


def as_node(frame: Frame, codec: Codec, further: int) -> Frame:
    """The frame as the drive so many nodes further would have sent it."""
    spec = codec.by_id.get(frame.can_id)
    other = codec.by_id.get(frame.can_id + further)
    if not further or spec is None or other is None:
        return frame._replace(can_id=frame.can_id + further)
    data = bytearray(frame.data)
    protect(other, data, data[1] & 0x0F)
    return frame._replace(can_id=other.can_id, data=bytes(data))


def per_frame(ticks: Sequence[Sequence[Frame]], codec: Codec, drives: int) -> list[tuple[str, ...]]:
    """From socket to decoded sample: of the processor, whoever else wants it meanwhile."""
    kernel = Pair()
    # As in service: it asks in each tick whether frames of ours still wait.
    bus = SocketCan("pair", newest=True, kernel=kernel)
    bus.open()
    nodes = tuple(range(1, drives + 1))
    inbox = Inbox(codec, nodes, 10 * MS, Supervision(nodes, 300 * MS))
    database = cantools.database.load_file(codec.path)
    packed = [[pack(frame) or b"" for frame in tick] for tick in ticks]
    stamps = [np.array([frame.t_ns for frame in tick], dtype=np.int64) for tick in ticks]
    ours = theirs = 0.0
    count = 0
    for number, tick in enumerate(packed):
        for payload in tick:
            kernel.theirs.send(payload)
        began = time.thread_time()
        block = bus.receive()
        # As of the log: what is late would be stale.
        block.t_ns[:] = stamps[number]
        inbox.take(block, (number + 1) * 10 * MS)
        ours += time.thread_time() - began
        if number % 20 == 0:
            for payload in tick:
                kernel.theirs.send(payload)
            began = time.thread_time()
            for _ in tick:
                message = capture_message(kernel.ours, False)
                if message is not None and message.arbitration_id < 0x700:
                    database.decode_message(message.arbitration_id, message.data)
            theirs += time.thread_time() - began
            count += len(tick)
    total = sum(len(tick) for tick in packed)
    ours_us, theirs_us = 1e6 * ours / total, 1e6 * theirs / count
    what = f"socket to decoded sample, {drives} drives, {total // len(packed)} frames a tick"
    return [(what, f"{ours_us:.2f} us a frame", "", "", "",
             f"python-can + cantools {theirs_us:.2f} us: {theirs_us / ours_us:.1f} x")]  # fmt: skip


def sends(frames: Sequence[Frame]) -> list[tuple[str, ...]]:
    """One frame handed over, and one that the full queue does not take (R20)."""
    kernel = Pair()
    bus = SocketCan("pair", newest=True, kernel=kernel)
    bus.open()
    bus.receive()
    taken: dict[SendResult, list[float]] = {SendResult.SENT: [], SendResult.FULL: []}
    with frozen_garbage():
        while min(map(len, taken.values())) < SENDS:
            full = len(taken[SendResult.SENT]) >= SENDS
            for frame in frames:
                began = time.perf_counter()
                result = bus.send(frame)
                taken[result].append(time.perf_counter() - began)
            if not full:
                kernel.swallow()
    out = []
    for result, what in ((SendResult.SENT, "a frame sent"), (SendResult.FULL, "the queue is full")):
        out.append((what, *texts(quantiles(taken[result]), 1), "", ""))
    kernel.close()
    return out


def whole_tick(
    ticks: Sequence[Sequence[Frame]], codec: Codec, drives: int, rate_hz: int
) -> tuple[str, ...]:
    rows: list[dict[str, Any]] = [{"node": k} for k in range(1, drives + 1)]
    config = Config.model_validate({"drive": rows, "loop": {"rate_hz": rate_hz}})
    kernel = Pair()
    bus = SocketCan("pair", kernel=kernel)
    bus.open()
    gateway = Gateway(config, codec, 0)
    spent = []
    period_ns = config.loop.period_ns
    with frozen_garbage():
        for number, tick in enumerate(ticks):
            for frame in tick:
                kernel.theirs.send(pack(frame) or b"")
            stamps = np.array([frame.t_ns for frame in tick], dtype=np.int64)
            began = time.perf_counter()
            block = bus.receive()
            block.t_ns[:] = stamps
            for frame in gateway.step(block, (number + 1) * period_ns):
                bus.send(frame)
            spent.append(time.perf_counter() - began)
            if number % 5 == 0:
                kernel.swallow()
    q = quantiles(spent[len(spent) // 6 :])
    _, p99, p999 = 100.0 * rate_hz * q
    what = f"whole tick, {drives} drives, {rate_hz} Hz"
    return what, *texts(q), f"p99 {p99:.1f} %, p99.9 {p999:.1f} %", ""


def alone(drives: int) -> tuple[str, ...]:
    """Estimator and detector without a bus: more drives than a message set has."""
    filters = call_of("ekf", drives, SAMPLES, sub_steps=SUB_STEPS)
    judge = verdict_of(drives)
    filters(), judge()
    spent = []
    with frozen_garbage():
        for _ in range(SECONDS * 100):
            began = time.perf_counter()
            filters()
            judge()
            spent.append(time.perf_counter() - began)
    q, what = quantiles(spent), f"EKF and VB alone, {drives} drives, a tick of 100 Hz"
    return what, *texts(q), f"p99 {100.0 * q[1] * 100:.1f} %", ""


def bare(period_s: float) -> list[float]:
    """Lateness, s, of the simplest loop on absolute deadlines."""
    late = []
    start = time.monotonic()
    for k in range(1, round(LATE_S / period_s)):
        deadline = start + k * period_s
        time.sleep(max(deadline - time.monotonic(), 0.0))
        late.append(time.monotonic() - deadline)
    return late


def ticker(period_s: float) -> list[float]:
    wakes = Ticker(round(period_s * SECOND))
    first = wakes.wait().now_ns
    late = []
    for _ in range(1, round(LATE_S / period_s)):
        tick = wakes.wait()
        late.append((tick.now_ns - first) / SECOND - tick.number * period_s)
    return late


@contextmanager
def privileged() -> Iterator[None]:
    """Real-time priority, locked memory, frozen garbage."""
    be_realtime(50)
    try:
        with frozen_garbage():
            yield
    finally:
        be_ordinary()


def lateness() -> list[tuple[str, ...]]:
    """Of idle loops: what the machine alone costs."""
    out = []
    for rate_hz in (100, 1000):
        period_s = 1.0 / rate_hz
        out.append(_late(f"lateness at {rate_hz} Hz", ticker, period_s))
        try:
            with privileged():
                row = _late(f"lateness at {rate_hz} Hz, SCHED_FIFO, locked", ticker, period_s)
        except ConfigError:
            row = (f"lateness at {rate_hz} Hz, SCHED_FIFO", "not allowed here", "", "", "", "")
        out.append(row)
    return out


def _late(what: str, loop: Callable[[float], list[float]], period_s: float) -> tuple[str, ...]:
    gc.collect()
    reference = np.quantile(bare(period_s), 0.99).item()
    q = quantiles(loop(period_s))
    ratio = q[1] / reference if reference > 0.0 else math.nan
    compared = f"bare loop p99 {us(reference, 0)}: {ratio:.2f}"
    return what, *texts(q), f"p99 {100.0 * q[1] / period_s:.1f} %", compared


def rows() -> list[tuple[str, ...]]:
    out = []
    with tempfile.TemporaryDirectory() as name:
        log = log_of(Path(name), "traction.dbc")
        for drives in (3, 16):
            codec = bind(shipped_dbc("traction.dbc"), tuple(range(1, drives + 1)))
            slow, fast = (ticks_of(log, codec, drives, period) for period in (10 * MS, MS))
            out += per_frame(slow, codec, drives)
            out.append(whole_tick(slow, codec, drives, 100))
            out.append(whole_tick(fast, codec, drives, 1000))
            frames = [frame for tick in slow[:20] for frame in tick]
    return [*out, *sends(frames), alone(64), *lateness()]
