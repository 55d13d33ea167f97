"""The core under a simulated bus that does everything a bus may do, watched by an oracle.

What is run here: 20 seeds of 1e5 ticks; `make soak` runs 100 of 1e6. A failure prints the command
that repeats it.
"""

from collections import Counter
from itertools import count as count_up

import numpy as np
import pytest

from gateway.core import gateway as core
from gateway.core.codes import Flag, Health, Reason
from gateway.core.flags import FlagKind
from gateway.core.receiving import NAMES
from tests.simrun import codec
from tests.stepped import Stepped
from tests.storm import campaign
from tests.storm.bus_faults import BUS_KINDS, KINDS, WHOLE_BUS, Fault, HostileBus, plan
from tests.storm.campaign import FD_SEEDS, QUEUE, Result, weather
from tests.storm.oracle import Oracle, Violation
from tests.storm.train import LOOP_TICKS, NODES, PHASES, TICK, train
from tests.storm.value_faults import ValueFaults

SEEDS, TICKS = range(20), 100_000
FD, FD_TICKS = (6, 7, 8), 30_000
"""Two seeds of several ticks in a call, one of single steps."""
QUICK, QUICK_TICKS = 3, 12_000
"""So many of SEEDS, and so many ticks, are for every change; `make test-all` has the others."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "ticks"),
    [(s, QUICK_TICKS) for s in [*SEEDS[:QUICK], FD_SEEDS + FD[0], FD_SEEDS + FD[2]]]
    + [pytest.param(s, TICKS, marks=pytest.mark.thorough) for s in SEEDS]
    + [pytest.param(FD_SEEDS + s, FD_TICKS, marks=pytest.mark.thorough) for s in FD],
)
def test_no_seed_breaks_a_rule(seed, ticks):
    result = weather(seed, ticks)
    assert not result.found, result.text()
    assert result.ticks == ticks
    # A gateway that never says anything would break no rule either.
    assert result.said["adhesion", Flag.GOOD] > ticks / 2
    assert result.said["adhesion", Flag.BAD] > ticks / 100
    assert result.said["thermal", Flag.GOOD] > ticks / 2
    for name in ("SensorFault", "CommFault", "EstimatorFault", "CommonMode", "Overrun"):
        assert result.said[name, Flag.GOOD] > ticks / 5, name


def test_the_seeds_bring_every_fault_to_every_phase_and_drive():
    train_phase = train().phase
    met = set()
    for seed in SEEDS:
        for fault in plan(seed, TICKS, len(NODES)):
            ticks = np.arange(fault.first, min(fault.last, TICKS))
            phases = np.unique(train_phase[(ticks - 1) % LOOP_TICKS]).tolist()
            met |= {(fault.kind, PHASES[phase], fault.drive) for phase in phases}
    drives = {kind: (None,) if kind in WHOLE_BUS else (None, 0, 1, 2) for kind in BUS_KINDS}
    wanted = {(kind, phase, d) for kind in BUS_KINDS for phase in PHASES for d in drives[kind]}
    assert wanted == met


def test_a_seed_is_the_same_every_time():
    assert weather(5, 3000) == weather(5, 3000)
    assert weather(5, 3000) != weather(6, 3000)


def test_a_result_names_the_commit_that_was_loaded():
    broken = [Violation(7, "stale", 1, "Adhering")]
    said = Result(44, 9, broken, Counter(), Counter(), 0, Counter()).text().splitlines()
    assert said[0].endswith(f"--seeds 44 --ticks 9 # on {campaign.COMMIT}")


@pytest.mark.parametrize("seed", [0, 2, 3, FD_SEEDS])
def test_several_ticks_in_a_call_come_to_the_same(seed):
    """EKF and UKF with the detector that is compiled, one that is not, and CAN FD."""
    assert weather(seed, 3000, 60.0, several=True) == weather(seed, 3000, 60.0, several=False)


def test_every_filter_meets_every_detector_stepped_either_way():
    met = {
        (config.estimator.kind, config.adhesion.detector, campaign.in_calls(seed))
        for seed in range(24)
        for config in [campaign.config_of(seed)]
    }
    assert len(met) == 2 * 4 * 2


DENSE = (3, 16_000, 100.0)


def test_a_denser_storm_breaks_no_rule_either():
    assert not weather(*DENSE).found


@pytest.mark.parametrize("spoilt", [0.5, 1.0])
def test_a_second_sender_in_a_disturbance(spoilt, monkeypatch):
    """Heard through it: guarded for a second after. Not one whole frame: nobody knows of it."""
    faults = [
        Fault("corrupt", 3000, 3107, 0, spoilt),
        Fault("second_sender", 3034, 3084, None, 1.0),
    ]
    monkeypatch.setattr(campaign, "plan", lambda *_: faults)
    seen = []
    real = Oracle.look

    def look(self, tick, came, out, status, *more):
        real(self, tick, came, out, status, *more)
        if 3107 < tick <= 3084 + 95:
            seen.append(status.drives["flag"]["state"][:, FlagKind.ADHESION].tolist())

    monkeypatch.setattr(Oracle, "look", look)
    assert not weather(32, 3300).found
    good = [state[0] == Flag.GOOD for state in seen]
    assert any(good) == (spoilt == 1.0)
    assert not any(state[1] == Flag.GOOD for state in seen), "the others' second sender is heard"


def told(faults, seed, ticks, monkeypatch):
    """What is said of drive 1, (adhesion, thermal) by tick, under these faults; no rule broken."""
    monkeypatch.setattr(campaign, "plan", lambda *_: faults)
    out = {}
    real = Oracle.look

    def look(self, tick, came, frames, status, *more):
        real(self, tick, came, frames, status, *more)
        sent = status.drives["flag"]["state"][0].tolist()
        out[tick] = sent[FlagKind.ADHESION], sent[FlagKind.THERMAL]

    monkeypatch.setattr(Oracle, "look", look)
    result = weather(seed, ticks)
    assert not result.found, result.text()
    return out


def test_who_spoke_for_a_silent_drive_is_believed_until_it_is_too_old(monkeypatch):
    """A limit (R09), and its end: 300 ms after the last of it, and the tick."""
    faults = [Fault("drop", 1000, 1200, 0, 0.5), Fault("second_sender", 1005, 1060, 0, 0.5)]
    thermal = {tick: state for tick, (_, state) in told(faults, 1, 1200, monkeypatch).items()}
    # Of this seed the drive's own temperatures are lost for longer than that.
    assert thermal[1063] == Flag.GOOD
    assert Flag.UNKNOWN in {thermal[tick] for tick in range(1064, 1060 + 31)}


def test_a_second_sender_is_guarded_from_when_it_was_last_heard(monkeypatch):
    """Not from when it last spoke, where a full queue has lost that while the process stood."""
    faults = [
        Fault("second_sender", 3000, 3101, 0, 0.5),
        Fault("process_stop", 3050, 3100, None, 1),
    ]
    adhesion = {tick: state for tick, (state, _) in told(faults, 0, 3300, monkeypatch).items()}
    good = [tick for tick, state in adhesion.items() if tick > 3010 and state == Flag.GOOD]
    # The queue has room for eight ticks or so; drives need some time to be believed again.
    assert 3050 + 95 < min(good) < 3100 + 95


def test_a_whole_copy_stands_for_a_frame_that_was_spoilt():
    """Seed 44: for 300 ms all temperatures of a drive were such, and rightly believed."""
    faults = [Fault("duplicate", 100, 200, None, 1.0), Fault("corrupt", 100, 200, None, 0.5)]
    ids = sorted(set(train().sent(100).can_id.tolist()))
    bus = HostileBus(faults, [ids], 1)
    spoilt = copies = 0
    for tick in range(100, 200):
        sent = train().sent(tick)
        came = bus.carry(sent, lambda: sent, tick, tick * TICK)  # noqa: B023
        arrived = [frame._replace(t_ns=0) for frame in came.block.frames()]
        genuine = Counter(f for f, mine in zip(arrived, came.genuine, strict=True) if mine)
        for frame in sent.frames():
            # At most once, whichever of the two it was; never, if neither came whole.
            whole = arrived.count(frame._replace(t_ns=0))
            assert genuine[frame._replace(t_ns=0)] == min(whole, 1)
            spoilt += whole == 0
            copies += whole == 2
    assert spoilt > 100
    assert copies > 100


def stale_is_believed(monkeypatch):
    def believe(made):
        made.inputs.status["reason"], made.inputs.status["sample_fresh"] = Reason.NONE, True

    built(monkeypatch, lambda made: made.after("inputs", believe))


def clear(flags):
    """Bad becomes unknown where the evidence is."""
    state = flags["state"]
    state[(state == Flag.BAD) & (flags["evidence"] == Flag.UNKNOWN)] = Flag.UNKNOWN


def unknown_clears(monkeypatch):
    def change(made):
        made.after("debounced", lambda made: clear(made.status.drives["flag"]))
        made.after("adhesion", lambda made: clear(made.adhesion.record["common_mode"]))

    built(monkeypatch, change)


def evidence(monkeypatch, change):
    """Changed once it is collected."""

    def seen(made):
        change(made.flags, made.flags.evidence["of"])

    built(monkeypatch, lambda made: made.after("evidence", seen))


def health_is_ignored(monkeypatch):
    """And no flag waits for anything."""

    def change(flags, seen):
        reason, mine = flags.inputs["input_reason"], seen[:, FlagKind.ADHESION]
        sound = (reason == Reason.NONE) & (flags.inputs["input_implausible"] == 0)
        mine[sound & (mine != Flag.BAD)] = Flag.GOOD

    evidence(monkeypatch, change)

    def hurry(made):
        for timing in (made.flags.rules["timing"], made.flags.rules["severe"]):
            timing["good_ns"] = timing["clear_ns"] = 0

    built(monkeypatch, hurry)


def wrong_speed(monkeypatch):
    """Told after the measured speed has been asked."""

    def change(made):
        speed = made.bank.estimates["speed_rad_s"]
        speed[speed != 0.0] += 30.0

    built(monkeypatch, lambda made: made.after("estimates", change))


def counter_stands_still(monkeypatch):
    def change(made):
        made.outbox.messages["counter"] = 0

    built(monkeypatch, lambda made: made.after("published", change))


def frames_are_forgotten(monkeypatch):
    monkeypatch.setattr("gateway.core.inbox.NAMES", ("decoded",) * len(NAMES))


def built(monkeypatch, change):
    """Every gateway of a storm is changed once it is made, by this as well."""
    before = campaign.Gateway if campaign.Gateway is not core.Gateway else Stepped

    def make(*given):
        made = before(*given)
        change(made)
        return made

    monkeypatch.setattr(campaign, "Gateway", make)


def at_once(which):
    """A flag that waits for nothing."""

    def broken(monkeypatch):
        built(monkeypatch, lambda made: made.flags.rules["timing"][0, which : which + 1].fill(0))

    return broken


def ills(monkeypatch, *which):
    """Evidence against these flags, of each drive in turn: a storm seldom brings it by itself."""
    ticks = count_up()

    def change(_flags, seen):
        turn, at = divmod(next(ticks), 900)
        if 600 < at < 750:
            seen[turn % len(NODES), list(which)] = Flag.BAD

    evidence(monkeypatch, change)


def ill_at_once(which):
    def broken(monkeypatch):
        ills(monkeypatch, which)
        at_once(which)(monkeypatch)

    return broken


def always_good(which):
    """Whatever the evidence is."""

    def broken(monkeypatch):
        def change(_flags, seen):
            seen[:, which] = Flag.GOOD

        evidence(monkeypatch, change)

    return broken


def changes_are_not_sent(monkeypatch):
    """Not in their own tick: in the next tenth one."""

    def change(made):
        messages = made.outbox.messages
        messages["on_change"] = 0
        messages["on_change"][np.argmax(messages["cycle_ns"])] = 1

    built(monkeypatch, change)


def sent_health(value):
    """On the wire only: the gateway itself knows better."""

    def broken(monkeypatch):
        known = []

        def hide(made):
            known[:] = [made.status.drives["health"].copy()]
            made.status.drives["health"] = value

        def show(made):
            made.status.drives["health"] = known[0]

        def change(made):
            made.after("published", hide)
            made.after("sent", show)

        built(monkeypatch, change)

    return broken


STOPS = [Fault("process_stop", at, at + 8, None, 1.0) for at in range(1500, 3000, 150)]
"""The queue holds nearly all that comes meanwhile, so that samples are fresh afterwards."""
SENDERS = [Fault("second_sender", at, at + 60, None, 0.5) for at in (2000, 2200, 2400)]
SILENCE = [Fault("bus_off", 3340, 3360, None, 1.0)]
"""While no wheel holds."""


def unknown_clears_all(monkeypatch):
    monkeypatch.setattr(campaign, "plan", lambda *_: SILENCE)
    unknown_clears(monkeypatch)


def overruns_are_hidden(monkeypatch):
    monkeypatch.setattr(core.IntegrityMonitor, "note_overrun", lambda *_: None)


def overruns_are_never_over(monkeypatch):
    monkeypatch.setattr("gateway.core.integrity.OVERRUN_HOLD_NS", 1 << 60)


def lost_frames_are_forgotten(monkeypatch):
    monkeypatch.setattr(campaign, "plan", lambda *_: STOPS)
    monkeypatch.setattr(core.IntegrityMonitor, "note_lost", lambda *_: None)


def two_senders_are_one(monkeypatch):
    """No frame comes too soon after another where there is no period."""
    monkeypatch.setattr(campaign, "plan", lambda *_: SENDERS)
    built(
        monkeypatch, lambda made: made.inbox.receiver.channels["guard"]["shortest_step_ns"].fill(0)
    )


def stale_is_believed_of_two(monkeypatch):
    """While two speak for every drive, the bus is off for a moment."""
    stale_is_believed(monkeypatch)
    two_senders_are_one(monkeypatch)
    faults = [Fault("second_sender", 2000, 3500, None, 0.5), *SILENCE]
    monkeypatch.setattr(campaign, "plan", lambda *_: faults)


class Found(Exception):
    """The oracle has noticed."""


@pytest.mark.parametrize(
    ("broken", "rule", "what"),
    [
        (stale_is_believed, "stale", "Adhering"),
        (stale_is_believed_of_two, "stale", "Adhering"),
        (unknown_clears, "cleared", "AdhesionLost went to Unknown"),
        (unknown_clears_all, "cleared", "CommonMode went to Unknown"),
        (health_is_ignored, "hasty", "fresh samples"),
        (health_is_ignored, "untracked", "Adhering while"),
        (wrong_speed, "untracked", "off the truth"),
        (counter_stands_still, "form", "counter"),
        (always_good(FlagKind.SENSOR), "stale", "SensorFault"),
        (always_good(FlagKind.THERMAL), "stale", "NoFault"),
        (always_good(FlagKind.COMM), "stale", "CommFault"),
        (always_good(FlagKind.ESTIMATOR), "untracked", "EstimatorFault"),
        (at_once(FlagKind.SENSOR), "hasty", "SensorFault"),
        (at_once(FlagKind.COMM), "hasty", "CommFault"),
        (at_once(FlagKind.COMM), "cleared", "CommFault"),
        (ill_at_once(FlagKind.SENSOR), "cleared", "SensorFault"),
        (ill_at_once(FlagKind.ESTIMATOR), "cleared", "EstimatorFault"),
        (ill_at_once(FlagKind.THERMAL), "cleared", "fresh temperatures"),
        (changes_are_not_sent, "stale", "NoFault"),
        (sent_health(Health.CONVERGING), "untracked", "Adhering while"),
        (sent_health(Health.TRACKING), "stale", "Health"),
        (overruns_are_hidden, "overrun", "says 1"),
        (overruns_are_never_over, "overrun", "says 2"),
        (lost_frames_are_forgotten, "lost", "Adhering"),
        (two_senders_are_one, "masquerade", "Adhering"),
    ],
    ids=lambda part: part if isinstance(part, str) else "",
)
def test_the_oracle_finds_a_gateway_that_breaks_its_rule(broken, rule, what, monkeypatch):
    def noticed(_self, _tick, by, _drive, why):
        if by == rule and what in why:
            raise Found

    broken(monkeypatch)
    monkeypatch.setattr(Oracle, "_broken", noticed)
    with pytest.raises(Found):
        weather(*DENSE)


def test_the_oracle_finds_a_gateway_that_does_not_count(monkeypatch):
    monkeypatch.setattr(campaign, "MOST_FOUND", 10_000)
    frames_are_forgotten(monkeypatch)
    assert "counted" in {v.rule for v in weather(3, 500, 100.0).found}


@pytest.mark.parametrize("faults", [STOPS, SENDERS, SILENCE], ids=lambda faults: faults[0].kind)
def test_where_broken_gateways_are_found_a_whole_one_breaks_no_rule(faults, monkeypatch):
    monkeypatch.setattr(campaign, "plan", lambda *_: faults)
    result = weather(3, 3600)
    assert not result.found, result.text()
    assert result.said["CommonMode", Flag.BAD] > 10


def test_with_evidence_against_every_flag_no_rule_is_broken(monkeypatch):
    """The same illnesses as above, and a gateway that is whole."""
    ills(monkeypatch, FlagKind.SENSOR, FlagKind.ESTIMATOR, FlagKind.THERMAL)
    result = weather(3, 6000)
    assert not result.found, result.text()
    for name in ("SensorFault", "EstimatorFault", "thermal"):
        assert result.said[name, Flag.BAD] > 100


ONE = [spec.can_id for spec in codec(NODES).messages if spec.name.startswith("Drive2_")]


def carried(kind, amount=1.0, ticks=40, drive=1):
    """Ticks of a running train under one fault from tick 11 to 30; (arrived, sent) per tick."""
    honest = train()
    ids = [[0x181], ONE, [0x183]]
    values = ValueFaults(honest.codec, NODES)
    bus = HostileBus([Fault(kind, 11, 31, drive, amount)], ids, 1, values)
    out = []
    for k in range(1, ticks + 1):
        tick = k + 2000
        sent = honest.sent(tick)
        shifted = sent._replace(t_ns=sent.t_ns - 2000 * TICK)
        other = honest.elsewhere(tick)
        came = bus.carry(
            shifted, lambda o=other: o._replace(t_ns=o.t_ns - 2000 * TICK), k, k * TICK
        )
        out.append((came, shifted))
    return out


def count(came, ids):
    return int(np.isin(came.block.can_id, ids).sum())


@pytest.mark.parametrize("kind", KINDS)
def test_outside_its_time_a_fault_changes_nothing(kind):
    for k, (came, sent) in enumerate(carried(kind), start=1):
        if k < 11:
            assert came.genuine.all()
            assert np.array_equal(came.block.data, sent.data)
        late = came.block.t_ns[1:] - came.block.t_ns[:-1]
        assert (late >= 0).all()


def test_what_each_fault_does():
    dropped = carried("drop")[15][0]
    assert count(dropped, ONE) == 0
    assert count(dropped, [0x181]) == 5
    twice = carried("duplicate")[15]
    assert count(twice[0], ONE) == 2 * count(Sent(twice[1]), ONE)
    assert twice[0].genuine.sum() == twice[1].size
    late = carried("delay", 0.1)
    assert count(late[11][0], ONE) == 0
    assert sum(count(came, ONE) for came, _ in late) == sum(count(Sent(s), ONE) for _, s in late)
    damaged, sent = carried("corrupt")[15]
    bad = damaged.block.pick(~damaged.genuine)
    assert bad.size == count(Sent(sent), ONE)
    assert count(carried("flood", drive=None)[15][0], [0]) > 50
    assert carried("bus_off", drive=None)[15][0].block.size == 0
    assert (carried("link_loss", drive=None)[10][0].block.flags == 4).all()
    stepped = carried("clock_step", drive=None)[15][0]
    assert (stepped.block.t_ns > 3600 * 10**9).all()
    assert not stepped.genuine.any()
    both = carried("second_sender")[15]
    assert count(both[0], [0x182]) == 10
    assert count(both[0], [0x181]) == 5


class Sent:
    """A block as if it had arrived."""

    def __init__(self, block):
        self.block = block


def test_the_queue_of_a_stopped_process_is_bounded():
    waiting = campaign.NOTHING
    for tick in range(1, 30):
        block = train().sent(tick)
        arrived = campaign.Arrived(block, np.ones(block.size, dtype=bool))
        waiting = campaign._queued(waiting, arrived)
    assert waiting.block.size == len(waiting.genuine) == QUEUE
