"""Several ticks in a call are those ticks one by one: the same frames, the same state."""

from functools import reduce

import numpy as np
import pytest
from _traction_core import lib

from dbc.frame import MS, SECOND, Frame
from dbc.frames import EMPTY, block_of, join
from gateway.core import gateway as core
from gateway.core.gateway import Gateway
from gateway.io.replay import Briefly, replay
from gateway.settings.config import parse
from tests.simrun import FD_FILE
from tests.stations import temperatures_of
from tests.stepped import Stepped
from tests.storm.bus_faults import HostileBus, plan
from tests.storm.campaign import CALIBRATION, NODES
from tests.storm.train import TICK, train
from tests.thorough import some

FIRST = 4
"""Tick of the first step: what is sent goes out between what the drives send slowly."""


def config_of(kind="ekf", detector="vb", dbc="traction.dbc", **thermal):
    return parse({
        "dbc": {"file": dbc},
        "estimator": {"kind": kind},
        "adhesion": {"detector": detector},
        "thermal": {"calibration": str(CALIBRATION), "method": "maisd", **thermal},
    })  # fmt: skip


def stormy(honest, seed, ticks, between):
    """What arrives in each tick, and all of it with the ends of the ticks."""
    ids = [
        [s.can_id for s in honest.codec.messages if s.name.startswith(f"Drive{n}_")
         and not s.is_gateway]
        for n in NODES
    ]  # fmt: skip
    bus = HostileBus(plan(seed, ticks, len(NODES), between), ids, seed)
    blocks = []
    for tick in range(1, ticks + 1):
        other = lambda tick=tick: honest.elsewhere(tick)  # noqa: E731
        blocks.append(bus.carry(honest.sent(tick), other, tick, tick * TICK).block)
    del blocks[: FIRST - 1]
    return blocks, *joined(blocks)


def joined(blocks):
    """All of them as one, and where each ends in it."""
    return reduce(join, blocks, EMPTY), np.cumsum([block.size for block in blocks])


def flags(gateway):
    """All that are told of a drive."""
    return gateway.status.drives["flag"]["state"].tolist()


def singly(gateway, blocks, told=None):
    """told: of every tick, whether a flag changed and what the losses' probabilities were."""
    out, before = [], None
    for k, block in enumerate(blocks):
        out += gateway.step(block, (k + FIRST) * TICK)
        assert gateway.changed == (flags(gateway) != before)
        before = flags(gateway)
        if told is not None:
            told.append((gateway.changed, gateway.status.drives["loss_probability"].copy()))
    return out


def together(gateway, whole, ends, most=200, told=None):
    """Asked for `most` at a time. told: of every call, how many ticks it did and their peak."""
    out, first, done = [], 0, 0
    while done < len(ends):
        wanted = ends[done : done + most]
        part = whole.part(first, int(wanted[-1]))
        ticks, frames = gateway.run(part, wanted - first, (done + FIRST) * TICK)
        out += [frame for block in frames for frame in block.frames()]
        done += ticks
        first = int(ends[done - 1])
        if told is not None:
            told.append((ticks, gateway.peak.copy()))
    return out


def stops(told, most):
    """What `together` tells, from what `singly` does."""
    calls, since = [], 0
    for k, (changed, _) in enumerate(told):
        count = k + 1 - since
        if changed or count == most or k + 1 == len(told):
            peak = np.full(len(NODES), np.nan)
            for _, lost in told[since : k + 1]:
                peak = np.where(np.isnan(lost) | (peak >= lost), peak, lost)
            calls.append((count, peak))
            since = k + 1
    return calls


def state(gateway):
    """Numbers of everything that goes on to the next tick."""
    bank, motion, adhesion, receiver = (
        gateway.bank, gateway.motion, gateway.adhesion, gateway.inbox.receiver,
    )  # fmt: skip
    tables = (
        gateway.flags.inputs, gateway.inputs.status, bank.filters, bank.tracks, bank.chords,
        bank.sensors, bank.estimates, motion.motions, motion.checks, motion.others, motion.noted,
        adhesion.responses, adhesion.ratios, adhesion.response_ratios, adhesion.rotors,
        adhesion.loads, adhesion.record["common_mode"], receiver.channels, receiver.drives,
        receiver.counters, gateway.supervision.heartbeats, gateway.thermal.motors,
        *gateway.thermal.window, *gateway.status, gateway.integrity.record,
        *(gateway.outbox.messages[name] for name in ("next_ns", "counter")),
        *(adhesion.record[name] for name in (
            "response_spread", "spread", "learn_ns", "flagged_ns", "common", "common_smoothed",
            "comparable",
        )),
    )  # fmt: skip
    numbers = [np.asarray(table).tolist() for table in tables]
    thermal = gateway.thermal
    numbers += [thermal.record[name].tolist() for name in ("next_ns", "cycles", "cycle", "dirty")]
    if thermal.model is not None:
        model = thermal.model
        numbers += [model.motors.tolist(), model.record["position"].item(), model.waiting]
    load = gateway.load.record
    one = [repr(load["busy_s"]), repr(load["percent"]), gateway.changed]
    return {
        "arrays": repr(numbers),
        "numbers": one,
        "counts": {name: n for name, n in gateway.inbox.counts.items() if n},
        "readings": repr(temperatures_of(gateway.inbox)),
        "view": repr(gateway.view),
    }


