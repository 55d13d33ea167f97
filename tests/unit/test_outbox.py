"""What goes out is what is known, signal by signal; the schedule; and the load of the bus."""

import math

import numpy as np
import pytest
from _traction_core import lib

from dbc.frame import EXTENDED, FD, SECOND, Frame
from dbc.frames import block_of
from dbc.records import BUS_LOAD, TX_FRAME, pointer
from gateway.core.busload import BusLoad
from gateway.core.codes import NEVER, REJECTED
from gateway.core.flags import FlagKind, unknown_status
from gateway.core.receiving import Tally
from gateway.core.supervision import Supervision
from gateway.core.transmit import Outbox
from gateway.core.view import Wear, drives_of, view_of
from tests.sender import CLASSIC, FD_FILE, MS, codec_for
from tests.stations import Inbox, IntegrityMonitor

NODES = (2, 1, 3)
N = len(NODES)
TICK = 10 * MS
RPM = 60.0 / (2.0 * math.pi)
COUNTED = {
    "deadline_misses": 3, "rejected": 5000, "lost": 7, "bus_load_percent": 41.0,
    "latency_p99_us": 120.0, "lateness_p99_us": None,
}  # fmt: skip


def drawn(rng):
    """Any words and numbers that there can be."""
    status = unknown_status(N, 4)
    drives, train = status
    drives["flag"]["state"] = rng.integers(0, 3, (N, len(FlagKind)))
    drives["health"], drives["fault_sensor"] = rng.integers(0, 6, (2, N))
    drives["fault_class"], drives["jumps"] = rng.integers(0, 9, N), rng.integers(0, 40, N)
    for name, most in (("speed_rad_s", 1500.0), ("load_nm", 3000.0), ("loss_probability", 1.0),
                       ("nis", 40.0), ("mixed_c", 250.0), ("maisd_k", 40.0),
                       ("rate_k_h", 3.0)):  # fmt: skip
        drives[name] = np.where(rng.random(N) < 0.3, np.nan, rng.uniform(0.0, most, N))
    train["adhesion_reason"], train["faults_reason"] = rng.integers(0, 12, 2)
    for name in ("sensor", "comm", "estimator", "overrun"):
        train[name] = rng.integers(0, 3)
    train["state"], train["common_mode"] = 3, 2
    for name in ("age_ns", "temperature_age_ns"):
        train[name] = rng.choice([NEVER, rng.integers(0, 10**9), rng.integers(0, 4 * 10**9)])
    return status


