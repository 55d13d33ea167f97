"""Fuzz target: the frame decoder. Input: a small program of frames and ticks.

A program is a byte for the set-up and then instructions of one byte and its operands: a frame of
a drive with a right checksum, whatever its content; one that was tampered with; any frame at all;
the end of a tick. What is missing at the end reads as zeros.
"""

from collections import Counter
from zlib import crc32

import numpy as np

from dbc.e2e import COUNTERS, MAX_DELTA, Check, Receiver, SmState, counter_of, protect
from dbc.frame import BRS, ERROR, EXTENDED, FD, MS, REMOTE, SECOND, Frame
from dbc.spec import Match, Profile
from gateway.core.gateway import Gateway
from gateway.core.supervision import EMCY_ID, HEARTBEAT_ID, Supervision
from gateway.settings.config import parse
from tests.reference.receive import COPIES, GUARD_NS, SECOND_SENDER, TOO_SOON
from tests.sender import FD_FILE, codec_for
from tests.stations import Inbox, last_samples

NODES = (1, 2)
CODECS = (codec_for(NODES), codec_for(NODES, FD_FILE))
CONFIGS = tuple(
    parse({"drive": [{"node": n} for n in NODES], "dbc": {"file": name}})
    for name in ("traction.dbc", "traction_fd.dbc")
)
SPECS = tuple(
    tuple(m for m in codec.messages if m.node in NODES and not m.is_gateway) for codec in CODECS
)
LAST = (1 << 63) - 1
FIRST = -(1 << 63)
STARTS = (10 * MS, 1_790_000_000 * SECOND, LAST - 3 * SECOND, 0)
STRIDES = (0, 1, MS, 10 * MS, 10 * MS, 10 * MS, SECOND, 1 << 62)
STEPS = 16
"""One input of so many goes through the whole core."""
USED = ("decoded", "not_available", "range")
ENDS = (
    "error_frame", "remote", "own", "time_back", "wrong_length", "error", "repeated",
    "wrong_sequence", "not_yet_valid",
)  # fmt: skip
FOREIGN = ("canopen", "unknown_id")
MOST = 100
"""Frames of one program."""
LONGEST = 16
"""Ticks of one program."""


class _Bytes:
    """Reads on, zeros behind the end."""

    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, n):
        piece = self.data[self.at : self.at + n]
        self.at += n
        return piece.ljust(n, b"\0")

    def byte(self):
        return self.take(1)[0]


class Twin:
    """The receive path in plain Python, by `Codec.match` and `dbc.e2e.Receiver`."""

    def __init__(self, codec, tick_ns):
        self.codec = codec
        self.receivers = {
            m.key: Receiver(m) for m in codec.messages if m.node in NODES and not m.is_gateway
        }
        self.own = {m.key for m in codec.own(creep=False)} | {HEARTBEAT_ID, EMCY_ID}
        self.last = {}
        self.latest = {}
        self.copies = Counter()
        self.fouls = {}
        self.guarded = {}
        self.limit = {m.key: 3 * m.cycle_ns + tick_ns for m in codec.messages}

    def take(self, frames, now):
        ends = Counter(self._end(f, now) for f in sorted(frames, key=lambda f: (f.t_ns, f.can_id)))
        for key, last in self.last.items():
            if now - last > self.limit[key]:
                self.receivers[key].cycle(Check.NO_NEW_DATA)
        return ends

    def _end(self, frame, now):
        if frame.flags & ERROR:
            return "error_frame"
        if frame.flags & REMOTE:
            return "remote"
        key = frame.can_id | (frame.flags & EXTENDED) << 31
        if key in self.own:
            return "own"
        receiver = self.receivers.get(key)
        if receiver is None:
            return "foreign" if 0 <= frame.t_ns <= now else "time_back"
        if frame.t_ns > now or frame.t_ns < self.last.get(key, 0):
            return "time_back"
        match, spec = self.codec.match(frame)
        if match is not Match.OK:
            receiver.cycle(Check.ERROR)
            return "wrong_length"
        check = receiver.check(frame.data)
        for _ in range(receiver.missed):
            receiver.cycle(Check.NO_NEW_DATA)
        state = receiver.cycle(check)
        if check is Check.ERROR:
            return "error"
        self._order(key, frame, spec)
        if check in (Check.REPEATED, Check.WRONG_SEQUENCE):
            return check.name.lower()
        self.last[key] = frame.t_ns
        doubted = state is SmState.INVALID or frame.t_ns < self.guarded.get(key, -1)
        return "not_yet_valid" if doubted else "used"

    def _order(self, key, frame, spec):
        """What the counter of a frame with a right checksum says of who sends."""
        last = self.latest.setdefault(key, frame)
        if last is frame or spec.profile is Profile.NONE:
            return
        turn = COUNTERS[spec.profile]
        ahead = (counter_of(spec, frame.data) - counter_of(spec, last.data)) % turn
        if frame.data == last.data:
            self.copies[key] = min(self.copies[key] + 2, COPIES + 1)
            if self.copies[key] >= COPIES:
                self.fouls[key] = [frame.t_ns] * SECOND_SENDER
                self.guarded[key] = min(frame.t_ns + GUARD_NS, LAST)
            return
        self.latest[key] = frame
        if 1 <= ahead <= MAX_DELTA:
            self.copies[key] = max(self.copies[key] - 1, 0)
        elif frame.t_ns - last.t_ns < TOO_SOON * (ahead or turn) * spec.cycle_ns:
            self._foul(key, frame.t_ns)

    def _foul(self, key, t_ns):
        """A sign of a second sender; a run of them is doubted for a while."""
        run = self.fouls.setdefault(key, [])
        if run and t_ns - run[-1] > GUARD_NS:
            run.clear()
        run.append(t_ns)
        if len(run) >= SECOND_SENDER:
            self.guarded[key] = min(t_ns + GUARD_NS, LAST)


