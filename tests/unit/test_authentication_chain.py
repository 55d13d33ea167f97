"""Authenticated flags from the core to the drives that obey them, on the virtual bus."""

from functools import partial
from itertools import pairwise

import pytest

from dbc.codec import bind
from dbc.e2e import crc_ok, protect
from dbc.frame import EXTENDED, FD, Frame
from dbc.secoc_receiver import Verifier
from dbc.secoc_sender import Authenticator
from gateway.core.codes import Flag, Reason
from gateway.core.gateway import Gateway
from gateway.hil.bench import run_virtual
from gateway.settings.config import ConfigError, parse, shipped_dbc
from sim.simulation import Simulation
from tests.simrun import TICK, Flags, codec, scenario

KEY = bytes(range(16))
OTHER = bytes(range(1, 17))
ADHESION, FAULTS, AUTH = 0x1A0, 0x2A0, 0x320
LOSS = scenario(
    duration_s=3.0,
    event=[{"at_s": 1.5, "for_s": 1.0, "drive": 2, "kind": "adhesion_loss", "depth": 0.7}],
    expect=[{"flag": "adhesion", "is": "bad", "drive": 2, "after_s": 1.5, "within_ms": 60}],
)


def authenticated(dbc="traction.dbc", **sections):
    return parse({"authentication": {}, "dbc": {"file": dbc}, **sections})


class World:
    """Drives and a gateway for two seconds of a loss, and what each has sent."""

    def __init__(self, sender, dbc="traction.dbc"):
        self.codec = bind(shipped_dbc(dbc), (1, 2, 3))
        self.drives = Simulation(LOSS, self.codec)
        self.gateway = Gateway(authenticated(dbc), self.codec, 0, sender)
        self.ticks = []
        for tick in range(1, 201):
            frames = self.drives.step((), tick * TICK)
            self.ticks.append(self.gateway.step(frames, tick * TICK))


@pytest.fixture(scope="module")
def plain():
    return World(None)


@pytest.fixture(scope="module")
def vouched():
    return World(Authenticator(KEY, 1))


def test_each_flag_frame_is_followed_by_one_that_a_receiver_accepts(vouched):
    receiver = Verifier(KEY)
    spec = vouched.codec.by_id[AUTH]
    genuine = 0
    for out in vouched.ticks:
        ids = [f.can_id for f in out]
        assert [i for i, after in zip(ids, [*ids[1:], None], strict=True) if after == AUTH] == [
            i for i in ids if i in (ADHESION, FAULTS)
        ]
        for flag, auth in pairwise(out):
            if auth.can_id != AUTH:
                continue
            assert crc_ok(spec, auth.data)
            said = vouched.codec.decode(spec, auth.data)
            receiver.flag(flag.can_id, flag.data, flag.t_ns)
            found = receiver.auth(int(said["Freshness"].raw), int(said["Mac"].raw), auth.t_ns)
            genuine += found is not None and found.data == flag.data
    assert genuine == receiver.accepted > 200
    assert receiver.failed == 0
    assert receiver.held == 2, "from a start that was never heard of"


def test_everything_else_is_the_same_with_and_without(plain, vouched):
    """But for the load of the bus, in `Gateway_Status`."""
    left = (AUTH, 0x4A0)
    for without, out in zip(plain.ticks, vouched.ticks, strict=True):
        assert [f for f in without if f.can_id != 0x4A0] == [f for f in out if f.can_id not in left]
    assert AUTH not in {f.can_id for out in plain.ticks for f in out}


def test_flags_of_the_fd_set_are_authenticated_as_well():
    world = World(Authenticator(KEY, 1), "traction_fd.dbc")
    tags = [f for out in world.ticks for f in out if f.can_id == AUTH]
    assert len(tags) > 200
    assert {len(f.data) for f in tags} == {8}


def test_the_farewell_is_authenticated(vouched):
    ids = [f.can_id for f in vouched.gateway.unknown_frames(201 * TICK)]
    assert ids == [ADHESION, AUTH, FAULTS, AUTH, 0x4A0]


class Told:
    """Drives at 20 Nm that are told to cut; each tick's frames are what `say` makes of the flag."""

    def __init__(self, key):
        self.sender = Authenticator(KEY, 1)
        verifier = partial(Verifier, key, self.sender.freshness) if key else None
        preset = scenario(load={"kind": "preset", "torque_nm": 20.0})
        self.drives = Simulation(preset, codec(), verifier=verifier)
        self.flags = Flags()
        self.tick = 0

    def tag(self, flag):
        spec = codec().by_id[AUTH]
        low, mac = self.sender.sign(flag.can_id, flag.data)
        payload = codec().encode(spec, {"Freshness": low, "Mac": mac})
        protect(spec, payload, self.tick)
        return Frame(flag.t_ns, AUTH, bytes(payload))

    def go(self, say):
        """Load of drive 2 after half a second."""
        for _ in range(50):
            frames = say(self.flags.frame(self.tick * TICK, Adhesion2=2))
            self.tick += 1
            self.drives.step(frames, self.tick * TICK)
        return self.drives.truth_rows()[-2].load_nm


