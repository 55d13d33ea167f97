"""Frames with right counters and checksums whose values are wrong.

What a hung converter, swapped phases or a wrong scale put on the bus: the receiver's end-to-end
protection finds nothing. Currents are those of `PhaseCurrents` (classic CAN) or `Samples` (CAN FD).

May know: bits, the message set. May not know: the plant, the gateway, clocks.
"""

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.e2e import protect
from dbc.frames import EMPTY
from dbc.spec import MessageSpec, SignalSpec

Raws = list[int]
"""Raw values of the currents of one frame: Ia, Ib, Ic, or Ia_0, Ib_0, Ia_1, Ib_1, .."""

VALUE_KINDS: Final = (
    "held", "held_drive", "held_motion", "late", "rotated", "swapped", "other_drive", "tenth",
    "tenfold", "sign_turned",
)  # fmt: skip
"""`held`: all currents keep their last values; `held_drive`: so do all messages of the drive;
`held_motion`: so do Speed and Torque; `late`: currents come one frame late; `rotated`: Ib, Ic, Ia
instead of Ia, Ib, Ic; `swapped`: Ia and Ib exchanged; `other_drive`: the next drive's currents."""
KINDS_OF_CURRENT: Final = tuple(kind for kind in VALUE_KINDS if kind != "held_motion")
"""Those that make the currents wrong."""
CURRENTS: Final = ("PhaseCurrents", "Samples")
SEQUENCE: Final = ("Crc", "Counter", "SampleIndex")
"""Signals that a hung converter does not stop: they are the communication layer's own."""


class Error(NamedTuple):
    """How far what is sent is off the honest values in a tick: root mean square over its frames.

    current_a, speed_rpm (N,): of the phase currents, A, and of the drive's measured speed, rpm.
    """

    current_a: NDArray[np.float64]
    speed_rpm: NDArray[np.float64]


class _Message(NamedTuple):
    """A message of a drive. drive: from 0; values: all signals but those of the sequence."""

    spec: MessageSpec
    drive: int
    values: tuple[SignalSpec, ...]
    currents: tuple[SignalSpec, ...]
    motion: tuple[SignalSpec, ...]


class ValueFaults:
    """Makes the values of drives' frames wrong, tick by tick.

    Remembers the last honest frame of each message: what is held is the value from before the
    fault, and `late` begins with it.
    """

    def __init__(self, codec, nodes):
        """nodes: CANopen numbers of the drives, in order.

        Raises ValueError for a DBC with big-endian or float signals.
        """
        self._drives = len(nodes)
        self._messages = {}
        for spec in codec.messages:
            if spec.node in nodes and not spec.is_gateway:
                self._messages[spec.can_id] = _message(spec, nodes.index(spec.node))
        self._current_id = [0] * self._drives
        for can_id, message in self._messages.items():
            if message.currents:
                self._current_id[message.drive] = can_id
        self._before = EMPTY
        """The honest frames of the tick before."""
        self._kept = {}
        """What is held of a message, by kind and identifier, as an integer of its payload."""
        self._none = Error(np.zeros(self._drives), np.zeros(self._drives))
        self.error = self._none
        """Of the last tick."""

    def apply(self, faults, sent):
        """The frames of a tick with these faults, (kind, drive from 0) each; others pass unchanged.

        To be asked of every tick in turn, also without faults. Kinds that are unknown are passed
        over. Two faults of one drive act one after the other.
        """
        mine = [(kind, drive) for kind, drive in faults if kind in VALUE_KINDS]
        if self._kept:
            going = set(mine)
            self._kept = {
                key: value
                for key, value in self._kept.items()
                if (key[0], self._messages[key[1]].drive) in going
            }
        out, self.error = sent, self._none
        if mine:
            out = sent._replace(data=sent.data.copy())
            for kind, drive in mine:
                self._make_wrong(kind, drive, sent, out)
            self.error = self._error({drive for _, drive in mine}, sent, out)
        self._before = sent
        return out

    def _make_wrong(self, kind, drive, sent, out):
        """One fault. sent: what is true; out: what becomes of it, in place."""
        # Of `late` and `other_drive`: the rows where the honest currents are that are sent instead.
        lent = iter(self._instead(kind, drive, sent))
        for k, can_id in enumerate(sent.can_id.tolist()):
            message = self._messages.get(can_id)
            if message is None or message.drive != drive:
                continue
            spec = message.spec
            word = int.from_bytes(out.data[k, : spec.length].tobytes(), "little")
            if kind.startswith("held"):
                signals = {"held": message.currents, "held_drive": message.values,
                           "held_motion": message.motion}[kind]  # fmt: skip
                new = self._held(kind, can_id, signals, word)
            elif not message.currents:
                continue
            elif kind in _CHANGES:
                raws = [_get(word, s) for s in message.currents]
                new = _with(word, message.currents, _CHANGES[kind](message.currents, raws))
            else:
                honest = next(lent, None)
                if honest is None:
                    continue
                raws = [_get(honest, s) for s in message.currents]
                new = _with(word, message.currents, raws)
            if new != word:
                payload = bytearray(new.to_bytes(spec.length, "little"))
                protect(spec, payload, _counter(spec, payload))
                out.data[k, : spec.length] = np.frombuffer(payload, dtype=np.uint8)

    def _error(self, drives, sent, out):
        error = Error(np.zeros(self._drives), np.zeros(self._drives))
        for can_id, message in self._messages.items():
            if message.drive not in drives:
                continue
            for signals, column in ((message.currents, error.current_a),
                                    (message.motion[:1], error.speed_rpm)):  # fmt: skip
                if signals:
                    pairs = zip(_words(sent, can_id), _words(out, can_id), strict=True)
                    off = [_get(a, s) - _get(b, s) for a, b in pairs for s in signals if a != b]
                    size = float(np.mean(np.square(off))) ** 0.5 if off else 0.0
                    column[message.drive] = size * signals[0].scale
        return error

    def _held(self, kind, can_id, signals, word):
        """The frame with the values from before the fault, or from its first such frame."""
        if not signals:
            return word
        key = kind, can_id
        if key not in self._kept:
            before = _words(self._before, can_id)
            self._kept[key] = before[-1] if before else word
        kept = self._kept[key]
        return _with(word, signals, [_get(kept, s) for s in signals])

    def _instead(self, kind, drive, sent):
        """Payloads whose currents are sent instead, one for each of the drive's frames."""
        if kind == "late":
            can_id = self._current_id[drive]
            before, now = _words(self._before, can_id), _words(sent, can_id)
            return (before[-1:] or now[:1]) + now[:-1] if now else []
        if kind == "other_drive" and self._drives > 1:
            return _words(sent, self._current_id[(drive + 1) % self._drives])
        return []