def same(config, honest, seed, ticks, between, most=200):
    blocks, whole, ends = stormy(honest, seed, ticks, between)
    one, many = (Gateway(config, honest.codec, 0) for _ in range(2))
    calls, each = [], []
    assert together(many, whole, ends, most, calls) == singly(one, blocks, each)
    assert state(many) == state(one)
    assert repr(calls) == repr(stops(each, most))
    return one


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
@pytest.mark.parametrize("between", [120.0, 1e9])
def test_storm_and_calm_are_the_same_either_way(kind, between):
    gateway = same(config_of(kind), train(), 4, 3000, between)
    assert gateway.inbox.counts["decoded"] > 50_000


@pytest.mark.parametrize("seed", some([5, 6], [7, 8]))
def test_other_storms_and_few_ticks_at_a_time(seed):
    same(config_of(), train(), seed, 1500, 60.0, most=7)


def test_fd_is_the_same():
    same(config_of(dbc="traction_fd.dbc"), train(FD_FILE), 3, 1500, 120.0)


@pytest.mark.parametrize("detector", ["median", "kmeans", "vmp"])
def test_other_detectors_step_one_by_one(detector):
    gateway = same(config_of(detector=detector), train(), 4, 300, 120.0)
    assert gateway.pointer.stage == lib.STAGE_RECEIVE, "the tick is done"


@pytest.mark.parametrize(("seed", "between"), [(4, 120.0), (11, 60.0), (1, 1e9)])
def test_the_thermal_model_is_the_same_either_way(seed, between):
    gateway = same(config_of(method="model"), train(), seed, 3000, between)
    assert gateway.thermal.model.motors["judged"].all()


def test_without_a_calibration_it_is_the_same():
    gateway = same(config_of(calibration=None), train(), 4, 1000, 120.0)
    assert gateway.thermal.record["cycles"] > 90


@pytest.mark.parametrize("room", [30, 0])
def test_little_room_for_frames_ends_a_call_sooner(monkeypatch, room):
    """There is room for the frames of one tick at least."""
    monkeypatch.setattr(core, "SENT", room)
    same(config_of(), train(), 2, 400, 1e9)


def test_doubt_of_the_driver_is_kept():
    """Lost frames, missed ticks and an intruder: told by single steps, and so they are."""
    blocks, whole, ends = stormy(train(), 1, 900, 1e9)
    one, many = (Gateway(config_of(), train().codec, 0) for _ in range(2))
    for gateway in (one, many):
        gateway.integrity.watching = True
    out, wanted, done = [], [], 0
    for first, last, note in (
        (0, 300, lambda d: d.note_lost(3)),
        (300, 600, lambda d: d.note_overrun(2)),
        (600, len(ends), lambda d: None),
    ):
        while done < last:
            at = int(ends[done - 1]) if done else 0
            part = whole.part(at, int(ends[last - 1]))
            ticks, frames = many.run(part, ends[done:last] - at, (done + FIRST) * TICK)
            out += [frame for block in frames for frame in block.frames()]
            done += ticks
        for k in range(first, last):
            wanted += one.step(blocks[k], (k + FIRST) * TICK)
        note(one.integrity), note(many.integrity)
    assert out == wanted
    assert state(many) == state(one)


@pytest.mark.parametrize("on_intruder", ["unknown", "go_on", "stop"])
def test_an_intruder_and_a_heartbeat_that_stops_are_the_same_either_way(on_intruder):
    honest = train()
    blocks, _, _ = stormy(honest, 1, 900, 1e9)
    own = honest.codec.by_name["Gateway_Adhesion"].can_id
    for k in (500, 501, 640):
        blocks[k] = join(blocks[k], block_of([Frame((k + FIRST) * TICK, own, bytes(8))])).ordered()
    for k in range(300, 900 - FIRST):
        blocks[k] = blocks[k].pick(blocks[k].can_id != 0x700 + NODES[1])
    whole, ends = joined(blocks)
    config = config_of()
    config = config.model_copy(
        update={"bus": config.bus.model_copy(update={"on_intruder": on_intruder})}
    )
    one, many = (Gateway(config, honest.codec, 0) for _ in range(2))
    one.integrity.watching = many.integrity.watching = True
    assert together(many, whole, ends) == singly(one, blocks)
    assert state(many) == state(one)
    assert one.integrity.intruder
    assert one.silent == (on_intruder == "stop")
    assert one.inputs.status["heartbeat_lost"].tolist() == [0, 1, *[0] * (len(NODES) - 2)]


