"""The gateway's own frames: their messages as `gateway/core/transmit.c` sends them.

May know: the message set and `now`. Every value that is not known is sent as its
not-available code or as `Unknown`; nothing is ever repeated from an earlier tick.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial
from struct import Struct, calcsize
from typing import TYPE_CHECKING, Final

import numpy as np
from _traction_core import ffi, lib

from dbc.codec import Codec
from dbc.codec_tables import CodecTables
from dbc.e2e import configs, protect
from dbc.frame import BRS, FD, Frame, Nanos
from dbc.frames import MAX_DATA_BYTES, Block, blank, block_of
from dbc.records import TRANSMITTER, TX_FRAME, TX_MESSAGE, TX_SIGNAL, Addressed, Records
from dbc.spec import MessageSpec
from gateway.core.flags import Status
from gateway.core.tx_signals import OF_A_DRIVE, OF_THE_SET
from gateway.settings.config import ConfigError

if TYPE_CHECKING:
    from dbc.secoc_sender import Authenticator

VOUCHED: Final = ("Gateway_Adhesion", "Gateway_Faults")
"""Messages that `Gateway_Auth` follows if flags are authenticated."""
_SENT: Final = Struct(
    f"=qi{MAX_DATA_BYTES}s{TX_FRAME.itemsize - calcsize(f'=qi{MAX_DATA_BYTES}s')}x"
)
"""A `tx_frame`: stamp, message, data."""
_frame: Final = partial(tuple.__new__, Frame)
CHANGING: Final = "Gateway_Faults"
"""Message that is also sent in the tick of a change."""


class Outbox(Addressed):
    """The gateway's own messages: schedule and counters (`struct transmitter`).

    `due` is the only mutator. The rules are in `gateway/core/transmit.c`.
    """

    def __init__(
        self,
        codec: Codec,
        nodes: tuple[int, ...],
        config_hash: int,
        tick_ns: Nanos,
        authenticator: Authenticator | None = None,
        *,
        creep: bool = False,
    ) -> None:
        """The set of messages is fixed here; nothing else can ever be sent.

        creep: with `Drive{n}_Adhesion`. Raises ConfigError if the DBC lacks any message.
        """
        self.config_hash = config_hash
        self.codec = codec
        names = [f"Gateway_{n}" for n in ("Adhesion", "Faults", "Info", "Status")]
        kinds = ("Estimate", "Thermal", *(["Adhesion"] if creep else []))
        names += [f"Drive{node}_{kind}" for node in nodes for kind in kinds]
        if missing := [name for name in names if name not in codec.by_name]:
            cure = "take it from the shipped DBC, or leave out [adhesion] send_creep"
            raise ConfigError(
                str(codec.path), [f"{name}: message missing; {cure}" for name in missing]
            )
        specs = sorted((codec.by_name[name] for name in names), key=lambda spec: spec.can_id)
        self.specs: dict[str, MessageSpec] = {spec.name: spec for spec in specs}
        self.tables = CodecTables(specs)
        self.signals = np.zeros((len(specs), self.tables.width), TX_SIGNAL)
        """(M, S): where each signal's value comes from."""
        for own, spec in zip(self.signals, specs, strict=True):
            for name, source, k in _sources(spec, nodes):
                own[spec.column(name)] = source, k
        self.messages = np.zeros(len(specs), TX_MESSAGE)
        """(M,) in the order of their ids."""
        self.messages["e2e_config"] = configs(specs)
        self.messages["cycle_ns"] = [max(spec.cycle_ns, 1) for spec in specs]
        self.messages["signal_count"] = [len(spec.signals) for spec in specs]
        self.messages["on_change"] = [spec.name == CHANGING for spec in specs]
        self.record = np.zeros(1, TRANSMITTER)
        self.record["message_count"], self.record["drive_count"] = len(specs), len(nodes)
        # A real tick starts a little later or earlier than the grid that counts from the first
        # tick: what is due within half a tick is due now.
        self.record["tick_ns"], self.record["slack_ns"] = tick_ns, tick_ns // 2
        self._thermal_sent = np.zeros(len(nodes), dtype=np.uint8)
        self._value = np.zeros(self.tables.width)
        self._given = np.zeros(self.tables.width, dtype=np.uint8)
        self.frames = np.zeros(len(specs), TX_FRAME)
        """Room for the frames of a tick."""
        self.heads = [
            (spec.can_id, spec.length, (FD | (BRS if spec.brs else 0)) if spec.is_fd else 0)
            for spec in specs
        ]
        self._heads = block_of(
            [Frame(0, can_id, bytes(size), flags) for can_id, size, flags in self.heads]
        )
        self._begun = False
        self.authenticator = authenticator
        self.auth = codec.by_name["Gateway_Auth"]
        self.vouches = 0
        """Frames of `Gateway_Auth` so far."""
        self.vouched = {self.specs[name].can_id: self.specs[name].key for name in VOUCHED}
        self.link()
        counts = self.record["counts"]
        counts["config_hash"] = config_hash
        for name in ("bus_load_percent", "latency_p99_us", "lateness_p99_us"):
            counts[name] = math.nan

    def link(self) -> None:
        """See `Addressed`."""
        for message, own in zip(self.messages, self.signals, strict=True):
            message["signals"] = own.ctypes.data
        self.record["codec"] = self.tables.address
        self.record["messages"] = self.messages.ctypes.data
        self.record["thermal_sent"] = self._thermal_sent.ctypes.data
        self.record["value"], self.record["given"] = (
            self._value.ctypes.data, self._given.ctypes.data,
        )  # fmt: skip
        self.pointer = ffi.from_buffer("struct transmitter *", self.record)
        self._frames = ffi.from_buffer("struct tx_frame[]", self.frames)

    def restart(self, now: Nanos) -> None:
        """Make every message due now; the cycles count from here."""
        self._begun = True
        lib.transmit_restart(self.pointer, now)

    def begin(self, now: Nanos) -> None:
        """Begin the cycles at the first tick."""
        if not self._begun:
            self.restart(now)

    def note_timing(self, latency_p99_us: int, lateness_p99_us: int) -> None:
        """The driver's own measurements, for `Gateway_Info`."""
        counts = self.pointer.counts
        counts.latency_p99_us, counts.lateness_p99_us = latency_p99_us, lateness_p99_us

    @property
    def timing(self) -> tuple[float | None, float | None]:
        """Latency and lateness as noted last, us."""
        counts = self.pointer.counts
        return _known(counts.latency_p99_us), _known(counts.lateness_p99_us)

    def note_rejected(self, frames: int) -> None:
        """Set how many frames were rejected before they came to the receiver."""
        self.pointer.counts.rejected_before = frames

    def due(self, status: Status, now: Nanos) -> list[Frame]:
        """Frames of this tick, in the order of their ids; after each flag frame its `Auth`."""
        self.begin(now)
        count = lib.transmit(
            self.pointer, ffi.from_buffer("struct drive_status[]", status.drives),
            ffi.from_buffer("struct train_status *", status.train), now, self._frames,
        )  # fmt: skip
        return self.frames_of(self.frames[:count])

    def frames_of(self, sent: Records) -> list[Frame]:
        """Frames from `tx_frame` (K,); after each flag frame its `Auth`."""
        frames = []
        for t_ns, message, data in _SENT.iter_unpack(sent.tobytes()):
            can_id, length, flags = self.heads[message]
            frames.append(_frame((t_ns, can_id, data[:length], flags, "", -1)))
        return frames if self.authenticator is None else self._vouch(self.authenticator, frames)

    def block_of(self, sent: Records) -> Block:
        """The same as a block, without any `Auth`."""
        out, message, heads = blank(len(sent), self._heads.names), sent["message"], self._heads
        out.t_ns[:] = sent["t_ns"]
        out.can_id[:], out.flags[:] = heads.can_id[message], heads.flags[message]
        out.length[:], out.data[:] = heads.length[message], sent["data"]
        return out

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


def _known(number: float) -> float | None:
    return None if math.isnan(number) else number


def _sources(spec: MessageSpec, nodes: Sequence[int]) -> Iterator[tuple[str, int, int]]:
    """Of every signal with a value: its name, the value's source, the index of the drive."""
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
