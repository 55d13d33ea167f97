"""From frames to samples: route, verify, decode, pair. Every frame ends in one counter.

May know: the message set through the codec, time stamps inside frames. May not know: clocks,
buses, estimators. Bad input never raises here; it is counted by cause, and the cause is kept
so that the affected flag can say why it is unknown.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np

from dbc import e2e
from dbc.block import Block, block_of
from dbc.codec import VALID, Codec
from dbc.frame import Frame, Nanos
from gateway import inputs, pairing, receiving, slow
from gateway._direct import Direct
from gateway._kernels import settle, take_block
from gateway.channel import Channel, channel_state
from gateway.inputs import NONE
from gateway.pairing import Trouble
from gateway.receiving import NAMES
from gateway.slow import Count, SlowState
from gateway.supervision import Supervision

ELECTRICAL = ("PhaseCurrents", "StatorVoltages")
SAMPLES = "Samples"
SLOW = ("Motion", "Status", "Temperatures")
MAX_GAP_NS: Final[Nanos] = 200_000_000
"""Longer without a sample: the filter starts anew instead of coasting."""
USABLE: Final = (1.0, 2.0)
"""`Quality` Valid and Degraded."""
OWN_CANOPEN: Final = frozenset({0x720, 0x0A0})
"""Heartbeat and emergency of node 32, the gateway."""


Found = tuple[int, int, int, bool]
"""What `take_block` gives."""


class Temperatures(NamedTuple):
    """One reading of a drive's points (stator, drive end, non-drive end, ambient), degC.

    NaN where not `valid`: the number is never used there. raw: tenths of a degree, -1 if none.
    """

    drive: int
    t_ns: Nanos
    celsius: tuple[float, ...]
    valid: tuple[bool, ...]
    raw: tuple[int, ...]


class DriveInput:
    """What one drive has sent: its channels, and its row of what is kept of all drives (SI)."""

    def __init__(self, row: int, node: int, slow: SlowState) -> None:
        """row: its place in the arrays."""
        self.node = node
        self.channels: dict[str, Channel] = {}
        self.electrical: tuple[Channel, ...] = ()
        self.limit_ns: Nanos = 0
        self.motion: Channel | None = None
        self.status: Channel | None = None
        self._row, self._slow = row, slow

    def settled(self) -> None:
        """All channels are there: note which carry what."""
        self.motion, self.status = self.channels.get("Motion"), self.channels.get("Status")
        kinds = (SAMPLES,) if SAMPLES in self.channels else ELECTRICAL
        if all(kind in self.channels for kind in kinds):
            self.electrical = tuple(self.channels[kind] for kind in kinds)
            self.limit_ns = max(channel.limit_ns for channel in self.electrical)

    @property
    def speed(self) -> float | None:
        """Rotor speed as last sent, rad/s."""
        return _known(self._slow.speed.item(self._row))

    @property
    def irms(self) -> float | None:
        """Current as last sent with a torque command, A."""
        commanded = not math.isnan(self._slow.command.item(self._row))
        return self._slow.irms.item(self._row) if commanded else None


def _known(number: float) -> float | None:
    return None if math.isnan(number) else number


class Inbox:
    """Per-tick entry of frames. Holds all receive state; `take` is the only mutator."""

    def __init__(
        self, codec: Codec, nodes: Sequence[int], tick_ns: Nanos, supervision: Supervision
    ) -> None:
        """Raises nothing: `bind` has already compared the DBC with the contract."""
        self.codec = codec
        self.supervision = supervision
        self.pairs = pairing.start(len(nodes))
        self.slow = slow.start(len(nodes))
        self.drives = [DriveInput(row, node, self.slow) for row, node in enumerate(nodes)]
        self.counts: Counter[str] = Counter()
        self.samples = pairing.room(0)
        self.seen = 0
        """Rows of `scratch` with temperatures that came in this tick."""
        self.motions = 0
        """Rows of `readings` that came in this tick."""
        self.restart: set[int] = set()
        own = {spec.key for spec in codec.messages if spec.is_gateway} | OWN_CANOPEN
        self.channels: list[Channel] = []
        keys: dict[int, int] = {}
        for index, drive in enumerate(self.drives):
            for kind in (*ELECTRICAL, SAMPLES, *SLOW):
                spec = codec.by_name.get(f"Drive{drive.node}_{kind}")
                if spec is not None:
                    channel = Channel(spec, index, tick_ns)
                    drive.channels[kind] = channel
                    keys[spec.key] = len(self.channels)
                    self.channels.append(channel)
            drive.settled()
        self.state = channel_state(self.channels)
        self.e2e_config = e2e.configs([channel.spec for channel in self.channels])
        self.e2e_state = e2e.states(len(self.channels))
        self.routes = receiving.routes(keys, own, supervision.ids)
        self.wiring = pairing.wiring(self.channels)
        self._take, self._settle = Direct(take_block), Direct(settle)
        self._make_room(64)

    def places(self, sum_limit_a: Sequence[float]) -> inputs.Places:
        """Which channels are whose. sum_limit_a: what a drive's phases may sum to, A."""
        rows = []
        for drive in self.drives:
            mine = [channel.row for channel in drive.channels.values()]
            slowly = [NONE if c is None else c.row for c in (drive.motion, drive.status)]
            electrical = [channel.row for channel in drive.electrical]
            rows.append((min(mine), max(mine) + 1, electrical, slowly[0], slowly[1]))
        return inputs.places(rows, [drive.limit_ns for drive in self.drives], sum_limit_a)

    @property
    def rows(self) -> int:
        """Frames of a tick that there is room for."""
        return len(self.scratch.t_ns)

    def _make_room(self, rows: int) -> None:
        self.room = pairing.room(rows)
        self.scratch = receiving.scratch(rows, self.codec.width)
        self.readings = slow.readings(rows)

    def begin(self) -> None:
        """Nothing has come in this tick yet."""
        self.seen = self.motions = 0
        self.restart.clear()

    def take(self, frames: Iterable[Frame] | Block, now: Nanos) -> Block:
        """Accept the frames of one tick, in the order of their time stamps, then ids.

        Returns them as a block, in that order.
        """
        self.begin()
        block = frames if isinstance(frames, Block) else block_of(frames)
        if not block.size:
            self.samples = self.room.first(0)
            self._settle(now, self.e2e_config, self.e2e_state, self.state)
            return block
        if block.size > self.rows:
            self._make_room(2 * block.size)
        found = self._take_in(block, now)
        if found[0] < 0:
            block = block.ordered()
            found = self._take_in(block, now)
        self.note(block, found)
        return block

    def note(self, block: Block, found: Found) -> None:
        """What `take_block` has found in a tick's frames, other than what it keeps itself."""
        samples, self.seen, foreign, odd = found
        self.samples = self.room.first(samples)
        self.counts["received"] += block.size
        if odd:
            self.count()
        else:
            self.counts["decoded"] += block.size
        for k in self.scratch.foreign[:foreign].tolist():
            known = self.supervision.observe(block.frame(k))
            self.counts["canopen" if known else "unknown_id"] += 1
        if self.pairs.trouble.item(Trouble.ANY):
            self._trouble()
        if self.slow.came.item(Count.CHANGED):
            self.motions = self.slow.came.item(Count.READINGS)
            self.slow.came[:] = 0

    def _take_in(self, block: Block, now: Nanos) -> Found:
        """See `take_block`."""
        return self._take(  # type: ignore[no-any-return]
            block.t_ns, block.can_id, block.flags, block.length, block.data,
            now, self.routes, self.e2e_config, self.e2e_state, self.state,
            self.codec.tables.address, self.wiring, MAX_GAP_NS, self.pairs, self.slow,
            self.scratch, self.readings, self.room, self.supervision.beats,
        )  # fmt: skip

    def count(self) -> None:
        """Take over the loop's counters."""
        tally = self.scratch.tally
        for name, count in zip(NAMES, tally.tolist(), strict=True):
            if count:
                self.counts[name] += count
        tally[:] = 0

    def _trouble(self) -> None:
        """Take over halves that found no other, samples that came late, drives that begin anew."""
        pairs = self.pairs
        self.restart.update(np.flatnonzero(pairs.restart).tolist())
        pairs.restart[:] = False
        for trouble in (Trouble.UNPAIRED, Trouble.LATE):
            self.counts[trouble.name.lower()] += int(pairs.trouble[trouble])
        pairs.trouble[:] = 0

    @property
    def temperatures(self) -> list[Temperatures]:
        """Readings of the tick, for whoever wants to show them."""
        return [self._temperature(row) for row in self.scratch.seen[: self.seen].tolist()]

    def _temperature(self, row: int) -> Temperatures:
        scratch = self.scratch
        channel = self.channels[scratch.channel.item(row)]
        value, valid = scratch.value[row].tolist(), scratch.validity[row].tolist()
        usable = channel.quality < 0 or value[channel.quality] in USABLE
        points = channel.picked
        good = tuple(usable and valid[k] == VALID for k in points)
        return Temperatures(
            channel.drive,
            scratch.t_ns.item(row),
            tuple(value[k] if ok else math.nan for k, ok in zip(points, good, strict=True)),
            good,
            tuple(round(value[k] * 10.0) if ok else -1 for k, ok in zip(points, good, strict=True)),
        )
