"""`gateway/core/receive.c` and its parts equal the reference in plain Python, tick by tick."""

from __future__ import annotations

import copy
import math
from dataclasses import replace

import numpy as np
import pytest
from _traction_core import ffi, lib

from dbc.codec import Codec, bind
from dbc.frame import BRS, ERROR, EXTENDED, FD, MS, REMOTE, SECOND, Frame
from dbc.frames import block_of
from dbc.records import SEQUENCE_GUARD
from dbc.spec import Profile
from gateway.core.channel import SHORTEST_STEP, USED, sequence_guards
from gateway.core.codes import Reason
from gateway.core.inbox import MAX_GAP_NS
from gateway.core.receiving import Tally
from gateway.core.supervision import Supervision
from tests.reference import receive as reference
from tests.same import same_values
from tests.sample_rows import readings_of
from tests.sender import CLASSIC, FD_FILE, Sender, codec_for
from tests.stations import Inbox, any_lost

NODES = (1, 2, 3)
TICK = 10 * MS
TIMEOUT = 300 * MS
SIGNALS = {
    "PhaseCurrents": ("Ia", "Ib", "Ic"), "StatorVoltages": ("Ualpha", "Ubeta"),
    "Motion": ("Speed", "Torque", "ElectricalAngle"), "Status": ("TorqueCommand", "Irms", "State"),
    "Temperatures": ("Tstator", "Tde", "Tnde", "Tambient"),
}  # fmt: skip


def ranges(spec):
    """Names of a message's values, and the plausible part of each one's range."""
    signals = [s for s in spec.signals if s.name not in ("Crc", "Counter", "Quality")]
    ends = np.array([(s.raw_min, s.raw_max) for s in signals])
    scale, offset = np.array([(s.scale, s.offset) for s in signals]).T
    return [s.name for s in signals], *(0.4 * (ends.T * scale + offset))


