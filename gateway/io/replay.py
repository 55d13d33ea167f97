"""Replay: the same core on a recorded log, as fast as the machine goes.

The log's time stamps are the only clock. There is no bus object in this module: a replay
cannot transmit.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from dbc.candump.reader import LogError, LogReader, Reader
from dbc.frame import Frame, Nanos
from dbc.frames import EMPTY, Block, block_of, join
from dbc.logs.opening import OTHERS, ending, open_reader
from dbc.text import InputError
from gateway.core.gateway import Gateway
from gateway.io import quick_start as leanstart
from gateway.io.logtime import HOLE_NS, LogTime

MOST_TICKS = 4096
"""Most ticks that are requested from the core in one call."""
REPORTED = 200
"""Most characters that a message quotes of a line that is no frame, its fault included."""

Array = NDArray[np.float64]
Sink = Callable[[Nanos, list[Frame], Gateway], None]
"""Called for every tick with now, the frames sent, and the gateway, whose view is built on request.

`now` never goes back; the frames sent carry the log's own time, as they do for `Briefly.write`.
"""
Make = Callable[[Nanos], Gateway]


class Samples(Protocol):
    """A consumer that samples the ticks now and then."""

    @property
    def next_ns(self) -> Nanos:
        """Time of the next sample: a run of ticks ends with the first tick at or after it."""

    def took(self, now: Nanos, gateway: Gateway, peak: Array) -> None:
        """Take one tick or many, of which the last was at `now`.

        Only in the last tick can a drive's flag have changed. peak (N,): largest loss probability
        of each drive in any of the ticks; NaN: there was none.
        """


class Briefly(NamedTuple):
    """Callbacks in place of a `Sink`, for callers that need no view of ticks without a change.

    write: takes the frames sent, of one tick or of many; changed: takes the gateway, after a tick
    in which a drive's flag changed; samples: consumer of some of the other ticks as well; read:
    takes the frames received, with their time as the ticks count it.
    """

    write: Callable[[Block], None]
    changed: Callable[[Gateway], None]
    samples: Samples | None = None
    read: Callable[[Block], None] | None = None


class Replayed(NamedTuple):
    """What a replay did. last_ns: the last frame, in the time of the ticks; clock: the log's."""

    first_ns: Nanos
    last_ns: Nanos
    frames: int
    ticks: int
    channel: str
    gateway: Gateway
    clock: LogTime

    @property
    def dropped(self) -> int:
        """Frames that were left out because their time was wrong."""
        return self.gateway.inbox.counts["time_back"]


NO_FRAME: Final = "no frame in the log (or none on this channel)"


class BadLogError(InputError):
    """The log cannot be replayed; the text says why and what to do."""


class OneChannel:
    """The frames of one channel of a log; `name` is known once the first frame has been read."""

    def __init__(
        self, blocks: Iterable[Block], wanted: str | None, option: str = "--log-channel"
    ) -> None:
        """wanted: the channel's name; None takes the only channel of the log.

        option: what the caller has to name a channel, for messages.
        """
        self.name = wanted
        self._blocks = blocks
        self._wanted, self._option = wanted, option

    def __iter__(self) -> Iterator[Block]:
        """Raises BadLogError for several channels if none was named, or if none has that name."""
        others: set[str] = set()
        found = False
        for block in self._blocks:
            if self.name is None:
                self.name = block.names[block.channel[0]]
            if block.names == [self.name]:
                found = True
                yield block
                continue
            names = np.array([name == self.name for name in block.names])
            mine = names[block.channel]
            found = found or bool(mine.any())
            if mine.all():
                yield block
                continue
            others.update(block.names)
            if self._wanted is None:
                other = block.names[block.channel[np.argmin(mine)]]
                raise BadLogError(
                    f"the log has several channels ({self.name}, {other}, ..); "
                    f"name one with {self._option}"
                )
            if mine.any():
                yield block.pick(mine)
        if others and not found:
            msg = f"no channel {self._wanted} in the log; it has {', '.join(sorted(others))}"
            raise BadLogError(msg)


