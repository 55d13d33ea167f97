"""Shrinks a long log to a short one with the same change of a flag: `traction-gateway shrink`.

The log is replayed up to a moment before the evidence for the change began; the state of the
gateway there is the start record. Of the frames from there to the flag, as many as possible are
left out, while the flag changes in the same ticks and the flag frame has the same bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import reduce
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.codec import Codec
from dbc.frame import SECOND, Frame, Nanos
from dbc.frames import Block, join
from gateway.core.flags import FlagKind
from gateway.core.gateway import Gateway
from gateway.core.start_record import State, set_state, state_of
from gateway.io.log_file import NO_FRAME, BadLogError, OneChannel, open_log
from gateway.io.logtime import LogTime
from gateway.io.replay import Briefly, replay
from gateway.logfiles.ddmin import Mask, minimise
from gateway.settings.config import Config, ConfigError

SENT_IN: Final = {FlagKind.ADHESION: "Gateway_Adhesion", FlagKind.THERMAL: "Gateway_Faults"}
"""Flags that can be requested, and the message that carries each."""
NEAR_NS: Final[Nanos] = SECOND // 20
"""Largest distance of a change from the requested time."""
SHOWN: Final = 5
MICROSECOND: Final[Nanos] = 1000
STEPS: Final = ("looking for the change", "replay up to the evidence", "leaving frames out")
"""Steps of `shrink`, in order."""
MOST_WORK: Final = 25_000_000
"""Frames that all trials together may replay, about 40 s; the frames left by then stay."""
TRIAL_WORK: Final = 1500
"""Fixed cost of a trial, in frames."""


class Wanted(NamedTuple):
    """A flag of a drive, and the approximate time of its change, s after the log's first frame."""

    kind: FlagKind
    node: int
    at_s: float

    @property
    def name(self) -> str:
        """The flag and drive in words."""
        return f"{self.kind.name.lower()} of drive {self.node}"


class Change(NamedTuple):
    """State of a flag from the tick at `now_ns` on, by evidence since `since_ns`."""

    now_ns: Nanos
    since_ns: Nanos
    state: int


class Outcome(NamedTuple):
    """Result of a trial that must stay the same: the flag's (tick, state), and the flag frame."""

    changes: tuple[tuple[Nanos, int], ...]
    frame: Frame | None


class Shrunk(NamedTuple):
    """A shrunk log and its origin.

    gateway, start: the start record's gateway and state; frames: those needed, of `total` in the
    log, whose first stamp is `first_ns`; flag_frame: sent by the gateway after them; word: label of
    the flag's state.
    """

    gateway: Gateway
    start: State
    frames: Block
    total: int
    first_ns: Nanos
    change: Change
    flag_frame: Frame
    word: str


def shrink(
    path: Path, config: Config, codec: Codec, wanted: Wanted, before_ns: Nanos,
    channel: str | None = None, step: Callable[[str], None] = lambda _what: None,
) -> Shrunk:  # fmt: skip
    """Return the shortest log found. before_ns: time from its start to the start of the evidence.

    step: called with each of `STEPS` before it begins.
    Raises ConfigError for a drive that is not configured and for a gateway whose state no start
    record can hold, BadLogError if the flag does not change or the log cannot be shrunk.
    """
    if wanted.node not in config.nodes:
        nodes = ", ".join(map(str, config.nodes))
        raise ConfigError("--flag", [f"no drive {wanted.node}; the configuration has {nodes}"])
    state_of(Gateway(config, codec, 0))
    log = _Log(path, config, codec, wanted, channel)
    step(STEPS[0])
    change, total = log.find()
    step(STEPS[1])
    start, frames, flag_frame = log.tail(change, before_ns)
    step(STEPS[2])
    trial = _Trial(log, start, frames, flag_frame)
    kept = minimise(_identifiers(frames), frames.size, trial.holds)
    signals = codec.by_id[log.can_id].signals
    name = f"{wanted.kind.name.capitalize()}{wanted.node}"
    word = next(s.labels for s in signals if s.name == name)[change.state]
    return Shrunk(
        trial.gateway, start, frames.pick(kept), total, log.first_ns, change, flag_frame, word
    )  # fmt: skip