class Bus:
    """Three drives and everything that goes wrong, at random."""

    def __init__(self, codec, seed, wrong):
        self.rng, self.wrong, self.codec = np.random.default_rng(seed), wrong, codec
        self.senders = [
            Sender(codec, spec.name)
            for spec in codec.messages
            if spec.node in NODES and spec.kind in USED
        ]
        self.ranges = {sender.spec.name: ranges(sender.spec) for sender in self.senders}
        self.index = 0

    def values(self, spec):
        """Plausible numbers, seldom others: not available, out of range, no quality."""
        names, low, high = self.ranges[spec.name]
        out = dict(zip(names, self.rng.uniform(low, high).tolist(), strict=True))
        if "State" in out:
            out["State"] = int(self.rng.integers(1, 4))
        if "TorqueCommand" in out:
            out["TorqueCommand"] = 20.0 + self.rng.choice([0.0, 0.4, 1.4, 1.6, 5.0])
        if "SampleIndex" in out:
            out["SampleIndex"] = 8 * (self.index % 8192) + (self.rng.random() < self.wrong)
        if self.rng.random() < self.wrong and any(s.name == "Quality" for s in spec.signals):
            out["Quality"] = self.rng.choice([0, 1, 2, 15])
        if self.rng.random() < self.wrong:
            out[self.rng.choice(list(out))] = self.rng.choice([math.nan, 1e9, -1e9])
        return out

    def frames(self, now):
        """Of one tick."""
        out = []
        for sender in self.senders:
            due = max(1, round(TICK / sender.spec.cycle_ns))
            for k in range(due):
                if sender.spec.cycle_ns > TICK and self.rng.random() > TICK / sender.spec.cycle_ns:
                    continue
                t = (
                    now
                    - TICK
                    + (k + 1) * min(sender.spec.cycle_ns, TICK)
                    - int(self.rng.integers(MS))
                )
                self.index = (t // sender.spec.cycle_ns) if sender.spec.kind == "Samples" else 0
                out.append(sender.frame(t, **self.values(sender.spec)))
        out += [
            Frame(now - TICK + 1000 * n, 0x700 + n, b"\5") for n in NODES if now % (50 * MS) == 0
        ]
        return sorted(self.damaged(out, now), key=lambda f: (f.t_ns, f.can_id))

    def damaged(self, frames, now):
        out = []
        for frame in frames:
            roll = self.rng.random() / max(self.wrong, 1e-9)
            out += [frame] if roll > 1 else self.one_damaged(frame, now)
        if self.rng.random() < self.wrong:
            out += [self.foreign(now) for _ in range(4)]
        return out

    def one_damaged(self, frame, now):
        rng = self.rng
        kind = rng.integers(13)
        flipped = bytes([frame.data[0] ^ 1]) + frame.data[1:]
        return {
            0: [], 1: [frame, frame], 2: [frame._replace(data=flipped)],
            3: [frame._replace(data=frame.data[1:])], 4: [frame._replace(flags=frame.flags ^ FD)],
            5: [frame._replace(t_ns=frame.t_ns - 30 * MS)], 6: [frame._replace(t_ns=now + 5)],
            7: [frame._replace(t_ns=-1)], 8: [frame._replace(flags=frame.flags | REMOTE)],
            9: [frame._replace(flags=ERROR)], 10: [frame._replace(flags=frame.flags | EXTENDED)],
            11: [frame._replace(t_ns=min(now, frame.t_ns + 8 * MS))], 12: [frame] * 4,
        }[int(kind)]  # fmt: skip

    def foreign(self, now):
        rng = self.rng
        ids = (0x701, 0x702, 0x081, 0x082, 0x720, 0x0A0, 0x7FF, 0x123, 0x1F0, 0x704, 0x77F)
        data = rng.choice([b"", b"\0", b"\5", b"\x7f", b"\x85", b"\4", b"\5\0", b"\1", bytes(8)])
        flags = int(rng.choice([0, 0, 0, 0, REMOTE, FD | BRS, EXTENDED, EXTENDED | REMOTE]))
        own = [spec.can_id for spec in self.codec.messages if spec.is_gateway]
        can_id = int(rng.choice([*ids, *own]))
        return Frame(now - int(rng.integers(TICK)), can_id, bytes(data), flags)


def both(codec, tick=TICK):
    box = Inbox(codec, NODES, tick, Supervision(NODES, TIMEOUT))
    plain = reference.Receiver(codec, NODES, tick, USED, TIMEOUT, MAX_GAP_NS)
    return box, plain


def rows(*columns):
    return [tuple(row) for row in zip(*(np.asarray(c).tolist() for c in columns), strict=True)]


def assert_same(box, plain, *, came=True):
    """All that either remembers."""
    if came:
        s, r, space = box.samples, readings_of(box.receiver), box.receiver.space
        tick = box.receiver.pointer.tick
        assert rows(s.drive, *s.u.T, *s.y.T, s.steps, s.gap) == plain.samples
        got = rows(r.drive, r.t_ns, r.speed, r.torque, r.angle)[: tick.motions]
        same_values(got, plain.readings)
        restarted = box.receiver.drives["restart"].tolist()
        assert restarted == [k in plain.restart for k in range(len(NODES))]
        spec = [box.channels[c].spec.name for c in space["channel"]]
        assert [
            spec[row] for row in space["temperature_rows"][: tick.temperatures]
        ] == plain.temperatures
    for record, one in zip(box.receiver.channels, plain.channels.values(), strict=True):
        guard = record["guard"]
        assert (
            record["received_ns"], record["accepted_ns"], record["good_ns"],
            record["reject_reason"], record["protection_reason"], record["reason"],
            bool(record["was_valid"]), record["e2e_state"], guard["counter_ns"], guard["error_ns"],
            guard["rejected_until_ns"], guard["errors"], guard["repeats"],
        ) == (
            one.received, one.accepted, one.good, one.rejected, one.fault, one.reason,
            one.was_valid, one.e2e[0], one.counter_ns, one.error_ns, one.until, one.errors,
            one.repeats,
        )  # fmt: skip
    for record, drive in zip(box.receiver.drives, plain.drives, strict=True):
        assert record["sample_ns"] == drive.sample_ns
        clock = record["clock"]
        if drive.clock is not None:
            assert (clock["late_ns"], clock["usual_ns"]) == (drive.clock.late, drive.clock.usual)
            assert complex(*clock["u"]) == drive.clock.u
        same_values(
            [record[name].item() for name in ("current_sum", "speed", "command", "previous_command",
             "irms", "command_ns", "command_steady", "operating", "emergency_ns")],
            [drive.current_sum, drive.speed, drive.command, drive.before, drive.irms,
             drive.command_ns, drive.steady, drive.operating, drive.emergency_ns],
        )  # fmt: skip
    for record, node in zip(
        box.supervision.heartbeats, plain.supervision.nodes.values(), strict=True
    ):
        assert (
            record["last_ns"], record["since_ns"], record["gaps"], record["limit_ns"],
            record["boots"], record["state"], record["asked"],
        ) == (
            node.last_ns, node.since_ns, node.seen, node.limit_ns, node.boots, node.state,
            node.asked,
        )  # fmt: skip


def counted(box):
    """Without what supervision adds to the emergencies."""
    left_out = ("received", "canopen", "unknown_id")
    return {name: n for name, n in box.counts.items() if n and name not in left_out}


def feed(box, plain, frames, now):
    box.take(frames, now)
    plain.take(frames, now)
    assert_same(box, plain)


@pytest.mark.parametrize(("path", "wrong"), [
    *((CLASSIC, wrong) for wrong in (0.0, 0.02, 0.1, 0.4)), (FD_FILE, 0.02), (FD_FILE, 0.4),
    *(pytest.param(FD_FILE, wrong, marks=pytest.mark.thorough) for wrong in (0.0, 0.1)),
])  # fmt: skip
def test_every_tick_of_a_bus_in_any_weather(path, wrong):
    codec = codec_for(NODES, path)
    seen = set()
    for seed in range(4):
        box, plain = both(codec)
        bus = Bus(codec, (seed, round(100 * wrong)), wrong)
        for tick in range(1, 160):
            now = tick * TICK
            frames = [] if 60 < tick < 90 and seed % 2 else bus.frames(now)
            kept = list(frames)
            if seed == 3:
                bus.rng.shuffle(frames)
                frames = [f for f in frames if f.t_ns >= 0]
                kept = sorted(frames, key=lambda f: (f.t_ns, f.can_id))
            box.take(frames, now)
            if kept:
                plain.take(kept, now)
            else:
                plain.time_out(now)
            assert_same(box, plain, came=bool(kept))
            assert any_lost(box.supervision, now) == plain.supervision.any_lost(now)
        assert counted(box) == {
            n: k for n, k in plain.counts.items() if k and n not in ("canopen", "unknown_id")
        }
        assert box.supervision.malformed >= plain.supervision.malformed
        assert box.counts["received"] == sum(box.counts.values()) - box.counts["received"] - sum(
            box.counts[name] for name in ("lost", "unpaired", "late", "left_out")
        )
        seen |= {name for name, n in box.counts.items() if n}
    if wrong == 0.4:
        expected = {tally.name.lower() for tally in Tally}
        more = {"late"} if path == FD_FILE else {"unpaired"}
        assert seen >= expected | more | {"received"}


def test_a_copy_goes_on_by_itself():
    codec = codec_for(NODES)
    box, plain = both(codec)
    bus = Bus(codec, 1, 0.05)
    for tick in range(1, 30):
        feed(box, plain, bus.frames(tick * TICK), tick * TICK)
    twin = copy.deepcopy(box, {id(codec): codec})
    before = box.receiver.channels.copy()
    frames = bus.frames(30 * TICK)
    twin.take(frames, 30 * TICK)
    assert (box.receiver.channels == before).all()
    plain.take(frames, 30 * TICK)
    assert_same(twin, plain)
    assert twin.supervision.pointer != box.supervision.pointer


def test_more_frames_than_there_is_room_for():
    codec = codec_for(NODES)
    box, plain = both(codec)
    sender = Sender(codec, "Drive1_Motion")
    frames = [sender.frame(k, Speed=k, Torque=1.0, ElectricalAngle=10.0) for k in range(1, 300)]
    feed(box, plain, frames, TICK)
    assert box.receiver.rows >= 299


def test_counters_of_the_longest_turns():
    """A sample from before the last, by up to many turns, is late; a long gap restarts."""
    codec = codec_for(NODES, FD_FILE)
    for first in (0, 5 * MS, 60 * SECOND):
        for step in (-60 * SECOND, -SECOND, -2 * MS, 0, MS, 3 * MS, 199 * MS, 200 * MS, 201 * MS):
            for index in (0, 8, 8 * 8191, 16):
                box, plain = both(codec)
                sender = Sender(codec, "Drive2_Samples")
                now = 200 * SECOND
                for t, at in ((first, 8), (first + step, index)):
                    frame = sender.frame(max(t, 0), SampleIndex=at, **dict.fromkeys(
                        USED["Samples"][1:], 1.0,
                    ))  # fmt: skip
                    feed(box, plain, [frame], now)


def test_every_identifier_is_looked_up():
    codec = bind(CLASSIC, NODES)
    box, plain = both(codec)
    pointer = box.receiver.pointer
    known = {c.spec.key: k for k, c in enumerate(box.channels)}
    for can_id in range(0x1000):
        for flags in (0, EXTENDED):
            key = can_id | (1 << 31 if flags else 0)
            wanted = known.get(key, lib.ID_UNKNOWN)
            if key in plain.own:
                wanted = lib.ID_OWN
            elif key - 0x700 in NODES or key - 0x80 in NODES:
                wanted = lib.ID_SUPERVISED
            assert lib.lookup_id(pointer, can_id, flags) == wanted
    assert lib.lookup_id(pointer, 0xFFFFFFFF, 0) == lib.ID_UNKNOWN


def mapped() -> Codec:
    """Of other makers: no protection, no quality, no angle, a state that is not always there; and
    identifiers of 29 bits."""

    def changed(spec):
        if not spec.node:
            return replace(spec, is_extended=spec.name == "Gateway_Info")
        signals = tuple(
            replace(s, mux_parent="Quality", mux_ranges=((1, 1),)) if s.name == "State" else s
            for s in spec.signals
            if s.name != "ElectricalAngle"
        )
        if spec.node == 2:
            signals = tuple(s for s in signals if s.name not in ("Quality", "State"))
            spec = replace(spec, profile=Profile.NONE, data_ids=b"")
        return replace(spec, signals=signals, is_extended=spec.node == 3)

    return Codec(CLASSIC, [changed(spec) for spec in codec_for(NODES).messages])


def test_identifiers_of_29_bits_are_found():
    codec = mapped()
    box, _ = both(codec)
    for k, channel in enumerate(box.channels):
        spec = channel.spec
        flags = EXTENDED if spec.is_extended else 0
        assert lib.lookup_id(box.receiver.pointer, spec.can_id, flags) == k
        assert lib.lookup_id(box.receiver.pointer, spec.can_id, flags ^ EXTENDED) < 0
    assert any(channel.spec.is_extended for channel in box.channels)
    info = codec.by_name["Gateway_Info"].can_id
    assert lib.lookup_id(box.receiver.pointer, info, EXTENDED) == lib.ID_OWN
    last = int(max(key for key, _ in box.receiver.ids.tolist())) & ~(1 << 31)
    box.receiver.pointer.id_count -= 1
    assert lib.lookup_id(box.receiver.pointer, last, EXTENDED) == lib.ID_UNKNOWN, "no more a row"


def test_each_temperature_by_itself_is_a_sign_of_life_and_quality_may_be_any_column():
    codec = codec_for(NODES)
    for alone in SIGNALS["Temperatures"]:
        box, plain = both(codec)
        values = {name: 50.0 if name == alone else math.nan for name in SIGNALS["Temperatures"]}
        feed(box, plain, [Sender(codec, "Drive1_Temperatures").frame(MS, **values)], TICK)
    for kind in ("Temperatures", "Motion"):
        box, _ = both(codec)
        box.receiver.channels["quality"] = 0  # a checksum that is neither valid nor degraded
        values = dict.fromkeys(SIGNALS[kind], 1.0)
        box.take([Sender(codec, f"Drive1_{kind}").frame(MS, **values)], TICK)
        assert box.receiver.channels["accepted_ns"].max() == MS
        assert box.receiver.channels["good_ns"].max() < 0


@pytest.mark.parametrize("wrong", [0.0, 0.1, 0.4])
def test_inverters_of_other_makers(wrong):
    codec = mapped()
    long = {spec.can_id for spec in codec.messages if spec.is_extended and not spec.is_gateway}
    box, plain = both(codec)
    bus = Bus(codec, 7, wrong)
    operating, second = set(), {c.spec.can_id for c in box.channels if c.drive == 1}
    for tick in range(1, 200):
        frames = [] if 60 < tick < 100 else bus.frames(tick * TICK)
        frames = [f._replace(flags=f.flags | EXTENDED) if f.can_id in long else f for f in frames]
        if 110 < tick < 130:  # one drive without protection sends what is too short
            frames = [f._replace(data=f.data[1:]) if f.can_id in second else f for f in frames]
        box.take(frames, tick * TICK)
        (plain.take if frames else lambda _, now: plain.time_out(now))(frames, tick * TICK)
        assert_same(box, plain, came=bool(frames))
        operating |= set(map(bool, box.receiver.drives["operating"]))
    assert operating == {False, True}


def test_halves_that_come_in_another_order():
    """The newer half first; a half of an earlier turn of the counter; a sample before the last."""
    codec, late = codec_for(NODES), 0
    for apart, later in ((5, 0), (15, 0), (17, 0), (50, 0), (5, 60_000), (5, 20)):
        for first in ("PhaseCurrents", "StatorVoltages"):
            box, plain = both(codec)
            second = "StatorVoltages" if first == "PhaseCurrents" else "PhaseCurrents"
            senders = {kind: Sender(codec, f"Drive1_{kind}") for kind in (first, second)}
            for kind in (first, second):
                for t in (MS, 3 * MS, 5 * MS):  # until the receiver is valid
                    feed(box, plain, [senders[kind].frame(t, **steady(kind))], 10 * MS)
            box.receiver.drives["sample_ns"][0] += later * MS
            plain.drives[0].sample_ns += later * MS
            for kind, t, now in (
                (first, 100, 100), (second, 100 - apart, 110), (first, 104, 110),
                (second, 104, 110),
            ):  # fmt: skip
                feed(box, plain, [senders[kind].frame(t * MS, **steady(kind))], now * MS)
            assert box.counts["late"] == plain.counts["late"]
            late += box.counts["late"]
    assert late


def steady(kind):
    more = {"Udc": 500.0} if kind == "StatorVoltages" else {}
    return {**dict.fromkeys(SIGNALS[kind], 1.0), **more}


def test_a_block_that_is_turns_of_its_counter_late():
    codec, met = codec_for(NODES, FD_FILE), set()
    edges = (0, 4 * MS), (SECOND, MS - MAX_GAP_NS), (SECOND, MS - MAX_GAP_NS - 1), (0, -4 * MS)
    for start, ahead in (*((0, k * MS) for k in (0, 1, 20, 16_383, 16_385, 60_000)), *edges):
        box, plain = both(codec)
        sender = Sender(codec, "Drive1_Samples")
        values = {s.name: 1.0 for s in sender.spec.signals if s.name[0] in "IUQ"}
        for k in range(4):
            frame = sender.frame(start + (k + 1) * MS, SampleIndex=8 * k, **values)
            feed(box, plain, [frame], start + 10 * MS)
        box.receiver.drives["sample_ns"][0] += ahead
        plain.drives[0].sample_ns += ahead
        box.receiver.space["sample_u"][8:] = 77.0
        frame = sender.frame(start + 5 * MS, SampleIndex=32, **values)
        feed(box, plain, [frame], start + 10 * MS)
        met.add((len(plain.samples), bool(plain.restart)))
        assert (box.receiver.space["sample_u"][8:] == 77.0).all(), "no more than there are"
    assert met == {(8, False), (8, True), (0, False)}


def test_the_index_of_a_block_is_a_number_of_its_eighth():
    box, _ = both(codec_for(NODES, FD_FILE))
    c = next(k for k, one in enumerate(box.channels) if one.kind == "Samples")
    box.receiver.space["channel"][0], column = c, box.channels[c].picked[0]
    for index in (math.nan, -1.0, -8.0, 65536.0, 1e300, math.inf, 3.0, 65535.0, 0.0, 8.0, 65528.0):
        box.receiver.space["value"][0, column] = index
        box.receiver.tick["samples"] = 0
        good = index in (0.0, 8.0, 65528.0)
        assert lib.pair_samples(box.receiver.pointer, 0) == good
        if not good:
            assert box.receiver.tick["samples"] == 0


def test_frames_in_another_order_are_left_alone():
    codec = codec_for(NODES)
    senders = [Sender(codec, f"Drive{n}_Motion") for n in (1, 2)]
    one, two = (sender.frame(MS, Speed=1.0, Torque=1.0) for sender in senders)
    for wrong, right in (([two, one], [one, two]), ([one._replace(t_ns=2 * MS), two], None)):
        box, plain = both(codec)
        before = box.receiver.channels.copy()
        rows = block_of(wrong)
        assert not lib.receive_frames(box.receiver.pointer, rows.columns(), 0, rows.size, TICK)
        assert (box.receiver.channels == before).all()
        box.take(wrong, TICK)
        plain.take(right or wrong[::-1], TICK)
        assert_same(box, plain)


def test_frames_before_the_first_one_have_no_say_in_their_order():
    box, _ = both(codec_for(NODES))
    rows = block_of([Frame(0, 9, b""), *(Frame(1, can_id, b"") for can_id in (1, 2, 3))])
    assert lib.receive_frames(box.receiver.pointer, rows.columns(), 1, 3, TICK)


def test_an_emergency_is_left_to_python():
    codec = codec_for(NODES)
    box, _ = both(codec)
    motion = Sender(codec, "Drive1_Motion").frame(2, Speed=1.0, Torque=1.0, ElectricalAngle=1.0)
    emergency = Frame(1, 0x081, b"\x10\x23" + bytes(6))
    box.take([emergency, motion], TICK)
    assert box.receiver.pointer.tick.emergencies == 1
    assert {n: k for n, k in box.counts.items() if k} == {"received": 2, "canopen": 1, "decoded": 1}
    assert box.supervision.emcy[1].received == 1


def test_the_first_emergency_of_a_second_that_reports_an_error_is_noted():
    box, plain = both(codec_for(NODES))
    error, high, low = b"\x10\x23" + bytes(6), b"\0\x10" + bytes(6), b"\x10" + bytes(7)
    given = [
        (2, bytes(8), 0), (4, error[:7], 0), (6, error, FD), (8, high, 0), (500, error, 0),
        (1007, error, 0), (1008, low, 0), (1900, error, 0), (2008, error, 0), (2009, error, 0),
    ]  # fmt: skip
    noted = []
    for at_ms, data, flags in given:
        frames = [Frame(at_ms * MS, 0x082, data, flags)]
        box.take(frames, at_ms * MS)
        plain.take(frames, at_ms * MS)
        assert_same(box, plain)
        noted.append(int(box.receiver.drives["emergency_ns"][1]) // MS)
    assert noted == [-1, -1, -1, 8, 8, 8, 1008, 1008, 2008, 2008]
    assert box.receiver.drives["emergency_ns"][[0, 2]].tolist() == [-1, -1]


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({}, Reason.STARTING),
        ({"received_ns": 5}, Reason.STALE),
        ({"received_ns": 10, "accepted_ns": 10, "guard": 11}, Reason.SEQUENCE),
        ({"received_ns": 10, "accepted_ns": 10, "guard": 10}, Reason.NONE),
        ({"received_ns": 10}, Reason.STALE),
        ({"received_ns": 10, "accepted_ns": 5}, Reason.STALE),
        ({"received_ns": 10, "reject_reason": 5}, Reason.RANGE),
        ({"received_ns": 6, "accepted_ns": 6, "reject_reason": 3}, Reason.NONE),
        ({"received_ns": 6, "accepted_ns": 6, "reject_reason": 6}, Reason.NOT_AVAILABLE),
        ({"received_ns": 6, "accepted_ns": 6, "protection": 1, "state": 2}, Reason.NONE),
        ({"received_ns": 6, "accepted_ns": 6, "protection": 1, "state": 3}, Reason.STALE),
        ({"received_ns": 6, "accepted_ns": 6, "protection": 1, "state": 1}, Reason.STARTING),
        ({"received_ns": 6, "accepted_ns": 6, "protection": 1, "state": 1,
          "protection_reason": 4}, Reason.SEQUENCE),
    ],
)  # fmt: skip
def test_why_a_channel_is_unknown(fields, reason):
    """At 10 ns, with an age limit of 4 ns."""
    box, _ = both(codec_for(NODES))
    record, fields = box.receiver.channels[0], dict(fields)
    record["limit_ns"] = 4
    record["e2e_config"]["profile"] = fields.pop("protection", 0)
    record["e2e_state"]["state"] = fields.pop("state", 0)
    record["guard"]["rejected_until_ns"] = fields.pop("guard", -1)
    for name, value in fields.items():
        record[name] = value
    lib.check_timeouts(box.receiver.pointer, 10)
    assert record["reason"] == reason


