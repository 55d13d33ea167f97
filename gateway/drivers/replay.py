"""Replay: the same core on a recorded log, as fast as the machine goes.

The log's time stamps are the only clock. There is no bus object in this module: a replay
cannot transmit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from dbc.candump import LogError, Reader
from dbc.frame import SECOND, Frame, Nanos
from gateway.core import Gateway
from gateway.health import Flag
from gateway.outbox import GatewayView

HOLE_NS: Nanos = 10 * SECOND
"""A longer hole is skipped to the next frame once no flag says good."""

Sink = Callable[[Nanos, list[Frame], GatewayView], None]
Make = Callable[[Nanos], Gateway]


class Replayed(NamedTuple):
    """What a replay did."""

    first_ns: Nanos
    last_ns: Nanos
    frames: int
    ticks: int
    channel: str
    gateway: Gateway


class BadLogError(Exception):
    """The log cannot be replayed; the text says why and what to do."""


class OneChannel:
    """The frames of one channel of a log; `name` is known once the first was read."""

    def __init__(self, frames: Iterable[Frame], wanted: str | None) -> None:
        """wanted: None takes the only channel there is."""
        self.name = wanted
        self._frames = frames
        self._wanted = wanted

    def __iter__(self) -> Iterator[Frame]:
        """Raises BadLogError if there are several channels and none is named."""
        name = self.name
        for frame in self._frames:
            if frame.channel == name:
                yield frame
            elif name is None:
                self.name = name = frame.channel
                yield frame
            elif self._wanted is None:
                msg = (
                    f"the log has several channels ({name}, {frame.channel}, ..); "
                    "name one with --log-channel"
                )
                raise BadLogError(msg)


def replay(frames: Iterable[Frame], make: Make, period_ns: Nanos, sink: Sink) -> Replayed:
    """Run the core over `frames`. Ticks are t_first + k * period; tick k takes t <= t_k.

    Frames whose time goes back are dropped and counted. The last tick is the first at or
    after the last frame. Raises BadLogError for a log without frames.
    """
    stream = iter(frames)
    first = next(stream, None)
    if first is None:
        msg = "no frame in the log (or none on this channel)"
        raise BadLogError(msg)
    gateway = make(first.t_ns)
    counts = gateway.inbox.counts
    now = latest = first.t_ns
    batch = [first]
    total, ticks = 1, 0
    for frame in stream:
        total += 1
        t_ns = frame.t_ns
        if t_ns < latest:
            counts["received"] += 1
            counts["time_back"] += 1
            continue
        hole = t_ns - latest > HOLE_NS
        latest = t_ns
        while t_ns > now:
            out = gateway.step(batch, now)
            ticks += 1
            view = gateway.view
            assert view is not None
            sink(now, out, view)
            batch = []
            now += period_ns
            if hole and t_ns > now and not _any_good(view):
                now += -((now - t_ns) // period_ns) * period_ns
        batch.append(frame)
    out = gateway.step(batch, now)
    assert gateway.view is not None
    sink(now, out, gateway.view)
    return Replayed(first.t_ns, latest, total, ticks + 1, first.channel, gateway)


def _any_good(view: GatewayView) -> bool:
    flags = [view.sensor, view.comm, view.estimator]
    for drive in view.drives:
        flags += [drive.adhesion, drive.thermal]
    return Flag.GOOD in flags


def open_log(path: Path, strict: bool) -> Iterable[Frame]:
    """Frames of a log: python-can's formats by their suffix, candump's text with any other.

    Raises BadLogError for a file that is not there or not readable.
    """
    if not path.exists():
        msg = f"{path}: no such file"
        raise BadLogError(msg)
    if path.is_dir():
        msg = f"{path}: a folder, not a log"
        raise BadLogError(msg)
    from can.io.player import MESSAGE_READERS

    suffix = Path(path.name.removesuffix(".gz")).suffix
    if suffix == ".log" or suffix not in MESSAGE_READERS:
        return Reader(path, strict=strict)
    from dbc.otherlogs import read_any

    return read_any(path)


__all__ = ["BadLogError", "LogError", "OneChannel", "Replayed", "open_log", "replay"]
