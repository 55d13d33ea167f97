"""An hour of real time at twice the nominal load: the live loop on a socket.

Six drives with everything they send (three are nominal) come from a process of its own, to the
millisecond of their times. Where the kernel has no CAN the frames travel over a Unix socket pair
as real `struct can_frame` bytes.
"""

import json
import math
import multiprocessing
import time
from array import array
from typing import Final

from bench.live import Pair, as_node
from dbc.codec import bind
from dbc.frame import SECOND
from gateway.core.gateway import Gateway
from gateway.io.canopen_node import CanopenNode
from gateway.io.live import Stop, run_live
from gateway.io.realtime import Ticker
from gateway.io.socketcan import SocketCan
from gateway.io.wire import pack
from gateway.settings.config import parse
from tests.simrun import CLASSIC
from tests.soak.books import Books, unaccounted
from tests.storm.campaign import CALIBRATION
from tests.storm.train import LOOP_TICKS, NODES, TICK, train

DRIVES: Final = tuple(range(1, 2 * len(NODES) + 1))
READ_S: Final = 60
PATIENCE_S: Final = 300.0
"""Time after which a run is given up whose frames have not all come."""


def payloads():
    """What six drives send in each tick of a loop of the train; the last three mimic the first."""
    codec, honest = bind(CLASSIC, DRIVES), train()
    out = []
    for tick in range(1, LOOP_TICKS + 1):
        frames = list(honest.sent(tick).frames())
        both = frames + [as_node(f, codec, len(NODES)) for f in frames]
        out.append([pack(frame) or b"" for frame in sorted(both, key=lambda f: f.t_ns)])
    return out


def speak(theirs, loop, ticks, told):
    """Send tick by tick on absolute deadlines, and say how many frames that were."""
    theirs.setblocking(True)
    start, frames = time.monotonic_ns(), 0
    for tick in range(1, ticks + 1):
        wait = start + tick * TICK - time.monotonic_ns()
        if wait > 0:
            time.sleep(wait / SECOND)
        for payload in loop[(tick - 1) % len(loop)]:
            theirs.send(payload)
            frames += 1
    told.write_text(json.dumps({"frames": frames, "ns": time.monotonic_ns() - start}))


class Watch:
    """Called by the loop after every tick: keeps the books, ends the run."""

    def __init__(self, books, kernel, stop, told, most_s, every_s):
        self.books, self.stop, self.told = books, stop, told
        self.kernel = kernel
        self.every, self.most = round(every_s * SECOND), round(most_s * SECOND)
        self.left = None
        """Frames received when all had been sent: what is still in the socket comes after."""
        self.first = None
        self.due = 0
        self.ages = array("d")
        """Age of the newest sample at each reading, ms: grows if the two clocks part."""
        self.decided = lambda: None

    def __call__(self, seen):
        self.books.count(list(seen.sent))
        self.kernel.swallow()
        now = seen.now_ns
        if self.first is None:
            self.first, self.due = now, now
        if now >= self.due:
            self.due += self.every
            self.books.read((now - self.first) / SECOND / 3600.0)
            decided = self.decided()
            self.ages.append(float("nan") if decided is None else (now - decided) / 1e6)
            if now - self.first > self.most:
                self.stop()
        if self.left == seen.status.received:
            self.stop()
        if self.told.exists():
            self.left = seen.status.received


def run(seconds, folder, every_s=READ_S):
    """Run for so long, and what it came to. folder: for notes between the two processes."""
    codec = bind(CLASSIC, DRIVES)
    config = parse({
        "drive": [{"node": node} for node in DRIVES],
        "thermal": {"calibration": str(CALIBRATION)},
    })  # fmt: skip
    kernel, told, stop = Pair(), folder / "told.json", Stop()
    told.unlink(missing_ok=True)
    bus = SocketCan("pair", kernel=kernel)
    bus.open()
    ticker = Ticker(config.loop.period_ns)
    core = Gateway(config, codec, ticker.clock())
    books = Books(codec)
    watch = Watch(books, kernel, stop, told, seconds + PATIENCE_S, every_s)
    watch.decided = lambda: core.decided_ns
    ticks = round(seconds * 100)
    speaker = multiprocessing.get_context("fork").Process(
        target=speak, args=(kernel.theirs, payloads(), ticks, told), daemon=True
    )
    speaker.start()
    seen = run_live(core, bus, CanopenNode(DRIVES), ticker, stop=stop, on_tick=watch)
    speaker.join()
    kernel.close()
    sent = json.loads(told.read_text())
    counts = core.inbox.counts
    timing = seen.timing
    # Without the first and the last, between which it settles and ends.
    ages = watch.ages[1:-1] or watch.ages or array("d", [math.nan])
    return {
        **books.summary(),
        "drives": len(DRIVES),
        "ticks": seen.tick + 1 - seen.missed,
        "missed": seen.missed,
        "frames_sent_to_it": sent["frames"],
        "frames_received": seen.status.received,
        "kernel_drops": seen.status.kernel_drops,
        "counts": dict(sorted((+counts).items())),
        "unaccounted": unaccounted(counts),
        "age_ms_first": round(ages[0], 3),
        "age_ms_last": round(ages[-1], 3),
        "age_ms_most": round(max(ages), 3),
        "lateness_p99_us": timing.lateness.quantile(0.99) // 1000,
        "latency_p99_us": timing.latency.quantile(0.99) // 1000,
    }