def test_signs_of_a_second_sender_at_the_end_of_time():
    guard = sequence_guards([10 * MS])
    pointer = ffi.from_buffer("struct sequence_guard *", guard)
    last = (1 << 63) - 1
    for k in range(6):
        lib.guard_sequence(pointer, last - 10 + k, 16, 1)
    assert guard["rejected_until_ns"] == last
    assert guard["errors"] == 3
    assert guard.dtype == SEQUENCE_GUARD
    assert guard["shortest_step_ns"] == SHORTEST_STEP * 10 * MS


def test_a_step_in_its_shortest_time_is_no_sign_and_signs_a_second_apart_are_of_one_run():
    def signs(*steps):
        """Errors after frames at these times (ns), 16 counter steps ahead each."""
        guard = sequence_guards([10 * MS])
        guard["shortest_step_ns"] = 1.0
        for t in steps:
            lib.guard_sequence(ffi.from_buffer("struct sequence_guard *", guard), t, 16, 0)
        return guard["errors"].item(), guard["rejected_until_ns"].item()

    assert signs(100 * MS)[0] == 0
    assert signs(100 * MS, 100 * MS + 16)[0] == 0
    assert signs(100 * MS, 100 * MS + 15)[0] == 1
    first = 100 * MS + 15
    late = first + SECOND - 15
    assert signs(100 * MS, first, late, late + 15)[0] == 2, "a second after the one before"
    assert signs(100 * MS, first, late + 1, late + 16)[0] == 1
    assert signs(100 * MS, first, first + 15, first + 30) == (3, first + 30 + SECOND)


