"""From frames to samples: route, verify, decode, pair. Every frame ends in one counter.

May know: the message set through the codec, time stamps inside frames. May not know: clocks,
buses, estimators. Bad input never raises here; it is counted by cause, and the cause is kept
as the reason why the affected flag is unknown.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Final

from dbc.codec import Codec
from dbc.frame import Nanos
from dbc.frames import Block
from gateway.core import channel, inputs, receiving
from gateway.core.channel import Channel
from gateway.core.inputs import NONE
from gateway.core.receiving import NAMES, Receiver
from gateway.core.supervision import EMCY_ID, HEARTBEAT_ID, Supervision

ELECTRICAL = ("PhaseCurrents", "StatorVoltages")
SAMPLES = "Samples"
SLOW = ("Motion", "Status", "Temperatures")
MAX_GAP_NS: Final[Nanos] = 200_000_000
"""After a longer time without a sample the filter restarts instead of predicting."""
USABLE: Final = (1.0, 2.0)
"""`Quality` Valid and Degraded."""


class DriveInput:
    """Channels of one drive."""

    def __init__(self, node: int) -> None:
        self.node = node
        self.channels: dict[str, Channel] = {}
        self.electrical: tuple[Channel, ...] = ()
        self.limit_ns: Nanos = 0
        self.motion: Channel | None = None
        self.status: Channel | None = None

    def seat(self) -> None:
        """Note which channel carries what, once all are there."""
        self.motion, self.status = self.channels.get("Motion"), self.channels.get("Status")
        kinds = (SAMPLES,) if SAMPLES in self.channels else ELECTRICAL
        if all(kind in self.channels for kind in kinds):
            self.electrical = tuple(self.channels[kind] for kind in kinds)
            self.limit_ns = max(c.limit_ns for c in self.electrical)


class Inbox:
    """Entry of frames, with all state of reception."""

    def __init__(
        self,
        codec: Codec,
        nodes: Sequence[int],
        tick_ns: Nanos,
        supervision: Supervision,
        *,
        creep: bool = False,
    ) -> None:
        """Raises nothing: `bind` has already compared the DBC with the contract.

        creep: the gateway's optional messages are its own, too.
        """
        self.codec = codec
        self.supervision = supervision
        self.drives = [DriveInput(node) for node in nodes]
        self.added: Counter[str] = Counter()
        """Frames that the receiver has not counted: emergencies, and those left out before it."""
        own = {spec.key for spec in codec.own(creep=creep)} | {HEARTBEAT_ID, EMCY_ID}
        self.channels: list[Channel] = []
        keys: dict[int, int] = {}
        for index, drive in enumerate(self.drives):
            for kind in (*ELECTRICAL, SAMPLES, *SLOW):
                spec = codec.by_name.get(f"Drive{drive.node}_{kind}")
                if spec is not None:
                    one = Channel(spec, index, len(self.channels), tick_ns)
                    drive.channels[kind] = one
                    keys[spec.key] = one.row
                    self.channels.append(one)
        self.receiver = Receiver(
            codec, channel.records(self.channels), len(nodes),
            receiving.id_table(keys, own, supervision.ids), supervision, MAX_GAP_NS,
        )  # fmt: skip
        for drive in self.drives:
            drive.seat()

    def places(self, sum_limit_a: Sequence[float]) -> inputs.Places:
        """Channels of each drive. sum_limit_a: limit of the sum of a drive's phase currents, A."""
        rows = []
        for drive in self.drives:
            mine = [c.row for c in drive.channels.values()]
            slowly = [NONE if c is None else c.row for c in (drive.motion, drive.status)]
            electrical = [c.row for c in drive.electrical]
            rows.append((min(mine), max(mine) + 1, electrical, slowly[0], slowly[1]))
        return inputs.places(rows, [drive.limit_ns for drive in self.drives], sum_limit_a)

    def read_emergencies(self, block: Block, first: int) -> None:
        """Read the emergencies of the last tick, whose frames begin at `first`."""
        tick = self.receiver.pointer.tick
        for k in self.receiver.space["emergency_rows"][: tick.emergencies].tolist():
            known = self.supervision.observe(block.frame(first + k))
            self.added["canopen" if known else "unknown_id"] += 1

    @property
    def counts(self) -> Counter[str]:
        """Counts since the start: frames received, by result, and frames lost."""
        pointer = self.receiver.pointer
        found = Counter(self.added)
        counters = zip(NAMES, self.receiver.counters.tolist(), strict=True)
        more = ("received", "unpaired", "late", "left_out")
        others = {name: getattr(pointer, name) for name in more}
        for name, count in (*counters, *others.items()):
            if count:
                found[name] += count
        return found