def test_a_replay_that_wants_no_view_says_the_same(tmp_path):
    """With damaged stamps and a hole among the blocks."""
    _, whole, _ = stormy(train(), 9, 1500, 60.0)
    late = whole.part(0, whole.size)
    late = late._replace(t_ns=late.t_ns + 40 * SECOND)
    blocks = [whole.part(0, 5000), whole.part(5000, whole.size), late]

    def run(briefly):
        out, changes = [], []

        def changed(gateway):
            changes.append(repr(gateway.view))

        def sink(_now, frames, gateway):
            out.extend(frames)
            if gateway.changed:
                changed(gateway)

        def write(block):
            out.extend(block.frames())

        done = replay(
            blocks, lambda at: Gateway(config_of(), train().codec, at), 10 * MS,
            Briefly(write, changed) if briefly else sink,
        )  # fmt: skip
        return out, changes, done[:5], state(done.gateway)

    assert run(briefly=True) == run(briefly=False)


def test_frames_out_of_order_are_put_in_order():
    """In one tick of many: that one is done singly."""
    blocks, _, ends = stormy(train(), 1, 300, 1e9)
    turned = [b.pick(np.arange(b.size)[::-1]) if k % 50 == 20 else b for k, b in enumerate(blocks)]
    whole, _ = joined(turned)
    right, wrong = (Gateway(config_of(), train().codec, 0) for _ in range(2))
    assert together(wrong, whole, ends) == singly(right, blocks)
    assert state(wrong) == state(right)


def test_ends_beyond_the_block_are_refused():
    _, whole, ends = stormy(train(), 1, 20, 1e9)
    for bad in (ends + 1, ends[::-1], -ends):
        with pytest.raises(ValueError, match="frames"):
            Gateway(config_of(), train().codec, 0).run(whole, bad, FIRST * TICK)


@pytest.mark.parametrize(("kind", "detector"), [("ekf", "vb"), ("ukf", "vb"), ("ekf", "median")])
def test_a_tick_is_its_stations_in_their_order(kind, detector):
    """As `tests/stepped.py` calls them one by one."""
    blocks, _, _ = stormy(train(), 5, 1000, 60.0)
    config = config_of(kind, detector)
    whole, stepped = (made(config, train().codec, 0) for made in (Gateway, Stepped))
    assert singly(stepped, blocks) == singly(whole, blocks)
    assert state(stepped) == state(whole)


def test_what_stations_have_found_is_evidence_of_the_same_tick():
    gateway = Gateway(config_of(), train().codec, 0)
    gateway.motion.motions["implausible"] = implausible = [1, 0, 0]
    gateway.adhesion.rotors["uncertain"] = uncertain = [0, 1, 0]
    lib.finish_tick(gateway.pointer, TICK)
    evidence = gateway.flags.inputs
    assert evidence["input_implausible"].tolist() == implausible
    assert evidence["may_spin_up"].tolist() == uncertain


def test_a_single_emergency_is_read():
    gateway = Gateway(config_of(), train().codec, 0)
    for k in (1, 2):
        gateway.step([Frame(k, 0x081, b"\x10\x23" + bytes(6))] * (k == 1), k * TICK)
        assert gateway.supervision.emcy[1].received == 1


@pytest.mark.parametrize(
    ("detector", "stamps", "can_id", "answer"),
    [
        ("vb", (1, 2), 0x181, 1), ("vb", (2, 1), 0x181, 0), ("vb", (1, 2), 0x081, 2),
        ("median", (), 0, 2),
    ],
)  # fmt: skip
def test_a_tick_is_not_done_done_or_left_to_python(detector, stamps, can_id, answer):
    """Frames in another order; an emergency, a detector of Python's."""
    gateway = Gateway(config_of(detector=detector), train().codec, 0)
    block = block_of([Frame(t, can_id, bytes(8)) for t in stamps])
    assert lib.run_one(gateway.pointer, block.size, *block.addresses(), TICK) == answer


def test_the_load_of_translated_frames_is_counted_where_they_are_translated():
    blocks, _, _ = stormy(train(), 1, 60, 1e9)
    plain, translated = (Gateway(config_of(), train().codec, 0) for _ in range(2))
    translated.record["is_translated"] = 1
    assert singly(translated, blocks) == singly(plain, blocks)
    assert 0.0 < translated.load.record["busy_s"][0] < 0.2 * plain.load.record["busy_s"][0]
