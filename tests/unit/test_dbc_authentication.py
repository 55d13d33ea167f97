"""Authentication of flags: published vectors, what is accepted, what is not, and the limits."""

import random

import pytest

from dbc.frame import MS, SECOND
from dbc.secoc_receiver import (
    AT_ONCE,
    QUIET_NS,
    SURE,
    SWEEP,
    SWEEP_RATE,
    TRIPS,
    TURNS,
    WAITING,
    WAITING_NS,
    WINDOW,
    Verifier,
)
from dbc.secoc_sender import COUNT_BITS, LAST_TRIP, Authenticator, Macs

KEY = bytes.fromhex("2b7e151628aed2a6abf7158809cf4f3c")
ADHESION, FAULTS = 0x1A0, 0x2A0

# RFC 4493, section 4.
MESSAGE = bytes.fromhex(
    "6bc1bee22e409f96e93d7e117393172aae2d8a571e03ac9c9eb76fac45af8e51"
    "30c81c46a35ce411e5fbc1191a0a52eff69f2445df4f9b17ad2b417be66c3710"
)
VECTORS = {
    0: "bb1d6929e95937287fa37d129b756746",
    16: "070a16b46b4d4144f79bdd9dd04a287c",
    40: "dfa66747de9ae63030ca32611497c827",
    64: "51f0bebf7e3b9d92fc49741779363cfe",
}


@pytest.mark.parametrize("length", VECTORS)
def test_the_mac_is_rfc_4493s(length):
    macs = Macs(KEY)
    for _ in range(2):  # the keyed object is not used up
        assert macs.whole(MESSAGE[:length]).hex() == VECTORS[length]


def test_the_sent_mac_is_the_first_four_bytes_over_identifier_frame_and_freshness():
    message = bytes.fromhex("000001a0" "0102030405060708" "0000010000000001")  # fmt: skip
    freshness, mac = Authenticator(KEY, 1).sign(ADHESION, bytes(range(1, 9)))
    assert freshness == 1
    assert mac.to_bytes(4, "little") == Macs(KEY).whole(message)[:4] == bytes.fromhex("2c1f4850")


@pytest.mark.parametrize("length", [0, 15, 17, 24, 32])
def test_a_key_has_16_bytes(length):
    with pytest.raises(ValueError, match=f"16 bytes, not {length}"):
        Macs(bytes(length))


@pytest.mark.parametrize("trip", [0, -1, LAST_TRIP + 1])
def test_start_numbers_have_24_bits(trip):
    with pytest.raises(ValueError, match="start number"):
        Authenticator(KEY, trip)


class Line:
    """A sender and a receiver; `tick` sends one flag frame and its Auth, 10 ms later."""

    def __init__(self, trip=1, freshness=0):
        self.sender = Authenticator(KEY, trip)
        self.receiver = Verifier(KEY, freshness)
        self.now = 1000 * SECOND
        self.number = 0

    def made(self, key=ADHESION):
        self.number += 1
        data = self.number.to_bytes(8, "big")
        return (key, data, *self.sender.sign(key, data))

    def hear(self, made):
        key, data, low, mac = made
        self.receiver.flag(key, data, self.now)
        genuine = self.receiver.auth(low, mac, self.now)
        if genuine is None:
            return None
        assert genuine.key == key
        return genuine.data

    def tick(self, key=ADHESION):
        self.now += 10 * MS
        made = self.made(key)
        return self.hear(made) == made[1]

    def lose(self, frames):
        self.sender.freshness += frames
        self.now += 10 * MS * frames


@pytest.fixture
def line():
    """One on which a frame has been accepted."""
    line = Line(freshness=1 << COUNT_BITS)
    assert line.tick()
    return line


def test_genuine_frames_are_accepted_from_the_first_where_the_start_is_known():
    line = Line(trip=7, freshness=7 << COUNT_BITS)
    assert all(line.tick(key) for key in (ADHESION, FAULTS) * 50)
    assert line.receiver.accepted == 100
    assert line.receiver.failed == 0
    assert line.receiver.auth(0, 0, line.now) is None
    assert line.receiver.alone == 1, "nothing waits once its tag has come"


@pytest.mark.parametrize("byte", range(8))
def test_a_flag_frame_changed_in_any_bit_is_not_accepted(byte):
    for bit in range(8):
        line = Line(freshness=1 << COUNT_BITS)
        assert line.tick()
        key, data, low, mac = line.made()
        changed = bytearray(data)
        changed[byte] ^= 1 << bit
        assert line.hear((key, bytes(changed), low, mac)) is None
        assert line.receiver.failed == 1


