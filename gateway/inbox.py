"""From frames to samples: route, verify, decode, pair. Every frame ends in one counter.

May know: the message set through the codec, time stamps inside frames. May not know: clocks,
buses, estimators. Bad input never raises here; it is counted by cause, and the cause is kept
so that the affected flag can say why it is unknown.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from operator import itemgetter
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.codec import NOT_AVAILABLE, VALID, Codec
from dbc.frame import ERROR, EXTENDED, FD, REMOTE, Frame, Nanos
from dbc.protection import Check, SmState
from gateway import pairing
from gateway._kernels import take_rows
from gateway.channel import Channel
from gateway.health import Reason
from gateway.pairing import Row, Trouble
from gateway.supervision import Supervision

ELECTRICAL = ("PhaseCurrents", "StatorVoltages")
SAMPLES = "Samples"
SLOW = ("Motion", "Status", "Temperatures")
MAX_GAP_NS: Final[Nanos] = 200_000_000
"""Longer without a sample: the filter starts anew instead of coasting."""
RPM: Final = 2.0 * math.pi / 60.0
"""rad/s in one revolution per minute."""
USABLE: Final = (1.0, 2.0)
"""`Quality` Valid and Degraded."""
STEADY_NM: Final = 0.5
STEADY_SHARE: Final = 0.05
"""A command that moved less between two Status frames is steady: 5 % and the wire's noise."""
OWN_CANOPEN: Final = frozenset({0x720, 0x0A0})
"""Heartbeat and emergency of node 32, the gateway."""
_ORDER = itemgetter(0, 1)
"""Time stamp, then id."""
_ODD = ERROR | REMOTE | EXTENDED

Array = NDArray[np.float64]


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
    """What one drive has sent: channels, half pairs, last slow values (SI)."""

    def __init__(self, node: int) -> None:
        self.node = node
        self.channels: dict[str, Channel] = {}
        self.sample_ns: Nanos | None = None
        self.torque_command: float | None = None
        self.command_steady = True
        """The command has hardly changed since the Status before."""
        self.speed: float | None = None
        self.torque: float | None = None
        self.irms: float | None = None
        self.sum_error = 0.0
        """Smoothed |Ia + Ib + Ic|, A."""
        self.electrical: tuple[Channel, ...] = ()
        self.limit_ns: Nanos = 0

    def settled(self) -> None:
        """All channels are there: note which carry currents and voltages."""
        kinds = (SAMPLES,) if SAMPLES in self.channels else ELECTRICAL
        if all(kind in self.channels for kind in kinds):
            self.electrical = tuple(self.channels[kind] for kind in kinds)
            self.limit_ns = max(channel.limit_ns for channel in self.electrical)

    def fresh(self, now: Nanos) -> bool:
        """True while the newest complete sample is within its age limit."""
        return self.sample_ns is not None and now - self.sample_ns <= self.limit_ns


