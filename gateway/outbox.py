"""From what is said to frames: what is due, encoded, counted and protected.

May know: the message set and `now`. Every value that is not known goes out as its
not-available code or as `Unknown`; nothing is ever repeated from an earlier tick.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from dbc.codec import PAYLOAD, Codec, MessageSpec
from dbc.codec_tables import CodecTables
from dbc.e2e import configs, protect
from dbc.frame import BRS, FD, Frame, Nanos
from gateway._direct import Direct
from gateway._outbox_kernels import send
from gateway.flags import Status
from gateway.sources import COUNTED, OF_A_DRIVE, OF_THE_SET, Memory, Room, Sheet, Source
from gateway.view import Counted

if TYPE_CHECKING:
    from dbc.authentication import Authenticator

VOUCHED: Final = ("Gateway_Adhesion", "Gateway_Faults")
"""What `Gateway_Auth` follows, where flags are authenticated."""
CHANGING: Final = "Gateway_Faults"
"""Goes out in the tick of a change, too."""
COUNTING: Final = ("Gateway_Info", "Gateway_Status")


class Outbox:
    """The gateway's own messages: schedule and counters. `due` is the only mutator."""

    def __init__(
        self,
        codec: Codec,
        nodes: tuple[int, ...],
        config_hash: int,
        tick_ns: Nanos,
        authenticator: Authenticator | None = None,
    ) -> None:
        """The set of messages is fixed here; nothing else can ever be sent."""
        self.config_hash = config_hash
        self.codec = codec
        names = [f"Gateway_{n}" for n in ("Adhesion", "Faults", "Info", "Status")]
        names += [f"Drive{node}_{kind}" for node in nodes for kind in ("Estimate", "Thermal")]
        specs = sorted((codec.by_name[name] for name in names), key=lambda spec: spec.can_id)
        self.specs: dict[str, MessageSpec] = {spec.name: spec for spec in specs}
        self.tables = CodecTables(specs)
        self.e2e_config = configs(specs)
        width = self.tables.width
        source, drive = np.zeros((2, len(specs), width), dtype=np.int64)
        given = np.zeros((len(specs), width), dtype=np.uint8)
        for m, spec in enumerate(specs):
            for name, what, k in _sources(spec, nodes):
                column = spec.column(name)
                given[m, column], source[m, column], drive[m, column] = 1, what, k
        place = list(self.specs)
        cycles = np.array([spec.cycle_ns for spec in specs], dtype=np.int64)
        # A real tick wakes a little later than the one that the grid counts from, or a little
        # less late: what is due within half a tick is due now.
        slack = tick_ns // 2
        self.sheet = Sheet(
            self.tables.address, given, source, drive, cycles, place.index(CHANGING), slack, tick_ns
        )
        next_ns, counter = np.zeros((2, len(specs)), dtype=np.int64)
        self.memory = Memory(next_ns, counter, np.zeros(len(nodes) + 4, dtype=np.int64))
        self.room = Room(
            np.zeros((len(specs), width)), np.zeros((len(specs), PAYLOAD), dtype=np.uint8),
            np.zeros(len(specs), dtype=np.int64),
        )  # fmt: skip
        self.heads = [
            (spec.can_id, spec.length, (FD | (BRS if spec.brs else 0)) if spec.is_fd else 0)
            for spec in specs
        ]
        self._counting = [place.index(name) for name in COUNTING]
        self._counted_ns: Nanos = 0
        """When counts are wanted next."""
        self.counts = np.full(len(COUNTED), np.nan)
        self._begun = False
        self._send = Direct(send)
        self.authenticator = authenticator
        self.auth = codec.by_name["Gateway_Auth"]
        self.vouches = 0
        """Frames of `Gateway_Auth` so far."""
        self.vouched = {self.specs[name].can_id: self.specs[name].key for name in VOUCHED}

    def restart(self, now: Nanos) -> None:
        """Everything is due now; the cycles count from here."""
        self._begun = True
        self.memory.next_ns[:] = now
        self.memory.key[:] = -1
        self._counted_ns = now

    def begin(self, now: Nanos) -> None:
        """At the first tick the cycles begin."""
        if not self._begun:
            self.restart(now)

    def wants_counts(self, now: Nanos) -> bool:
        """Whether this tick's frames say what is counted: `note_counts` before `due`."""
        self.begin(now)
        return now >= self._counted_ns

    def note_counts(self, counted: Counted) -> None:
        """What `Gateway_Info` and `Gateway_Status` say from now on."""
        values = {**counted._asdict(), "config_hash": self.config_hash}
        for k, name in enumerate(COUNTED):
            value = values[name]
            self.counts[k] = np.nan if value is None else value

    def due(self, status: Status, now: Nanos) -> list[Frame]:
        """Frames of this tick, in the order of their ids; after each flag frame its `Auth`."""
        self.begin(now)
        count = self._send(
            now, status, self.counts, self.sheet, self.e2e_config, self.memory, self.room
        )
        self.note_sent(now)
        if not count:
            return []
        payload = self.room.payload[:count].tobytes()
        messages = enumerate(self.room.message[:count].tolist())
        frames = [self.frame(message, payload, row, now) for row, message in messages]
        return frames if self.authenticator is None else self._vouch(self.authenticator, frames)

    def note_sent(self, now: Nanos) -> None:
        """When counts are wanted next, after what was due at `now`."""
        if now >= self._counted_ns:
            often = min(self.sheet.cycle_ns[self._counting]) <= self.sheet.tick_ns
            later = int(min(self.memory.next_ns[self._counting])) - self.sheet.slack_ns
            self._counted_ns = now if often else later

    def frame(self, message: int, payload: bytes, row: int, now: Nanos) -> Frame:
        """One of ours by its number; its bytes are those of a row of payload."""
        can_id, length, flags = self.heads[message]
        at = PAYLOAD * row
        return Frame(now, can_id, payload[at : at + length], flags)

    def _vouch(self, authenticator: Authenticator, frames: list[Frame]) -> list[Frame]:
        out = []
        for frame in frames:
            out.append(frame)
            key = self.vouched.get(frame.can_id)
            if key is not None:
                freshness, mac = authenticator.sign(key, frame.data)
                payload = self.codec.encode(self.auth, {"Freshness": freshness, "Mac": mac})
                protect(self.auth, payload, self.vouches)
                self.vouches += 1
                flags = (FD | (BRS if self.auth.brs else 0)) if self.auth.is_fd else 0
                out.append(Frame(frame.t_ns, self.auth.can_id, bytes(payload), flags))
        return out


def _sources(spec: MessageSpec, nodes: Sequence[int]) -> Iterator[tuple[str, Source, int]]:
    """Of every signal that carries something: its name, where that comes from, of which drive."""
    if not spec.name.startswith("Gateway_"):
        for name, source in OF_A_DRIVE[spec.kind].items():
            yield name, source, nodes.index(spec.node)
        return
    own, by_drive = OF_THE_SET[spec.name]
    for name, source in own.items():
        yield name, source, 0
    for prefix, source in by_drive.items():
        for k, node in enumerate(nodes):
            yield f"{prefix}{node}", source, k