def test_a_drive_obeys_genuine_flags_as_it_does_without_authentication():
    without = Told(None)
    assert without.go(lambda flag: [flag]) == pytest.approx(6.0, abs=0.1)
    told = Told(KEY)
    assert told.go(lambda flag: [flag, told.tag(flag)]) == pytest.approx(6.0, abs=0.1)
    for receiver in told.drives.verifiers.values():
        assert (receiver.accepted, receiver.failed, receiver.held) == (50, 0, 0)


def test_a_drive_obeys_neither_bare_flags_nor_those_of_another_key_nor_recordings():
    told = Told(KEY)
    assert told.go(lambda flag: [flag]) == pytest.approx(20.0, abs=0.1)
    other = Told(OTHER)
    assert other.go(lambda flag: [flag, other.tag(flag)]) == pytest.approx(20.0, abs=0.1)
    recorded = []

    def record(flag):
        pair = [flag, told.tag(flag)]
        recorded.extend(pair)
        return pair

    told.go(record)
    assert told.go(lambda _: []) > 10.0, "silence of 40 ms: on its way back"
    replayed = iter(recorded)
    told.go(lambda _: [next(replayed), next(replayed)])
    assert told.go(lambda _: []) == pytest.approx(20.0, abs=0.1)
    assert {r.accepted for r in told.drives.verifiers.values()} == {50}


def test_tags_with_wrong_bits_lengths_or_kinds_are_nothing_to_a_drive():
    told = Told(KEY)

    def spoilt(flag):
        tag = told.tag(flag)
        wrong = bytes((tag.data[0] ^ 1, *tag.data[1:]))
        return [
            flag, tag._replace(data=wrong), tag._replace(data=tag.data[:7]),
            tag._replace(flags=FD), tag._replace(flags=EXTENDED), flag._replace(data=b""),
        ]  # fmt: skip

    assert told.go(spoilt) == pytest.approx(20.0, abs=0.1)
    assert told.go(lambda flag: [flag, told.tag(flag)]) == pytest.approx(6.0, abs=0.1)


def test_a_scenario_on_the_virtual_clock_passes_with_authentication():
    outcome = run_virtual(LOSS, authenticated(), codec(), key=KEY)
    assert outcome.passed, [v.detail for v in outcome.verdicts]
    assert outcome.gateway.outbox.vouches > 300


def intruded(config, sender):
    """A gateway that hears one frame with its own identifier, and what it says at the end."""
    drives = Simulation(scenario(duration_s=3.0), codec())
    gateway = Gateway(config, codec(), 0, sender)
    gateway.integrity.watching = True
    out = []
    for tick in range(1, 201):
        frames = drives.step((), tick * TICK)
        if tick == 150:
            frames.append(Frame(tick * TICK, ADHESION, bytes(8)))
        out = gateway.step(frames, tick * TICK)
    return gateway, out


def test_one_forged_frame_neither_silences_nor_blinds_an_authenticated_gateway():
    gateway, out = intruded(authenticated(), Authenticator(KEY, 1))
    assert [f.can_id for f in out][:2] == [ADHESION, AUTH]
    view = gateway.view
    assert view is not None
    assert {d.adhesion for d in view.drives} == {Flag.GOOD}
    assert view.adhesion_reason is Reason.NONE
    assert view.comm is Flag.BAD, "it is said, all the same"
    assert gateway.integrity.intruder


def test_who_wants_to_stop_stops():
    gateway, out = intruded(authenticated(bus={"on_intruder": "stop"}), Authenticator(KEY, 1))
    assert gateway.silent
    assert out == []


def test_who_has_no_key_has_nothing_to_go_on_with():
    """Such as a bench that reads the train's configuration: unknown, as without authentication."""
    gateway, out = intruded(authenticated(), None)
    assert [f.can_id for f in out][:1] == [ADHESION]
    view = gateway.view
    assert view is not None
    assert {d.adhesion for d in view.drives} == {Flag.UNKNOWN}
    assert view.adhesion_reason is Reason.INTRUDER


def test_going_on_untouched_needs_authentication():
    with pytest.raises(ConfigError, match=r"'tell' needs \[authentication\]"):
        parse({"bus": {"on_intruder": "tell"}})
    assert parse({}).on_intruder == "unknown"
    assert authenticated().on_intruder == "tell"