def ticks_of(data):
    """Which codec, and the ticks of a program: frames and `now` each."""
    source = _Bytes(data)
    head = source.byte()
    which = head & 1
    now = STARTS[(head >> 1) & 3]
    counters = [0] * len(SPECS[which])
    ticks, held, count = [], [], 0
    while source.at < len(data) and count < MOST and len(ticks) < LONGEST:
        what = source.byte()
        if what >= 0xC0:
            ticks.append((held, now))
            held, now = [], min(LAST, now + STRIDES[what & 7])
            continue
        count += 1
        frame = _sent(source, which, counters, now) if what < 0x80 else _any(source, now)
        tweak = what & 15 if 0x40 <= what < 0x80 else 0
        held.append(_tampered(frame, tweak, source))
    ticks.append((held, now))
    return which, ticks


def _stamp(source, now):
    how = source.byte()
    if how < 0xC0:
        return max(FIRST, now - (how & 15) * MS)
    kind = how & 7
    if kind < 3:
        return (min(LAST, now + 1), LAST, FIRST)[kind]
    return int.from_bytes(source.take(8), "little", signed=True)


def _sent(source, which, counters, now):
    """A frame of a drive with a right checksum, and any content."""
    how = source.byte()
    k = how % len(SPECS[which])
    spec = SPECS[which][k]
    payload = bytearray(source.take(min(spec.length, source.byte() & 63))[: spec.length])
    payload = payload.ljust(spec.length, b"\0")
    if how & 0x80:
        # `Quality` Valid.
        place = 1 if spec.length == 8 else 3
        payload[place] = payload[place] & 0x0F | 0x10 if spec.length == 8 else 1
    # A step is mostly one; it may also be none, or some.
    counters[k] += (1, 1, 1, 1, 1, 0, 2, 5)[source.byte() & 7]
    protect(spec, payload, counters[k])
    flags = (FD | BRS) if spec.is_fd else 0
    return Frame(_stamp(source, now), spec.can_id, bytes(payload), flags)


def _any(source, now):
    can_id = int.from_bytes(source.take(4), "little")
    flags = source.byte() & 63
    if not flags & EXTENDED and can_id & 1 << 31:
        can_id &= 0x7FF
    size = source.byte() % 80
    return Frame(_stamp(source, now), can_id, source.take(size), flags, "", source.byte() % 17 - 1)


def _tampered(frame, how, source):
    if how == 1:
        return frame._replace(flags=source.byte() & 63)
    if how == 2:
        return frame._replace(data=frame.data[: source.byte() & 63])
    if how == 3:
        return frame._replace(data=frame.data + source.take(source.byte() & 63))
    if how == 4 and frame.data:
        data = bytearray(frame.data)
        at = source.byte() % (8 * len(data))
        data[at >> 3] ^= 1 << (at & 7)
        return frame._replace(data=bytes(data))
    if how == 5:
        return frame._replace(can_id=frame.can_id ^ 1 << (source.byte() % 29))
    return frame


def frames(data, inbox=Inbox, gateway=Gateway, every=STEPS):
    """Nothing raises, every frame ends in the counter that the plain twin says. Returns frames."""
    which, ticks = ticks_of(data)
    codec, config = CODECS[which], CONFIGS[which]
    period = config.loop.period_ns
    twin = Twin(codec, period)
    whole = crc32(data) % every == 0
    core = None
    if whole:
        core = gateway(config, codec, max(0, ticks[0][1] - period))
        box = core.inbox
    else:
        box = inbox(codec, NODES, period, Supervision(NODES, 300 * MS))
    sent = {}
    total = 0
    for came, now in ticks:
        before = Counter(box.counts)
        if core is None:
            box.take(came, now)
        else:
            _well_formed(codec, core.step(came, now), now, sent)
        ends = Counter(box.counts)
        ends.subtract(before)
        _as_told(ends, twin.take(came, now), len(came))
        samples = last_samples(box)
        assert np.isfinite(samples.u).all()
        assert np.isfinite(samples.y).all()
        total += len(came)
    return total


def _as_told(ends, expected, received):
    told = {name: ends[name] for name in ENDS}
    told["used"] = sum(ends[name] for name in USED)
    told["foreign"] = sum(ends[name] for name in FOREIGN)
    assert ends["received"] == received == sum(told.values()), (ends, received)
    assert +Counter(told) == expected, (told, expected)


def _well_formed(codec, out, now, sent):
    """Ours, of the right length and kind, in sequence, with a right checksum, no state Invalid."""
    for frame in out:
        match, spec = codec.match(frame)
        assert match is Match.OK, frame
        assert spec.is_gateway, frame
        assert frame.t_ns == now
        receiver = sent.setdefault(spec.key, Receiver(spec))
        assert receiver.check(frame.data) is Check.OK, frame
        for name, reading in codec.decode(spec, frame.data).items():
            known = spec.signals[spec.column(name)].labels
            if known.get(3) == "Invalid":
                assert reading.raw in (0, 1, 2), (name, frame)