def expected(words, config_hash):
    """Every signal's value by message, from the view of the same words; None: not known."""
    view = view_of(0, words, drives_of(words, NODES, [Wear()] * N), None, **COUNTED)
    ages = [None if a == NEVER else a // MS for a in (
        words.train["age_ns"].item(), words.train["temperature_age_ns"].item(),
    )]  # fmt: skip
    out = {
        "Gateway_Adhesion": {
            "Reason": view.adhesion_reason, "Detector": view.detector,
            "CommonMode": view.common_mode, "Age": None if ages[0] is None else min(ages[0], 254),
            **{f"Adhesion{d.node}": d.adhesion for d in view.drives},
        },
        "Gateway_Faults": {
            "Reason": view.faults_reason, "SensorFault": view.sensor, "CommFault": view.comm,
            "EstimatorFault": view.estimator, "Overrun": view.overrun,
            "Age": None if ages[1] is None else min(ages[1] // 10 * 10, 2540),
            **{f"Thermal{d.node}": d.thermal for d in view.drives},
        },
        "Gateway_Info": {"ConfigHash": config_hash, "LatencyP99": 120.0, "LatenessP99": None},
        "Gateway_Status": {"State": view.state, "DeadlineMisses": 3, "RejectedFrames": 4094,
                           "LostFrames": 7, "BusLoad": 41.0},
    }  # fmt: skip
    for k, d in enumerate(view.drives):
        rate, jumps = (words.drives[name].item(k) for name in ("rate_k_h", "jumps"))
        lost = d.loss_probability
        out[f"Drive{d.node}_Estimate"] = {
            "Health": d.health, "Speed": None if d.speed_rad_s is None else RPM * d.speed_rad_s,
            "LoadTorque": d.load_nm, "LossProbability": None if lost is None else 100.0 * lost,
            "Nis": None if d.nis is None else min(d.nis, 25.4),
        }  # fmt: skip
        out[f"Drive{d.node}_Thermal"] = {
            "FaultClass": d.fault_class, "FaultSensor": d.fault_sensor, "Tmixed": d.mixed_c,
            "Maisd": d.maisd_k, "Jumps": None if math.isnan(rate) else min(jumps, 14),
            "DegradationRate": None if math.isnan(rate) else rate,
        }  # fmt: skip
    return out


@pytest.mark.parametrize("file", [CLASSIC, FD_FILE])
def test_every_signal_says_what_is_said(file):
    codec, rng = codec_for(NODES, file), np.random.default_rng(2)
    for _ in range(100):
        box, words = Outbox(codec, NODES, 0xABCDEF, TICK), drawn(rng)
        for name, count in COUNTED.items():
            box.record["counts"][name] = math.nan if count is None else count
        frames = box.due(words, 0)
        wanted = expected(words, 0xABCDEF)
        assert [f.can_id for f in frames] == sorted(f.can_id for f in frames)
        assert {codec.by_id[f.can_id].name for f in frames} == set(wanted)
        for frame in frames:
            spec = codec.by_id[frame.can_id]
            values = {
                name: reading.value if reading.validity == 0 else None
                for name, reading in codec.decode(spec, frame.data).items()
            }
            for name, value in wanted[spec.name].items():
                step = spec.signals[spec.column(name)].scale
                told = values.pop(name)
                assert (told is None) == (value is None), (spec.name, name)
                assert told is None or abs(told - value) <= 0.501 * abs(step), (spec.name, name)
            rest = {name for name in values if name not in ("Crc", "Counter")}
            assert all(values[name] in (0, None) for name in rest), "of drives that there are not"


def names(codec, frames):
    return [codec.by_id[f.can_id].name for f in frames]


def test_each_goes_out_in_its_cycle_and_faults_at_a_change_too():
    codec = codec_for(NODES)
    box, words = Outbox(codec, NODES, 0, TICK), unknown_status(N, 1)
    sent, summaries = {}, {163: "comm", 165: "sensor", 167: "estimator", 169: "overrun"}
    for tick in range(300):
        if tick == 155:
            words.drives["flag"]["state"][1, FlagKind.THERMAL] = 2
        if tick in summaries:
            words.train[summaries[tick]] = 2
        for name in names(codec, box.due(words, tick * TICK)):
            sent.setdefault(name, []).append(tick)
    assert sent["Gateway_Adhesion"] == list(range(300))
    assert sent["Drive1_Estimate"] == list(range(0, 300, 2))
    assert sent["Gateway_Info"] == [0, 100, 200]
    assert sent["Gateway_Status"] == list(range(0, 300, 10))
    assert sent["Gateway_Faults"] == [
        *range(0, 151, 10), 155, *summaries, *range(179, 300, 10),
    ]  # fmt: skip


def test_a_drive_that_there_is_not_changes_nothing_and_is_not_written_to():
    codec = codec_for(NODES)
    box, words = Outbox(codec, NODES, 0, TICK), unknown_status(N, 1)
    box.record["drive_count"], box._thermal_sent[-1] = N - 1, 7
    box.due(words, 0)
    words.drives["flag"]["state"][-1, FlagKind.THERMAL] = 2
    assert "Gateway_Faults" not in names(codec, box.due(words, TICK))
    assert box._thermal_sent[-1] == 7


def test_what_is_due_within_half_a_tick_goes_out_and_the_loops_own_cycle_with_every_tick():
    codec = codec_for(NODES)
    for now, due in ((95 * MS, True), (95 * MS - 1, False)):
        box, words = Outbox(codec, NODES, 0, TICK), unknown_status(N, 1)
        box.due(words, 0)
        assert "Gateway_Adhesion" in names(codec, box.due(words, 1 * MS))
        assert ("Gateway_Status" in names(codec, box.due(words, now))) == due


def test_the_grid_stays_however_late_a_tick_is():
    codec = codec_for(NODES)
    box, words = Outbox(codec, NODES, 0, TICK), unknown_status(N, 1)
    ticks = (0, 1, 9, 10, 31, 39, 47, 52)
    sent = [t for t in ticks if "Gateway_Status" in names(codec, box.due(words, t * TICK + t % 3))]
    assert sent == [0, 10, 31, 47, 52]


def test_a_cycle_shorter_than_the_loop_goes_out_with_every_tick():
    codec = codec_for(NODES)
    box, words = Outbox(codec, NODES, 0, 15 * MS), unknown_status(N, 1)
    for tick in range(40):
        sent = names(codec, box.due(words, tick * 15 * MS))
        assert "Gateway_Adhesion" in sent, "10 ms"
        assert ("Drive1_Estimate" in sent) == (tick % 4 != 2), "20 ms, within half a tick"


def test_after_a_restart_everything_is_due_once_more():
    codec = codec_for(NODES)
    box, words = Outbox(codec, NODES, 0, TICK), unknown_status(N, 1)
    first = names(codec, box.due(words, 0))
    assert len(first) == 4 + 2 * N
    assert len(box.due(words, TICK)) < len(first)
    box.restart(2 * TICK)
    assert names(codec, box.due(words, 2 * TICK)) == first


@pytest.mark.parametrize(("age", "told"), [
    (0, (0, 0)), (-1, (-1, -10)), (-1_000_000, (-1, -10)), (254 * MS, (254, 250)),
    (255 * MS - 1, (254, 250)), (255 * MS, (254, 250)), (2539 * MS, (254, 2530)),
    (2540 * MS, (254, 2540)), ((1 << 63) - 1, (254, 2540)), (NEVER, (None, None)),
])  # fmt: skip
def test_ages_are_whole_steps_of_their_signal_and_no_more_than_fits(age, told):
    """Of a stamp from the future, which no receiver accepts: rounded down, and sent as 0."""
    codec, words = codec_for(NODES), unknown_status(N, 1)
    words.train["age_ns"] = words.train["temperature_age_ns"] = age
    frames = {codec.by_id[f.can_id].name: f for f in Outbox(codec, NODES, 0, TICK).due(words, 0)}
    for name, value in zip(("Gateway_Adhesion", "Gateway_Faults"), told, strict=True):
        spec = codec.by_name[name]
        reading = codec.decode(spec, frames[name].data)["Age"]
        got = reading.value if reading.validity == 0 else None
        assert got == (value if value is None else max(value, 0))


def test_a_number_of_a_source_that_there_is_not_goes_out_as_not_available():
    codec, words = codec_for(NODES), unknown_status(N, 1)
    for wrong in (lib.TX_CONFIG_HASH + 1, 255):
        box = Outbox(codec, NODES, 0, TICK)
        row = list(box.specs).index("Drive1_Estimate")
        box.signals[row, codec.by_name["Drive1_Estimate"].column("Speed")] = wrong, 0
        frame = next(f for f in box.due(words, 0) if f.can_id == box.heads[row][0])
        assert codec.decode(box.specs["Drive1_Estimate"], frame.data)["Speed"].validity == 1


def test_damaged_status_costs_no_more_than_a_wrong_frame():
    """Every value that memory could hold; each message keeps its cycle of at least 1 ns."""
    codec, rng = codec_for(NODES), np.random.default_rng(3)
    box, words = Outbox(codec, NODES, 0, TICK), unknown_status(N, 1)
    box.due(words, 0)
    for _ in range(300):
        for table in words:
            table.view(np.uint8)[:] = rng.integers(0, 256, table.nbytes, dtype=np.uint8)
        now = int(rng.integers(-(1 << 63), (1 << 63) - 1))
        box.messages["next_ns"] = rng.integers(-(1 << 63), (1 << 63) - 1, len(box.messages))
        with np.errstate(over="ignore"):
            assert len(box.due(words, now)) <= len(box.messages)


def test_counts_are_those_taken_over_and_those_in_the_receiver():
    codec = codec_for(NODES)
    box, load = Outbox(codec, NODES, 7, TICK), BusLoad(500_000, 2_000_000, 0)
    inbox = Inbox(codec, NODES, TICK, Supervision(NODES, 300 * MS))
    counters, doubt = inbox.receiver.counters, IntegrityMonitor(TICK)
    doubt.note_overrun(3)
    doubt.tick(0, 0)
    box.note_rejected(5)
    counters[:] = 10 ** np.arange(len(Tally)) % 1_000_007
    load.record["percent"] = 17.0
    for now, percent in ((0, 17.0), (2 * SECOND, 17.0), (2 * SECOND + 1, math.nan)):
        lib.update_counts(box.pointer, inbox.receiver.pointer, doubt.pointer, load.pointer, now)
        counts = box.record["counts"][0]
        rejected = sum(int(counters[Tally[name.upper()]]) for name in REJECTED)
        assert counts["rejected"] == 5 + rejected
        assert counts["lost"] == counters[Tally.LOST]
        np.testing.assert_equal(counts["bus_load_percent"], percent)
        assert (counts["deadline_misses"], counts["config_hash"]) == (3, 7)


# ---- load of the bus


def busy(load):
    return float(load.record["busy_s"][0])


@pytest.mark.parametrize("path", [CLASSIC, FD_FILE])
def test_time_on_the_bus_leaves_out_what_the_gateway_has_sent_itself(path):
    codec, rng = codec_for(NODES, path), np.random.default_rng(1)
    inbox = Inbox(codec, NODES, TICK, Supervision(NODES, 300 * MS))
    ids = [spec.can_id for spec in codec.messages] + [0x720, 0x0A0, 0x123, 0x701]
    frames = [
        Frame(TICK, can_id, bytes(rng.choice([0, 3, 8, 64] if flags & FD else [0, 3, 8])), flags)
        for can_id in ids
        for flags in (0, FD, EXTENDED)
    ]
    block = block_of(frames)
    cost = [(1000.0 if f.flags & FD else 0.0) + len(f.data) for f in frames]
    own = {spec.key for spec in codec.own(creep=False)} | {0x720, 0x0A0}
    keys = [f.can_id | (1 << 31 if f.flags & EXTENDED else 0) for f in frames]
    others = sum(c for c, key in zip(cost, keys, strict=True) if key not in own)
    for receiver, wanted in ((None, sum(cost)), (inbox.receiver, others)):
        load = BusLoad(500_000, 2_000_000, 0)
        load.record["classic_s"] = np.arange(256.0)
        load.record["fd_s"] = 1000.0 + np.arange(256.0)
        load.record["busy_s"] = 0.5
        load.add_block(block, receiver, TICK)
        assert busy(load) == 0.5 + wanted


@pytest.mark.parametrize("file", [CLASSIC, FD_FILE])
def test_sent_frames_cost_what_they_would_cost_received(file):
    codec = codec_for(NODES, file)
    box, words = Outbox(codec, NODES, 0, TICK), unknown_status(N, 1)
    frames = box.due(words, 0)
    one, two, three = (BusLoad(500_000, 2_000_000, 0) for _ in range(3))
    one.count(frames)
    two.add_block(block_of(frames), None, 0)
    sent = pointer("struct tx_frame", box.frames)
    lib.bus_load_transmit(three.pointer, box.pointer, len(frames), sent)
    assert busy(one) == busy(two) == busy(three) > 0.0
    assert box.frames.dtype == TX_FRAME
    assert one.record.dtype == BUS_LOAD


def test_a_window_closes_with_the_first_tick_after_a_second():
    load = BusLoad(500_000, 2_000_000, 5 * SECOND)
    none = block_of([])
    assert load.percent(5 * SECOND) is None
    frame = Frame(0, 0x123, bytes(8))
    bits = 47 + 64 + (33 + 64) // 4
    for _ in range(1000):
        load.count([frame])
    load.add_block(none, None, 6 * SECOND - 1)
    assert load.percent(6 * SECOND - 1) is None
    load.add_block(none, None, 6 * SECOND)
    assert load.percent(6 * SECOND) == pytest.approx(100.0 * 1000 * bits / 500_000)
    load.count([frame] * 100)
    load.add_block(none, None, 8 * SECOND)
    assert load.percent(8 * SECOND) == pytest.approx(50.0 * 100 * bits / 500_000)
    assert load.percent(10 * SECOND) is not None
    assert load.percent(10 * SECOND + 1) is None, "long past"
    load.count([frame] * 100_000)
    load.add_block(none, None, 11 * SECOND)
    assert load.percent(11 * SECOND) == 126.0, "the most that the signal can tell"