class _Log:
    """A log, which is read several times, with the gateway's configuration and the wanted flag."""

    def __init__(
        self, path: Path, config: Config, codec: Codec, wanted: Wanted, channel: str | None
    ) -> None:
        self._path, self._channel, self._config, self._codec = path, channel, config, codec
        self._wanted, self._drive = wanted, config.nodes.index(wanted.node)
        self.period_ns = config.loop.period_ns
        self.can_id = codec.by_name[SENT_IN[wanted.kind]].can_id
        first = next(iter(self._read()), None)
        if first is None:
            raise BadLogError(f"{path}: {NO_FRAME}")
        self.first_ns = first.t_ns.item(0)

    def new(self, start_ns: Nanos) -> Gateway:
        """A new gateway, which has received nothing."""
        return Gateway(self._config, self._codec, start_ns)

    def changes_into(self, found: list[Change]) -> Callable[[Gateway], None]:
        """A callback for ticks in which any flag changed; it appends changes of the wanted flag."""

        def changed(gateway: Gateway) -> None:
            now = self.state_of_flag(gateway)
            if not found or found[-1].state != now.state:
                found.append(now)

        return changed

    def state_of_flag(self, gateway: Gateway) -> Change:
        """The wanted flag as of the last tick."""
        flag = gateway.status.drives["flag"][self._drive, self._wanted.kind]
        return Change(gateway.now_ns, int(flag["since_ns"]), int(flag["state"]))

    def find(self) -> tuple[Change, int]:
        """(change nearest to the requested time, number of frames in the log)."""
        found: list[Change] = []
        sink = Briefly(lambda _out: None, self.changes_into(found))
        done = replay(self._blocks(), self.new, self.period_ns, sink)
        at_s, span_s = self._wanted.at_s, (done.last_ns - done.first_ns) / SECOND
        if at_s > span_s + NEAR_NS / SECOND:
            raise BadLogError(f"--flag: {at_s:g} s is after the end of the log, {span_s:.3f} s")
        at_ns = done.first_ns + round(at_s * SECOND)
        found.sort(key=lambda change: abs(change.now_ns - at_ns))
        if abs(found[0].now_ns - at_ns) > NEAR_NS:
            times = sorted((change.now_ns - done.first_ns) / SECOND for change in found[:SHOWN])
            raise BadLogError(
                f"{self._wanted.name} does not change within {NEAR_NS / SECOND} s of {at_s:g} s; "
                f"the nearest changes are at {', '.join(f'{t_s:.3f}' for t_s in times)} s"
            )
        return found[0], done.frames

    def tail(self, change: Change, before_ns: Nanos) -> tuple[State, Block, Frame]:
        """(state before the evidence, frames from there to the flag, flag frame)."""
        begin_ns = min(change.since_ns, change.now_ns - self.period_ns) - before_ns
        ticks = max((begin_ns - self.first_ns) // self.period_ns, 0)
        start = _Start(self.first_ns + ticks * self.period_ns)
        kept: list[Block] = []
        sent: list[Frame] = []

        def until_sent() -> Iterator[Block]:
            for block in self._blocks():
                kept.append(block.pick(block.t_ns > start.next_ns))
                yield block
                if sent:
                    return

        def note_sent(out: Block) -> None:
            ours = (out.can_id == self.can_id) & (out.t_ns >= change.now_ns)
            sent.extend(out.pick(ours).frames())

        sink = Briefly(note_sent, lambda _gateway: None, start)
        replay(until_sent(), self.new, self.period_ns, sink)
        if start.state is None or start.state.now_ns >= change.now_ns:
            msg = "the flag has this state from the first tick on: there is no change to test"
            raise BadLogError(msg)
        if not sent:
            raise BadLogError("the log ends before a frame with the flag is sent")
        frames = _between(reduce(join, kept), start.state.now_ns, sent[0].t_ns, self.period_ns)
        return start.state, frames, sent[0]

    def _read(self) -> Iterable[Block]:
        blocks = OneChannel(open_log(self._path, strict=False).blocks, self._channel)
        return (block for block in blocks if block.size)

    def _blocks(self) -> Iterator[Block]:
        """Every frame that counts for `LogTime`, with stamps in the time of the ticks."""
        clock = LogTime(self.first_ns, self.period_ns)
        return (one.block for one in clock.steady(self._read()) if one.block.size)


class _Start:
    """Records the gateway's state after the first tick at or after `next_ns`."""

    def __init__(self, next_ns: Nanos) -> None:
        self.next_ns = next_ns
        self.state: State | None = None

    def took(self, now: Nanos, gateway: Gateway, _peak: NDArray[np.float64]) -> None:
        """See `gateway.io.replay.Samples`."""
        if self.state is None and now >= self.next_ns:
            self.state = state_of(gateway)


class _Trial:
    """Replays some of the frames from the start record on, and compares the outcome."""

    def __init__(self, log: _Log, start: State, frames: Block, flag_frame: Frame) -> None:
        """Raises BadLogError if all frames together do not give the flag frame of the whole log."""
        self.gateway = log.new(log.first_ns)
        self._log, self._start, self._frames, self._end_ns = log, start, frames, flag_frame.t_ns
        self._work = 0
        self._all = self._outcome(frames)
        if self._all.frame != flag_frame:
            msg = "a start record and the frames after it do not give the flag of the whole log"
            raise BadLogError(msg)

    def holds(self, kept: Mask) -> bool:
        """Whether these frames give the outcome of all frames; False once `MOST_WORK` is done."""
        self._work += TRIAL_WORK + int(kept.sum())
        if self._work > MOST_WORK:
            return False
        return bool(kept.any()) and self._outcome(self._frames.pick(kept)) == self._all

    def _outcome(self, frames: Block) -> Outcome:
        set_state(self.gateway, self._start)
        changes = [self._log.state_of_flag(self.gateway)]
        sent: list[Frame] = []

        def note_sent(out: Block) -> None:
            ours = (out.can_id == self._log.can_id) & (out.t_ns == self._end_ns)
            sent.extend(out.pick(ours).frames())

        sink = Briefly(note_sent, self._log.changes_into(changes))
        replay([frames], lambda _first: self.gateway, self._log.period_ns, sink)
        until = tuple((c.now_ns, c.state) for c in changes if c.now_ns <= self._end_ns)
        return Outcome(until, sent[0] if sent else None)


def _between(frames: Block, start_ns: Nanos, end_ns: Nanos, period_ns: Nanos) -> Block:
    """Frames after the start, up to the tick at `end_ns`; stamps in microseconds, as in candump.

    If that tick has no frames, the next frame is kept, so that the replay reaches the tick.
    """
    first, last, before = (
        int(np.searchsorted(frames.t_ns, t_ns, "right"))
        for t_ns in (start_ns, end_ns, end_ns - period_ns)
    )
    some = frames.part(first, max(last, before + 1))
    down = some.t_ns // MICROSECOND * MICROSECOND
    ticked_ns = start_ns + (some.t_ns - 1 - start_ns) // period_ns * period_ns
    # Rounded up where rounding down would move the frame to an earlier tick.
    return some._replace(t_ns=np.where(down > ticked_ns, down, down + MICROSECOND))


def _identifiers(frames: Block) -> list[Mask]:
    """Mask of the frames of each identifier (with flags), the most frequent first."""
    keys = frames.can_id.astype(np.int64) | frames.flags.astype(np.int64) << 32
    found, counts = np.unique(keys, return_counts=True)
    return [keys == found[k] for k in np.argsort(-counts, kind="stable")]