def test_neither_another_identifier_nor_a_changed_tag_is_accepted(line):
    key, data, low, mac = line.made()
    assert line.hear((FAULTS, data, low, mac)) is None
    for bit in range(32):
        line.receiver = Verifier(KEY, line.sender.freshness - 1)
        assert line.hear((key, data, low, mac ^ 1 << bit)) is None
        if bit < 16:
            assert line.hear((key, data, low ^ 1 << bit, mac)) is None


def test_what_was_heard_is_never_accepted_again():
    line = Line(freshness=1 << COUNT_BITS)
    record = []
    for _ in range(200):
        line.now += 10 * MS
        record.append(line.made())
        assert line.hear(record[-1]) is not None
    for gap_ns in (0, QUIET_NS, SECOND):
        line.now += gap_ns
        for made in record:
            line.now += 10 * MS
            assert line.hear(made) is None
    assert line.tick(), "a genuine frame counts after any number of replays"


def test_reordered_pairs_count_once_and_only_forwards():
    line = Line(freshness=1 << COUNT_BITS)
    first, second = line.made(), line.made()
    assert line.hear(second) == second[1]
    assert line.hear(first) is None


def test_two_flag_frames_before_their_two_tags_are_both_found():
    """A controller with a mailbox per message sends by identifier."""
    line = Line(freshness=1 << COUNT_BITS)
    flag, fault = line.made(ADHESION), line.made(FAULTS)
    for key, data, _, _ in (flag, fault):
        line.receiver.flag(key, data, line.now)
    for key, data, low, mac in (flag, fault):
        genuine = line.receiver.auth(low, mac, line.now)
        assert genuine is not None
        assert (genuine.key, genuine.data) == (key, data)


def test_a_tag_without_a_flag_frame_or_too_late_says_nothing():
    line = Line(freshness=1 << COUNT_BITS)
    key, data, low, mac = line.made()
    assert line.receiver.auth(low, mac, line.now) is None
    line.receiver.flag(key, data, line.now)
    assert line.receiver.auth(low, mac, line.now + WAITING_NS + 1) is None
    assert line.receiver.alone == 2


@pytest.mark.parametrize(
    ("lost", "after"), [(0, 1), (WINDOW - 1, 1), (WINDOW, SURE), (70_000, SURE)]
)
def test_after_a_loss(line, lost, after):
    """A short one costs what was lost; a long one two frames more."""
    line.lose(lost)
    heard = [line.tick() for _ in range(5)]
    assert heard == [False] * (after - 1) + [True] * (6 - after)


@pytest.mark.parametrize("starts", [1, 2, TRIPS])
def test_after_restarts_of_the_gateway(line, starts):
    line.sender = Authenticator(KEY, 1 + starts)
    line.now += SECOND
    heard = [line.tick() for _ in range(5)]
    assert heard == [False] * (SURE - 1) + [True] * (6 - SURE)


@pytest.mark.parametrize("freshness", [0, 1 << COUNT_BITS, (3 << COUNT_BITS) + 500])
@pytest.mark.parametrize("turns", [0, 1, 100, TURNS - 1])
def test_a_receiver_that_starts_late_finds_the_place(freshness, turns):
    line = Line(trip=40, freshness=freshness)
    line.sender.freshness += turns << 16
    frames = (TRIPS + 1) * TURNS // SWEEP + SURE
    heard = [line.tick() for _ in range(frames)]
    assert True in heard
    assert all(heard[heard.index(True) :])