@pytest.mark.parametrize("period_ns", [0, 40 * MS])
def test_heartbeats_equal_the_reference(period_ns):
    """Any bytes at any time, node guarding and boot-ups among them."""
    seen = set()
    for seed in range(60):
        rng = np.random.default_rng(seed)
        ours = Supervision(NODES, TIMEOUT, period_ns)
        plain = reference.Supervision(NODES, TIMEOUT, period_ns)
        t = 0
        often = rng.choice([0.9, 0.99])
        for _ in range(300):
            t += int(rng.choice([MS, 9 * MS, 10 * MS, 50 * MS, 51 * MS, 66 * SECOND, -MS, 0]))
            node = int(rng.choice(NODES))
            byte = (
                5
                if rng.random() < often
                else int(rng.choice([0, 4, 5, 127, 128, 133, 132, 255, 7]))
            )
            length = 1 if rng.random() < 0.97 else int(rng.integers(9))
            plainly = bool(rng.random() < 0.98)
            if rng.random() < 0.02:
                can_id = int(rng.choice([0x700 + node, 0x700, 0x780, 0x6FF, 0x77F, 0x7FF]))
                lib.on_node_guard(ours.pointer, can_id)
                if can_id == 0x700 + node:
                    plain.nodes[node].asked = True
            lib.on_heartbeat(ours.pointer, NODES.index(node), t, length, plainly, byte)
            plain.heartbeat(node, t, length, plainly, byte)
            for record, other in zip(ours.heartbeats, plain.nodes.values(), strict=True):
                assert (
                    record["last_ns"], record["since_ns"], record["gaps"], record["limit_ns"],
                    record["boots"], record["state"], record["asked"],
                ) == (
                    other.last_ns, other.since_ns, other.seen, other.limit_ns, other.boots,
                    other.state, other.asked,
                )  # fmt: skip
                seen.add(int(np.sign(record["gaps"])) + 10 * (record["limit_ns"] > 0))
            for later in (0, 1, 150 * MS, TIMEOUT, TIMEOUT + 1, 10 * SECOND):
                lost = plain.any_lost(t + later)
                assert any_lost(ours, t + later) == lost
        assert ours.malformed == plain.malformed
    assert seen == {-1, 0, 11}


