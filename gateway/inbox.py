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

from dbc.block import Block, block_of
from dbc.codec import VALID, Codec
from dbc.frame import Frame, Nanos
from gateway import channel, inputs, pairing, receiving
from gateway.channel import Channel, ChannelState
from gateway.inputs import NONE
from gateway.pairing import PairState, Samples
from gateway.receiving import NAMES, Receiver, Scratch, Wiring
from gateway.slow import Readings, SlowState
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

    def __init__(self, row: int, node: int) -> None:
        """row: its place in the records; `seat` says where these are."""
        self.node = node
        self.channels: dict[str, Channel] = {}
        self.electrical: tuple[Channel, ...] = ()
        self.limit_ns: Nanos = 0
        self.motion: Channel | None = None
        self.status: Channel | None = None
        self._row = row

    def seat(self, receiver: Receiver) -> None:
        """All channels are there: note which carry what, and where records are kept."""
        self._receiver = receiver
        self.motion, self.status = self.channels.get("Motion"), self.channels.get("Status")
        kinds = (SAMPLES,) if SAMPLES in self.channels else ELECTRICAL
        if all(kind in self.channels for kind in kinds):
            self.electrical = tuple(self.channels[kind] for kind in kinds)
            self.limit_ns = max(c.limit_ns for c in self.electrical)

    @property
    def speed(self) -> float | None:
        """Rotor speed as last sent, rad/s."""
        return _known(self._receiver.slow.speed.item(self._row))

    @property
    def irms(self) -> float | None:
        """Current as last sent with a torque command, A."""
        slow = self._receiver.slow
        commanded = not math.isnan(slow.command.item(self._row))
        return slow.irms.item(self._row) if commanded else None


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
        self.drives = [DriveInput(row, node) for row, node in enumerate(nodes)]
        self.counts: Counter[str] = Counter()
        self.samples = pairing.room(0)
        self.seen = 0
        """Rows of `scratch` with temperatures that came in this tick."""
        self.motions = 0
        """Rows of `readings` that came in this tick."""
        own = {spec.key for spec in codec.messages if spec.is_gateway} | OWN_CANOPEN
        self.channels: list[Channel] = []
        keys: dict[int, int] = {}
        for index, drive in enumerate(self.drives):
            for kind in (*ELECTRICAL, SAMPLES, *SLOW):
                spec = codec.by_name.get(f"Drive{drive.node}_{kind}")
                if spec is not None:
                    one = Channel(spec, index, tick_ns)
                    drive.channels[kind] = one
                    keys[spec.key] = len(self.channels)
                    self.channels.append(one)
        self.receiver = Receiver(
            codec, channel.records(self.channels), len(nodes),
            receiving.id_table(keys, own, supervision.ids), supervision, MAX_GAP_NS,
        )  # fmt: skip
        for row, each in enumerate(self.channels):
            each.seat(row, self.receiver)
        for drive in self.drives:
            drive.seat(self.receiver)

    @property
    def state(self) -> ChannelState:
        """Of the channels."""
        return self.receiver.state

    @property
    def pairs(self) -> PairState:
        """Of the drives: samples."""
        return self.receiver.pairs

    @property
    def slow(self) -> SlowState:
        """Of the drives: what they send slowly."""
        return self.receiver.slow

    @property
    def wiring(self) -> Wiring:
        """Constants of the channels."""
        return self.receiver.wiring

    @property
    def scratch(self) -> Scratch:
        """Accepted frames of the tick."""
        return self.receiver.scratch

    @property
    def room(self) -> Samples:
        """Where samples are put."""
        return self.receiver.room

    @property
    def readings(self) -> Readings:
        """Where readings are put."""
        return self.receiver.readings

    def places(self, sum_limit_a: Sequence[float]) -> inputs.Places:
        """Which channels are whose. sum_limit_a: what a drive's phases may sum to, A."""
        rows = []
        for drive in self.drives:
            mine = [c.row for c in drive.channels.values()]
            slowly = [NONE if c is None else c.row for c in (drive.motion, drive.status)]
            electrical = [c.row for c in drive.electrical]
            rows.append((min(mine), max(mine) + 1, electrical, slowly[0], slowly[1]))
        return inputs.places(rows, [drive.limit_ns for drive in self.drives], sum_limit_a)

    @property
    def restart(self) -> set[int]:
        """Drives whose filter starts anew in this tick."""
        return set(np.flatnonzero(self.receiver.drives["restart"]).tolist())

    def begin(self) -> None:
        """Nothing has come in this tick yet."""
        self.seen = self.motions = 0

    def take(self, frames: Iterable[Frame] | Block, now: Nanos) -> Block:
        """Accept the frames of one tick, in the order of their time stamps, then ids.

        Returns them as a block, in that order.
        """
        self.begin()
        block = frames if isinstance(frames, Block) else block_of(frames)
        if not block.size:
            self.samples = self.room.first(0)
            self.receiver.receive(block, now)
            return block
        if block.size > self.receiver.rows:
            self.receiver.make_room(2 * block.size)
        if not self.receiver.receive(block, now):
            block = block.ordered()
            self.receiver.receive(block, now)
        self.note(block)
        return block

    def note(self, block: Block) -> None:
        """Take over what the receiver has found in a tick's frames."""
        if not block.size:
            self.samples = self.room.first(0)
            return
        found = self.receiver.received()
        self.samples, self.seen = self.room.first(found.samples), found.temperatures
        self.motions = found.motions
        self.counts["received"] += block.size
        if found.only_decoded:
            self.counts["decoded"] += block.size
        else:
            self.count()
        for k in self.scratch.foreign[: found.emergencies].tolist():
            known = self.supervision.observe(block.frame(k))
            self.counts["canopen" if known else "unknown_id"] += 1
        if found.unpaired or found.late:
            self.counts["unpaired"] += found.unpaired
            self.counts["late"] += found.late

    def count(self) -> None:
        """Take over the receiver's counters."""
        counters = self.receiver.counters
        for name, count in zip(NAMES, counters.tolist(), strict=False):
            if count:
                self.counts[name] += count
        counters[:] = 0

    @property
    def temperatures(self) -> list[Temperatures]:
        """Readings of the tick, for whoever wants to show them."""
        return [self._temperature(row) for row in self.scratch.seen[: self.seen].tolist()]

    def _temperature(self, row: int) -> Temperatures:
        scratch = self.scratch
        one = self.channels[scratch.channel.item(row)]
        value, valid = scratch.value[row].tolist(), scratch.validity[row].tolist()
        usable = one.quality < 0 or value[one.quality] in USABLE
        points = one.picked
        good = tuple(usable and valid[k] == VALID for k in points)
        return Temperatures(
            one.drive,
            scratch.t_ns.item(row),
            tuple(value[k] if ok else math.nan for k, ok in zip(points, good, strict=True)),
            good,
            tuple(round(value[k] * 10.0) if ok else -1 for k, ok in zip(points, good, strict=True)),
        )