def replay(blocks: Iterable[Block], make: Make, period_ns: Nanos, sink: Sink | Briefly) -> Replayed:
    """Run the core over a log. Ticks are t_first + k * period; tick k takes frames with t <= t_k.

    A gateway that `make` has resumed from a start record goes on with its own next tick.

    Frames whose time is wrong are dropped and counted, see `LogTime`. The last tick is the first at
    or after the last frame. A `Briefly` gets many ticks at a time, which is much faster. Raises
    BadLogError for a log without frames, or for one that begins before the start record.
    """
    stream = iter(blocks)
    block = next(stream, EMPTY)
    if not block.size:
        raise BadLogError(NO_FRAME)
    first = block.frame(0)
    gateway = make(first.t_ns)
    clock = LogTime(first.t_ns, period_ns)
    now, ticks = first.t_ns, 0
    if gateway.begun:
        now = gateway.now_ns + period_ns
        if first.t_ns < gateway.now_ns:
            raise BadLogError(
                f"the log begins at {first.t_ns / 1e9:.3f} s, before the start record's "
                f"{gateway.now_ns / 1e9:.3f} s: they do not belong together"
            )

    def step(frames: Block) -> None:
        nonlocal ticks
        ticks += 1
        out = gateway.step(frames, now)
        if isinstance(sink, Briefly):
            publish_frames(sink, [block_of(out)], now, gateway.status.drives["loss_probability"])
        else:
            shift = clock.shift_ns(now)
            if shift:
                out = [frame._replace(t_ns=frame.t_ns - shift) for frame in out]
            sink(now, out, gateway)

    def publish_frames(sink: Briefly, out: Iterable[Block], last_ns: Nanos, peak: Array) -> None:
        shift = clock.shift_ns(last_ns)
        for frames in out:
            sink.write(frames._replace(t_ns=frames.t_ns - shift) if shift else frames)
        if gateway.changed:
            sink.changed(gateway)
        if sink.samples is not None:
            sink.samples.took(last_ns, gateway, peak)

    def drop(count: int) -> None:
        gateway.leave_out(count)

    def many(block: Block, sink: Briefly) -> int:
        """Step all ticks that end within the block; return its first frame that is in none."""
        nonlocal now, ticks
        done, last = 0, block.t_ns.item(-1)
        while now < last:
            count = min(-((now - last) // period_ns), MOST_TICKS)
            if sink.samples is not None:
                count = min(count, 1 + max(0, -((now - sink.samples.next_ns) // period_ns)))
            nows = now + period_ns * np.arange(count)
            ends = np.searchsorted(block.t_ns[done:], nows, "right")
            stepped, out = gateway.run(block.part(done, block.size), ends, now)
            publish_frames(sink, out, now + (stepped - 1) * period_ns, gateway.peak)
            now += stepped * period_ns
            ticks += stepped
            done += ends.item(stepped - 1)
        return done

    held = EMPTY
    for new, without, near in clock.steady(chain([block], stream)):
        if isinstance(sink, Briefly) and sink.read is not None:
            sink.read(new)
        dropped = without + held.size
        block = join(held, new)
        even = near or (not len(dropped) and bool((np.diff(block.t_ns) <= HOLE_NS).all()))
        if even and isinstance(sink, Briefly):
            block = block.part(many(block, sink), block.size)
        done, stamps = 0, block.t_ns.tolist()
        while (end := bisect_right(stamps, now, done)) < block.size:
            batch, following = block.part(done, end), stamps[end]
            done = end
            if len(dropped):
                now_dropped = int(np.count_nonzero(dropped <= end))
                drop(now_dropped)
                dropped = dropped[now_dropped:]
            hole = following - stamps[end - 1] > HOLE_NS
            while following > now:
                step(batch)
                batch = EMPTY
                now += period_ns
                if hole and following > now and not gateway.says_good:
                    now += -((now - following) // period_ns) * period_ns
        # The next block may hold more frames of this tick.
        drop(len(dropped))
        held = block.part(done, block.size)
    step(held)
    return Replayed(
        first.t_ns, clock.last_ns, clock.frames, ticks, first.channel, gateway, clock
    )  # fmt: skip


class Log(NamedTuple):
    """A log that can be read: its blocks, and the reader, which keeps the counts."""

    blocks: Iterable[Block]
    reader: LogReader


def open_log(path: Path, strict: bool, line: str = "") -> Log:
    """Open a log: by its file extension, else by its content, see `dbc.logs.opening`.

    line: a pattern of its lines. Raises BadLogError if the path does not exist or is not a regular
    file: a FIFO or a device may never end.
    """
    if not path.exists():
        raise BadLogError(f"{path}: no such file")
    if path.is_dir():
        raise BadLogError(f"{path}: a folder, not a log")
    if not path.is_file():
        raise BadLogError(f"{path}: a FIFO, device or socket, not a log; write a file first")
    if ending(path) in OTHERS:
        leanstart.python_can()
    reader = open_reader(path, strict=strict, line=line)
    return Log(_some(reader, path, line), reader)


def _some(reader: LogReader, path: Path, pattern: str) -> Iterator[Block]:
    """The log's blocks. Raises BadLogError if the log has lines but none of them is a frame."""
    found = False
    for block in reader.blocks():
        found = found or block.size > 0
        yield block
    if found:
        return
    from dbc.logs.text import TextReader

    header = reader.nearest_header() if isinstance(reader, TextReader) else None
    if reader.problems or header:
        line, verdict, text = header or reader.problems[0]
        candump = isinstance(reader, Reader) and not isinstance(reader, TextReader)
        name = "frame as candump -L writes them" if candump else "frame"
        what = "" if candump else "cannot be read: "
        msg = (
            f"{path}: {what}not one of its {reader.lines} {reader.unit} is a {name}; "
            f"line {line}: {verdict.name.lower()}: {text[:REPORTED]}"
        )
        with path.open("rb") as file:
            head = file.read(8192)
        if candump and b"\r" in head and b"\n" not in head:
            msg = f"{path}: its lines end in CR only; change them with `tr '\\r' '\\n'`"
            raise BadLogError(msg)
        from dbc.logs.screen import is_screen_form

        if is_screen_form(text):
            msg += (
                "; candump shows this on a screen: record with `candump -L IF` or `candump -l IF`"
            )
        elif not pattern and reader.unit == "lines":
            cure = f"traction-gateway convert {path} OUT.log --line auto"
            msg += f"; for text of another program: `{cure}`"
        raise BadLogError(msg)
    if left := [f"{v.name.lower()} {n}" for v, n in reader.counts.items() if n]:
        raise BadLogError(f"{path}: no frame in the log ({', '.join(left)})")


__all__ = ["BadLogError", "Log", "LogError", "OneChannel", "Replayed", "open_log", "replay"]