@pytest.mark.parametrize(("period_ns", "gap_ns"), [
    (0, 65_536 * MS), (0, 65_536 * MS + 1), (1, SECOND),
])  # fmt: skip
def test_the_longest_gap_is_one_and_a_configured_period_of_any_length_counts(period_ns, gap_ns):
    ours, plain = (make(NODES, TIMEOUT, period_ns) for make in (Supervision, reference.Supervision))
    for t in (MS, MS + gap_ns, MS + 2 * gap_ns):
        lib.on_heartbeat(ours.pointer, 0, t, 1, 1, 5)
        plain.heartbeat(1, t, 1, True, 5)
    node = plain.nodes[1]
    assert (ours.heartbeats[0]["gaps"], ours.heartbeats[0]["limit_ns"]) == (
        node.seen,
        node.limit_ns,
    )


@pytest.mark.parametrize("gaps", [-2, -7, -(1 << 40), -(1 << 63), 3, 1 << 62])
def test_any_count_of_heartbeats_is_a_place_in_their_ring(gaps):
    """Also one that only a damaged record holds: a gap is written nowhere else."""
    ours = Supervision(NODES, TIMEOUT, 0)
    one = ours.heartbeats[0]
    for t in (MS, 101 * MS):
        lib.on_heartbeat(ours.pointer, 0, t, 1, 1, 5)
    one["gap_ns"], one["gaps"] = 7, gaps
    before, others = one.copy(), ours.heartbeats[1:].tobytes()
    lib.on_heartbeat(ours.pointer, 0, 301 * MS, 1, 1, 5)
    assert sorted(one["gap_ns"]) == [7, 7, 7, 7, 200 * MS]
    assert one["gaps"] == gaps + 1
    for name in ("boots", "state", "asked"):
        assert one[name] == before[name]
    assert ours.heartbeats[1:].tobytes() == others


def test_numbers_are_the_headers():
    for name, number in (("NONE", 0), ("STARTING", 1), ("STALE", 2), ("CORRUPTED", 3),
                         ("SEQUENCE", 4), ("RANGE", 5), ("NOT_AVAILABLE", 6)):  # fmt: skip
        assert Reason[name] == getattr(lib, f"REASON_{name}") == number
    assert len(Tally) == lib.RX_COUNTERS
    for number, kind in enumerate(
        ("CURRENTS", "VOLTAGES", "BLOCK", "MOTION", "TEMPERATURES", "STATUS")
    ):
        assert getattr(lib, f"KIND_{kind}") == number
    assert max(len(names) for names in USED.values()) == lib.MAX_USED_COLUMNS