class Inbox:
    """Per-tick entry of frames. Holds all receive state; `take` is the only mutator."""

    def __init__(
        self, codec: Codec, nodes: Sequence[int], tick_ns: Nanos, supervision: Supervision
    ) -> None:
        """Raises nothing: `bind` has already compared the DBC with the contract."""
        self.codec = codec
        self.supervision = supervision
        self.drives = [DriveInput(node) for node in nodes]
        self.counts: Counter[str] = Counter()
        self.samples = pairing.room(0)
        self.temperatures: list[Temperatures] = []
        self.restart: set[int] = set()
        self.own = {spec.can_id for spec in codec.messages if spec.is_gateway} | OWN_CANOPEN
        self.table: dict[int, Channel] = {}
        for index, drive in enumerate(self.drives):
            for kind in (*ELECTRICAL, SAMPLES, *SLOW):
                spec = codec.by_name.get(f"Drive{drive.node}_{kind}")
                if spec is not None:
                    channel = Channel(spec, index, tick_ns)
                    drive.channels[kind] = channel
                    self.table[spec.can_id] = channel
            drive.settled()
        channels = list(self.table.values())
        for number, channel in enumerate(channels):
            channel.number = number
        self._index = np.array([channel.index for channel in channels], dtype=np.int32)
        self._wiring = pairing.wiring(channels)
        self._pairs = pairing.start(len(self.drives))
        self._room = pairing.room(64)

    def take(self, frames: Iterable[Frame], now: Nanos) -> None:
        """Accept the frames of one tick, in the order of their time stamps, then ids."""
        self.temperatures.clear()
        self.restart.clear()
        rows: list[tuple[Channel, Nanos, bytes]] = []
        special: list[int] = []
        find = self.table.get
        # Stable: frames of one id with one stamp stay in the order in which they came.
        ordered = sorted(frames, key=_ORDER)
        for frame in ordered:
            t_ns, can_id, data, flags, _, _ = frame
            channel = None if flags & _ODD else find(can_id)
            if channel is None:
                self._foreign(frame)
                continue
            last = channel.last_ns
            if t_ns > now or (last is not None and t_ns < last):
                self.counts["time_back"] += 1
                continue
            channel.heard_ns = t_ns
            if len(data) != channel.length or flags & FD != channel.fd:
                self.counts["wrong_length"] += 1
                channel.malformed()
            elif channel.verify(data, t_ns) or self._admit(channel):
                if channel.slow or channel.cause is not Reason.NONE:
                    special.append(len(rows))
                rows.append((channel, t_ns, data.ljust(64, b"\0")))
        self.counts["received"] += len(ordered)
        if rows:
            self._decode(rows, special)
        else:
            self.samples = self._room.first(0)
        for channel in self.table.values():
            channel.settle(now)

    def _foreign(self, frame: Frame) -> None:
        """Count a frame that is none of the drives' messages."""
        flags = frame.flags
        if flags & ERROR:
            cause = "error_frame"
        elif flags & REMOTE:
            cause = "remote"
        elif not flags & EXTENDED and frame.can_id in self.own:
            cause = "own"
        elif self.supervision.observe(frame):
            cause = "canopen"
        else:
            cause = "unknown_id"
        self.counts[cause] += 1

    def _admit(self, channel: Channel) -> bool:
        """Count what `verify` did not pass at once; a rejected frame updates nothing at all."""
        check = channel.check
        if check is Check.OK or check is Check.OK_SOME_LOST:
            self.counts["lost"] += channel.receiver.missed
            if channel.receiver.state is SmState.INVALID and channel.protected:
                self.counts["not_yet_valid"] += 1
                return False
            return True
        self.counts[check.name.lower()] += 1
        return False

    def _decode(self, rows: list[tuple[Channel, Nanos, bytes]], special: list[int]) -> None:
        """Decode the tick's accepted frames in one call, pair them, hand on the `special` ones."""
        n = len(rows)
        if len(self._room.drive) < 8 * n:
            self._room = pairing.room(2 * n)
        number = np.array([row[0].number for row in rows], dtype=np.int64)
        joined = b"".join([row[2] for row in rows])
        payload = np.frombuffer(joined, dtype=np.uint8).reshape(-1, 64)
        stamps = np.array([row[1] for row in rows], dtype=np.int64)
        value, validity = self.codec.decode_rows(self._index[number], payload)
        verdict = np.empty(n, dtype=np.uint8)
        count = take_rows(
            number, stamps, payload, value, validity,
            self._wiring, MAX_GAP_NS, self._pairs, verdict, self._room,
        )  # fmt: skip
        self.samples = self._room.first(count)
        self._electrical()
        good = n
        # Plain electrical rows are done; the rest is handed on one by one.
        for k in range(n) if verdict.any() else special:
            channel, t_ns, _ = rows[k]
            if channel.kind == "Temperatures":
                good -= 1
                self._temperature(channel, t_ns, value[k].tolist(), validity[k].tolist())
            elif verdict[k]:
                good -= 1
                missing = verdict[k] == Row.MISSING
                channel.cause = Reason.NOT_AVAILABLE if missing else Reason.RANGE
                self.counts[channel.cause.name.lower()] += 1
            else:
                channel.cause = Reason.NONE
                channel.good_ns = t_ns
                if channel.slow:
                    self._slow(channel, value[k])
        self.counts["decoded"] += good

    def _electrical(self) -> None:
        """Take over what the compiled loop has found out."""
        pairs = self._pairs
        if pairs.trouble.item(Trouble.ANY):
            self.restart.update(np.flatnonzero(pairs.restart).tolist())
            pairs.restart[:] = False
            for trouble in (Trouble.UNPAIRED, Trouble.LATE):
                self.counts[trouble.name.lower()] += int(pairs.trouble[trouble])
            pairs.trouble[:] = 0
        stamps, errors = pairs.sample_ns.tolist(), pairs.sum_error.tolist()
        for drive, t_ns, error in zip(self.drives, stamps, errors, strict=True):
            drive.sample_ns = t_ns if t_ns >= 0 else None
            drive.sum_error = error

    def _slow(self, channel: Channel, row: Array) -> None:
        """Keep the last measured speed and torque, or command and current."""
        drive = self.drives[channel.drive]
        first, second = (row.item(column) for column in channel.picked)
        if channel.kind == "Motion":
            drive.speed, drive.torque = first * RPM, second
        else:
            before = drive.torque_command
            near = STEADY_NM + STEADY_SHARE * abs(first)
            drive.command_steady = before is None or abs(first - before) <= near
            drive.torque_command, drive.irms = first, second

    def _temperature(
        self, channel: Channel, t_ns: Nanos, row: list[float], valid: list[int]
    ) -> None:
        """Each point by itself: one dead sensor must not silence the other three."""
        usable = channel.quality < 0 or row[channel.quality] in USABLE
        points = channel.picked
        good = tuple(usable and valid[k] == VALID for k in points)
        channel.cause = Reason.NONE if usable else Reason.NOT_AVAILABLE
        if all(good):
            self.counts["decoded"] += 1
        elif not usable or any(valid[k] == NOT_AVAILABLE for k in points):
            self.counts["not_available"] += 1
        else:
            self.counts["range"] += 1
        if any(good):
            channel.good_ns = t_ns
        self.temperatures.append(
            Temperatures(
                channel.drive,
                t_ns,
                tuple(row[k] if ok else math.nan for k, ok in zip(points, good, strict=True)),
                good,
                tuple(
                    round(row[k] * 10.0) if ok else -1 for k, ok in zip(points, good, strict=True)
                ),
            )
        )