def test_turns_are_counted_from_the_last_that_was_heard():
    line = Line(trip=2, freshness=(2 << COUNT_BITS) + (TURNS << 16))
    line.sender.freshness += TURNS + 50 << 16
    assert any(line.tick() for _ in range((TRIPS + 1) * TURNS // SWEEP + SURE))


def test_a_held_pair_that_is_repeated_does_not_confirm_itself():
    line = Line(freshness=1 << COUNT_BITS)
    line.sender = Authenticator(KEY, 2)
    for _ in range(SURE - 1):
        line.now += 10 * MS
        held = line.made()
        assert line.hear(held) is None
    assert line.receiver.held == SURE - 1
    for _ in range(3 * SURE):
        line.now += 10 * MS
        assert line.hear(held) is None
    assert line.tick()


def test_only_so_many_flag_frames_wait():
    """Each is one more chance for a guessed tag; who pushes a flag out has cost it its tag."""
    line = Line(freshness=1 << COUNT_BITS)
    for others, counts in ((WAITING - 1, True), (WAITING, False)):
        key, data, low, mac = line.made()
        line.receiver.flag(key, data, line.now)
        for k in range(others):
            line.receiver.flag(ADHESION, bytes((255, k)), line.now)
            line.receiver.flag(FAULTS, bytes((255, k)), line.now)
        assert (line.receiver.auth(low, mac, line.now) is not None) == counts
    assert line.tick()


@pytest.mark.parametrize(
    "freshness", [(TRIPS + 2) << COUNT_BITS, (1 << COUNT_BITS) + (TURNS + 2 << 16)]
)
def test_beyond_the_limits_nothing_is_accepted(freshness):
    line = Line(freshness=1 << COUNT_BITS)
    line.sender.freshness = freshness
    assert not any(line.tick() for _ in range(200))


def test_an_older_start_number_is_never_accepted():
    line = Line(trip=5, freshness=(5 << COUNT_BITS) + 10)
    line.sender = Authenticator(KEY, 4)
    assert not any(line.tick() for _ in range(200))


def flooded(line, rng, forgeries):
    """A tick in which forged tags, of likely freshness and of any, stand between the two frames."""
    line.now += 10 * MS
    made = line.made()
    line.receiver.flag(made[0], made[1], line.now)
    for k in range(forgeries):
        low = (line.sender.freshness + k) & 0xFFFF if k % 2 else rng.getrandbits(16)
        assert line.receiver.auth(low, rng.getrandbits(32), line.now) is None
    genuine = line.receiver.auth(made[2], made[3], line.now)
    return genuine is not None and genuine.data == made[1]


@pytest.mark.parametrize("starts", [1, AT_ONCE])
def test_under_that_flood_a_restart_and_a_long_loss_are_bridged_as_without_it(starts):
    line, rng = Line(freshness=1 << COUNT_BITS), random.Random(2)
    assert flooded(line, rng, 80)
    line.sender = Authenticator(KEY, 1 + starts)
    line.now += SECOND
    expected = [False] * (SURE - 1) + [True] * 3
    assert [flooded(line, rng, 80) for _ in range(5)] == expected
    line.lose(70_000)
    assert [flooded(line, rng, 80) for _ in range(5)] == expected


def test_the_search_is_rate_limited_and_a_heard_sender_is_not_searched_for(monkeypatch, line):
    tried = []
    plain = Macs.of
    monkeypatch.setattr(Macs, "of", lambda *words: tried.append(1) or plain(*words))
    rng = random.Random(3)
    for _ in range(100):
        line.receiver.flag(ADHESION, bytes(8), line.now)
        line.receiver.auth(rng.getrandbits(16), rng.getrandbits(32), line.now)
    assert len(tried) <= 100 * WAITING, "only what the window holds"
    line.now += 10 * SECOND
    tried.clear()
    for _ in range(9000):  # a second of a full bus
        line.now += SECOND // 9000
        line.receiver.flag(ADHESION, bytes(8), line.now)
        line.receiver.auth(rng.getrandbits(16), rng.getrandbits(32), line.now)
    assert SWEEP_RATE * 0.9 < len(tried) < SWEEP_RATE + SWEEP + 9000 * (AT_ONCE + 2 + WAITING)


def test_failures_are_told_once_a_second(line):
    rng = random.Random(4)
    assert line.receiver.notice(line.now) is None
    said = []
    for _ in range(300):
        flooded(line, rng, 10)
        said.append(line.receiver.notice(line.now))
    lines = [text for text in said if text]
    assert len(lines) == 3
    assert lines[1].startswith("1000 more frames failed authentication")


@pytest.mark.parametrize(
    "count", [100_000, pytest.param(1_000_000, marks=[pytest.mark.slow, pytest.mark.thorough])]
)
def test_a_million_random_forgeries(count):
    """Expected with 32 bits: 0.0005. The figures are printed, `-s` shows them."""
    line, rng = Line(freshness=1 << COUNT_BITS), random.Random(2026)
    accepted = 0
    for k in range(count):
        if k % 100 == 0:
            assert line.tick()
        line.receiver.flag(rng.choice((ADHESION, FAULTS)), rng.randbytes(8), line.now)
        low = line.sender.freshness + 1 + rng.randrange(WINDOW) & 0xFFFF
        accepted += line.receiver.auth(low, rng.getrandbits(32), line.now) is not None
    print(f"\n{count:,} forgeries, {accepted} accepted; {line.receiver.accepted} genuine")
    assert accepted == 0
    assert line.receiver.accepted == count // 100
