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

from dbc.codec import ABSENT, NOT_AVAILABLE, VALID, Codec
from dbc.frame import ERROR, EXTENDED, FD, REMOTE, Frame, Nanos
from dbc.protection import Check, SmState
from gateway.channel import SAMPLE_NS, Channel
from gateway.health import Reason
from gateway.supervision import Supervision

ELECTRICAL = ("PhaseCurrents", "StatorVoltages")
SAMPLES = "Samples"
SLOW = ("Motion", "Status", "Temperatures")
MAX_GAP_NS: Final[Nanos] = 200_000_000
"""Longer without a sample: the filter starts anew instead of coasting."""
SUM_SMOOTHING: Final = 0.05
SQRT3: Final = math.sqrt(3.0)
RPM: Final = 2.0 * math.pi / 60.0
"""rad/s in one revolution per minute."""
USABLE: Final = (1.0, 2.0)
"""`Quality` Valid and Degraded."""
_ORDER = itemgetter(0, 1)
"""Time stamp, then id."""
_ODD = ERROR | REMOTE | EXTENDED

Half = tuple[Nanos, float, float]


class Sample(NamedTuple):
    """Currents and mean voltages of one instant of one drive, SI units, stationary frame.

    steps: sub-steps of SAMPLE_NS since the sample before; gap: sub-steps missing before that.
    """

    drive: int
    t_ns: Nanos
    u_alpha: float
    u_beta: float
    i_alpha: float
    i_beta: float
    steps: int
    gap: int


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
        self.currents: list[Half | None] = [None] * 16
        self.voltages: list[Half | None] = [None] * 16
        self.sequence: int | None = None
        self.sample_ns: Nanos | None = None
        self.torque_command: float | None = None
        self.speed: float | None = None
        self.torque: float | None = None
        self.irms: float | None = None
        self.sum_error = 0.0
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
        self.samples: list[Sample] = []
        self.temperatures: list[Temperatures] = []
        self.restart: set[int] = set()
        self.own = {spec.can_id for spec in codec.messages if spec.is_gateway}
        self.table: dict[int, Channel] = {}
        for index, drive in enumerate(self.drives):
            for kind in (*ELECTRICAL, SAMPLES, *SLOW):
                spec = codec.by_name.get(f"Drive{drive.node}_{kind}")
                if spec is not None:
                    channel = Channel(spec, index, tick_ns)
                    drive.channels[kind] = channel
                    self.table[spec.can_id] = channel
            drive.settled()
        self._handlers = {
            "PhaseCurrents": self._currents,
            "StatorVoltages": self._voltages,
            SAMPLES: self._block,
            "Motion": self._motion,
            "Status": self._status,
        }

    def take(self, frames: Iterable[Frame], now: Nanos) -> None:
        """Accept the frames of one tick, in the order of their time stamps, then ids."""
        self.samples.clear()
        self.temperatures.clear()
        self.restart.clear()
        rows: list[tuple[Channel, Nanos, bytes]] = []
        table = self.table
        # Stable: frames of one id with one stamp stay in the order in which they came.
        ordered = sorted(frames, key=_ORDER)
        for frame in ordered:
            channel = None if frame.flags & _ODD else table.get(frame.can_id)
            if channel is None:
                self._foreign(frame)
            elif self._admit(channel, frame, now):
                rows.append((channel, frame.t_ns, frame.data))
        self.counts["received"] += len(ordered)
        if rows:
            self._decode(rows)
        for channel in table.values():
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

    def _admit(self, channel: Channel, frame: Frame, now: Nanos) -> bool:
        """A rejected frame updates nothing, not even its good signals."""
        t_ns = frame.t_ns
        last = channel.last_ns
        if t_ns > now or (last is not None and t_ns < last):
            self.counts["time_back"] += 1
            return False
        channel.heard_ns = t_ns
        if len(frame.data) != channel.length or bool(frame.flags & FD) != channel.spec.is_fd:
            self.counts["wrong_length"] += 1
            channel.malformed()
            return False
        check = channel.verify(frame.data, t_ns)
        if check is Check.OK or check is Check.OK_SOME_LOST:
            if check is Check.OK_SOME_LOST:
                self.counts["lost"] += channel.receiver.missed
            if channel.receiver.state is SmState.INVALID and channel.protected:
                self.counts["not_yet_valid"] += 1
                return False
            return True
        self.counts[check.name.lower()] += 1
        return False

    def _decode(self, rows: list[tuple[Channel, Nanos, bytes]]) -> None:
        """Decode the tick's accepted frames in one call and hand them on, row by row."""
        index = np.array([row[0].spec.index for row in rows], dtype=np.int32)
        joined = b"".join([row[2].ljust(64, b"\0") for row in rows])
        payload = np.frombuffer(joined, dtype=np.uint8).reshape(-1, 64)
        value, validity = self.codec.decode_rows(index, payload)
        validity[validity == ABSENT] = VALID
        worst = validity.max(axis=1).tolist()
        values = value.tolist()
        decoded = 0
        for k, (channel, t_ns, data) in enumerate(rows):
            row = values[k]
            usable = channel.quality < 0 or row[channel.quality] in USABLE
            if channel.kind == "Temperatures":
                self._temperature(channel, t_ns, row, validity[k].tolist(), usable)
            elif worst[k] == VALID and usable:
                channel.cause = Reason.NONE
                channel.good_ns = t_ns
                decoded += 1
                self._handlers[channel.kind](channel, t_ns, row, data)
            else:
                missing = not usable or NOT_AVAILABLE in validity[k]
                channel.cause = Reason.NOT_AVAILABLE if missing else Reason.RANGE
                self.counts[channel.cause.name.lower()] += 1
        self.counts["decoded"] += decoded

    def _currents(self, channel: Channel, t_ns: Nanos, row: list[float], data: bytes) -> None:
        drive = self.drives[channel.drive]
        k_a, k_b, k_c = channel.picked
        a, b, c = row[k_a], row[k_b], row[k_c]
        # A real motor's phases sum to nothing; a slow average forgives noise.
        drive.sum_error += SUM_SMOOTHING * (abs(a + b + c) - drive.sum_error)
        counter = data[1] & 0x0F
        i = (t_ns, (2.0 * a - b - c) / 3.0, (b - c) / SQRT3)
        u = drive.voltages[counter]
        if u is None:
            drive.currents[counter] = i
        else:
            drive.voltages[counter] = None
            self._pair(channel, drive, counter, i, u)

    def _voltages(self, channel: Channel, t_ns: Nanos, row: list[float], data: bytes) -> None:
        drive = self.drives[channel.drive]
        k_alpha, k_beta = channel.picked
        counter = data[1] & 0x0F
        u = (t_ns, row[k_alpha], row[k_beta])
        i = drive.currents[counter]
        if i is None:
            drive.voltages[counter] = u
        else:
            drive.currents[counter] = None
            self._pair(channel, drive, counter, i, u)

    def _pair(self, channel: Channel, drive: DriveInput, counter: int, i: Half, u: Half) -> None:
        """Currents and voltages with the same counter, close in time, are one sample."""
        if abs(i[0] - u[0]) > channel.pair_ns:
            # The older half belongs to an earlier turn of the counter; keep the newer one.
            if i[0] > u[0]:
                drive.currents[counter] = i
            else:
                drive.voltages[counter] = u
            self.counts["unpaired"] += 1
            return
        t_ns = max(i[0], u[0])
        gap = self._advance(drive, channel, counter, 16, t_ns)
        if gap is not None:
            steps = channel.steps
            self.samples.append(
                Sample(channel.drive, t_ns, u[1], u[2], i[1], i[2], steps, gap * steps)
            )

    def _block(self, channel: Channel, t_ns: Nanos, row: list[float], _data: bytes) -> None:
        """Eight samples of a FD frame, 125 us apart; the last one at the frame's instant."""
        drive = self.drives[channel.drive]
        index, *picked = channel.picked
        gap = self._advance(drive, channel, int(row[index]) // 8, 8192, t_ns)
        if gap is None:
            return
        for k in range(8):
            a, b, u_alpha, u_beta = (row[c] for c in picked[4 * k : 4 * k + 4])
            missing = 8 * gap if k == 0 else 0
            i_beta = (a + 2.0 * b) / SQRT3
            at = t_ns - (7 - k) * SAMPLE_NS
            self.samples.append(Sample(channel.drive, at, u_alpha, u_beta, a, i_beta, 1, missing))

    def _advance(
        self, drive: DriveInput, channel: Channel, counter: int, modulus: int, t_ns: Nanos
    ) -> int | None:
        """Cycles missing before this sample; None if it is not newer than the last.

        The counter says how many cycles have passed, the stamps only which turn of it.
        """
        last, last_ns = drive.sequence, drive.sample_ns
        if last is None or last_ns is None or t_ns - last_ns > MAX_GAP_NS:
            self.restart.add(channel.drive)
            missing = 0
        else:
            delta = (counter - last) % modulus
            turns = round(((t_ns - last_ns) / channel.period_ns - delta) / modulus)
            missing = delta + modulus * turns - 1
            if missing < 0:
                self.counts["late_sample"] += 1
                return None
        drive.sequence, drive.sample_ns = counter, t_ns
        return missing

    def _motion(self, channel: Channel, _t_ns: Nanos, row: list[float], _data: bytes) -> None:
        drive = self.drives[channel.drive]
        speed, torque = channel.picked
        drive.speed = row[speed] * RPM
        drive.torque = row[torque]

    def _status(self, channel: Channel, _t_ns: Nanos, row: list[float], _data: bytes) -> None:
        drive = self.drives[channel.drive]
        command, irms = channel.picked
        drive.torque_command = row[command]
        drive.irms = row[irms]

    def _temperature(
        self, channel: Channel, t_ns: Nanos, row: list[float], valid: list[int], usable: bool
    ) -> None:
        """Each point by itself: one dead sensor must not silence the other three."""
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