def _message(spec, drive):
    if any(s.is_big_endian or s.is_float for s in spec.signals):
        msg = f"{spec.name}: only little-endian integers can be made wrong"
        raise ValueError(msg)
    values = tuple(s for s in spec.signals if s.name not in SEQUENCE)
    named = [s for s in values if s.name[:2] in ("Ia", "Ib", "Ic")]
    currents = tuple(named) if spec.kind in CURRENTS else ()
    motion = tuple(s for s in values if s.name in ("Speed", "Torque") and spec.kind == "Motion")
    return _Message(spec, drive, values, currents, motion)


def _words(block, can_id):
    """Payloads with this identifier, in order, as integers."""
    rows = np.flatnonzero(block.can_id == can_id)
    return [
        int.from_bytes(block.data[k, : block.length[k]].tobytes(), "little") for k in rows.tolist()
    ]


def _counter(spec, payload):
    return _get(int.from_bytes(payload, "little"), spec.signals[spec.column("Counter")])


def _get(word, signal):
    raw = word >> signal.start & ((1 << signal.length) - 1)
    return raw - (1 << signal.length) if signal.is_signed and raw >> signal.length - 1 else raw


def _with(word, signals, raws):
    for signal, raw in zip(signals, raws, strict=True):
        mask = (1 << signal.length) - 1
        word = word & ~(mask << signal.start) | (raw & mask) << signal.start
    return word


def _scaled(factor):
    """Not available stays so; what is too large saturates."""

    def change(signals, raws):
        return [
            raw if raw == s.not_available else _within(s, round(raw * factor))
            for s, raw in zip(signals, raws, strict=True)
        ]

    return change


def _within(signal, raw):
    return min(max(raw, signal.raw_min), signal.raw_max)


def _rotated(signals, raws):
    if signals[-1].name == "Ic":
        return raws[1:] + raws[:1]
    out = []
    for a, b, signal in zip(raws[::2], raws[1::2], signals[1::2], strict=True):
        none = signal.not_available
        third = none if none is not None and none in (a, b) else _within(signal, -a - b)
        out += [b, third]
    return out


def _swapped(signals, raws):
    if signals[-1].name == "Ic":
        return [raws[1], raws[0], raws[2]]
    return [raw for a, b in zip(raws[::2], raws[1::2], strict=True) for raw in (b, a)]


_CHANGES: Final[dict[str, Callable[[Sequence[SignalSpec], Raws], Raws]]] = {
    "rotated": _rotated, "swapped": _swapped, "tenth": _scaled(0.1), "tenfold": _scaled(10.0),
    "sign_turned": _scaled(-1.0),
}  # fmt: skip
