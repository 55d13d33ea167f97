"""E2E: published vectors, a second CRC library, exhaustive error patterns, counter, states."""

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from crccheck.crc import Crc8Autosar, Crc16Ibm3740

from dbc import generate as build
from dbc.codec import bind
from dbc.e2e import (
    COUNTERS,
    HEADER_BYTES,
    MAX_DELTA,
    WINDOW,
    Check,
    Profile,
    Receiver,
    SmState,
    counter_of,
    crc_ok,
    p02_data_ids,
    protect,
)


@dataclass(frozen=True)
class Own:
    """The least a receiver needs to know."""

    profile: Profile
    data_ids: bytes


P02 = Own(Profile.P02, p02_data_ids(0x1A0))
P05 = Own(Profile.P05, b"\x01\x81")
NONE = Own(Profile.NONE, b"")


def frame(spec, counter, body=b"\x12\x34\x56"):
    payload = bytearray(8 if spec.profile is not Profile.P05 else 64)
    payload[3 : 3 + len(body)] = body
    protect(spec, payload, counter)
    return bytes(payload)


# ---- vectors -----------------------------------------------------------------------------------


def counts_of(receiver):
    """Frames that are good, that have a wrong checksum, came again, or are out of sequence."""
    good = receiver.counts[Check.OK] + receiver.counts[Check.OK_SOME_LOST]
    bad = (Check.ERROR, Check.REPEATED, Check.WRONG_SEQUENCE)
    return good, *(receiver.counts[check] for check in bad)


def test_vector_of_profile_2():
    payload = bytearray(8)
    protect(Own(Profile.P02, bytes(range(1, 17))), payload, 1)
    assert payload.hex() == "1b01000000000000"


def test_vectors_of_profile_5():
    """PRS_E2EProtocol: id 0x1234, counter 0, eight bytes, header at the start."""
    payload = bytearray(8)
    protect(Own(Profile.P05, b"\x12\x34"), payload, 0)
    assert payload.hex() == "1cca000000000000"


def test_whole_frames_equal_the_second_library():
    """P02: CRC over bytes 1.. and the counter's id. P05: over bytes 2.. and the id, LSB first."""
    generator = np.random.default_rng(4)
    for k in range(10_000):
        ids = generator.bytes(16)
        payload = bytearray(generator.bytes(int(generator.integers(2, 65))))
        protect(Own(Profile.P02, ids), payload, k)
        assert payload[1] & 15 == k & 15
        assert payload[0] == Crc8Autosar.calc(payload[1:] + ids[k & 15 : (k & 15) + 1])
        payload = bytearray(generator.bytes(int(generator.integers(3, 65))))
        protect(Own(Profile.P05, ids[:2]), payload, k)
        assert payload[2] == k & 255
        assert int.from_bytes(payload[:2], "little") == Crc16Ibm3740.calc(
            payload[2:] + bytes((ids[1], ids[0]))
        )


# ---- error patterns ----------------------------------------------------------------------------


def crc_table():
    table = np.zeros(256, np.uint8)
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = (crc << 1) ^ 0x2F if crc & 0x80 else crc << 1
        table[byte] = crc & 0xFF
    return table


def undetected(frames, ids):
    """How many of these eight-byte frames a receiver would accept (own table CRC)."""
    table = crc_table()
    crc = np.full(len(frames), 0xFF, np.uint8)
    for k in range(1, 8):
        crc = table[crc ^ frames[:, k]]
    data_id = np.frombuffer(ids, np.uint8)[frames[:, 1] & 15]
    crc = table[crc ^ data_id] ^ 0xFF
    return int((crc == frames[:, 0]).sum())


def test_no_error_of_up_to_three_bits_goes_unseen():
    """All C(64, 1..3) = 43,744 patterns, the counter's bits among them, at every counter."""
    masks = [
        sum(1 << bit for bit in bits)
        for k in (1, 2, 3)
        for bits in itertools.combinations(range(64), k)
    ]
    assert len(masks) == 43_744
    flips = np.array(masks, np.uint64).view(np.uint8).reshape(-1, 8)
    for can_id in (0x1A0, 0x2A0):
        spec = Own(Profile.P02, p02_data_ids(can_id))
        for counter in range(16):
            payload = bytearray(b"\0\0\x55\xaa\x96\x99\x01\x07")
            protect(spec, payload, counter)
            good = np.frombuffer(bytes(payload), np.uint8)
            assert undetected(good.reshape(1, 8), spec.data_ids) == 1
            assert undetected(good ^ flips, spec.data_ids) == 0
    # The table CRC above is the library's: the same patterns of one and two bits through it.
    for mask in flips[: 64 + 2016]:
        assert not crc_ok(spec, (good ^ mask).tobytes())


def test_no_error_of_up_to_three_bits_goes_unseen_in_a_long_frame():
    """P05, 64 bytes, all C(512, 1..3) = 22,370,048 patterns.

    A checksum is linear: an error goes unseen where the syndromes of its bits add up to nothing.
    That of a single bit is the checksum that the frame would need, less the one that it has.
    """
    good = frame(P05, 7)

    def syndrome(bit):
        body = bytearray(good)
        body[bit >> 3] ^= 1 << (bit & 7)
        needed = bytearray(body)
        protect(P05, needed, body[2])
        return int.from_bytes(needed[:2], "little") ^ int.from_bytes(body[:2], "little")

    syndromes = np.array([syndrome(bit) for bit in range(512)])
    assert np.all(syndromes != 0)
    pairs = (syndromes[:, None] ^ syndromes)[np.triu_indices(512, 1)]
    assert np.all(pairs != 0)
    # A third bit that undoes a pair would not be one of the pair: those are not 0.
    assert not np.isin(pairs, syndromes).any()
    for bits in itertools.islice(itertools.combinations(range(3, 512, 61), 3), 0, None, 7):
        flipped = bytearray(good)
        for bit in bits:
            flipped[bit >> 3] ^= 1 << (bit & 7)
        assert not crc_ok(P05, bytes(flipped))


def test_bursts_of_up_to_eight_bits_in_wire_order():
    """All are seen but six, and those change the counter, which selects another data id.

    7,423 bursts at each counter. The six would still have to pass the counter check.
    """
    counter_bits = 0x0F << 48
    bursts = [
        pattern << shift
        for pattern in range(1, 256, 2)
        for shift in range(64)
        if pattern << shift < 1 << 64
    ]
    assert len(bursts) == 7_423
    unseen = set()
    for counter in range(16):
        good = int.from_bytes(frame(P02, counter), "big")
        unseen |= {b for b in bursts if crc_ok(P02, (good ^ b).to_bytes(8, "big"))}
    assert len(unseen) == 6
    assert all(burst & counter_bits for burst in unseen)


def test_empty_and_full_frames_are_no_good_frames():
    codec = bind(Path(build.__file__).parent / "traction_fd.dbc", (1,))
    for spec in codec.messages:
        assert not crc_ok(spec, bytes(spec.length))
        assert not crc_ok(spec, b"\xff" * spec.length)


def test_a_frame_of_another_message_is_no_good_frame():
    """Masquerade: every message of the set rejects every other's frames, at every counter."""
    codec = bind(Path(build.__file__).parent / "traction.dbc", (1,))
    lists = [spec.data_ids for spec in codec.messages]
    for one, other in itertools.combinations(lists, 2):
        assert all(a != b for a, b in zip(one, other, strict=True))


# ---- counter -----------------------------------------------------------------------------------


@pytest.mark.parametrize("spec", [P02, P05])
def test_counter_steps(spec):
    turn = COUNTERS[spec.profile]
    receiver = Receiver(spec)
    assert receiver.check(frame(spec, 250)) is Check.OK, "the first frame sets the counter"
    counter = 250
    for step, verdict, missed in (
        (1, Check.OK, 0),
        (2, Check.OK_SOME_LOST, 1),
        (3, Check.OK_SOME_LOST, 2),
        (0, Check.REPEATED, 0),
        (turn, Check.REPEATED, 0),
        (4, Check.WRONG_SEQUENCE, 0),
        (1, Check.OK, 0),
        (turn - 1, Check.WRONG_SEQUENCE, 0),
        (1, Check.OK, 0),
    ):
        counter += step
        assert receiver.check(frame(spec, counter)) is verdict
        assert receiver.missed == missed
    assert receiver.lost == 3
    assert counts_of(receiver) == (6, 0, 2, 2)


def test_a_corrupt_frame_does_not_move_the_counter():
    receiver = Receiver(P02)
    receiver.check(frame(P02, 3))
    broken = bytearray(frame(P02, 9))
    broken[5] ^= 1
    assert receiver.check(bytes(broken)) is Check.ERROR
    assert receiver.check(frame(P02, 4)) is Check.OK
    assert receiver.counts[Check.ERROR] == 1


@pytest.mark.parametrize("spec", [P02, P05])
def test_short_frames_are_errors_not_exceptions(spec):
    receiver = Receiver(spec)
    for size in range(8):
        assert receiver.check(frame(spec, 1)[:size]) is Check.ERROR
    assert not crc_ok(spec, b"")
    assert counter_of(spec, b"") is None
    assert receiver.state is SmState.NO_DATA
    with pytest.raises(ValueError, match="too short"):
        protect(spec, bytearray(1), 0)


@pytest.mark.parametrize("spec", [P02, P05])
def test_protection_touches_nothing_but_its_header(spec):
    header = {Profile.P02: "ff0f", Profile.P05: "ffffff"}[spec.profile]
    mask = bytes.fromhex(header).ljust(8 if spec is P02 else 64, b"\0")
    payload = bytearray(b"\x5a\xa5\xc3".ljust(len(mask), b"\x3c"))
    before = bytes(payload)
    protect(spec, payload, 7)
    assert all((a ^ b) & ~m == 0 for a, b, m in zip(before, payload, mask, strict=True))
    assert crc_ok(spec, payload)


@pytest.mark.parametrize("spec", [P02, P05])
def test_a_frame_that_is_all_header_is_a_frame(spec):
    payload = bytearray(HEADER_BYTES[spec.profile])
    protect(spec, payload, 3)
    assert crc_ok(spec, payload)
    assert counter_of(spec, payload) == 3
    assert Receiver(spec).check(bytes(payload)) is Check.OK


@pytest.mark.parametrize(("spec", "most"), [(P02, 16), (P05, 256)])
def test_a_counter_can_be_read_back(spec, most):
    for counter in (0, 1, most - 1, most, most + 7):
        assert counter_of(spec, frame(spec, counter)) == counter % most


def test_without_protection_everything_is_ok():
    receiver = Receiver(NONE)
    payload = bytearray(b"abc")
    protect(NONE, payload, 5)
    assert payload == b"abc"
    for k in range(1, 4):
        assert receiver.check(b"") is Check.OK
        assert receiver.counts[Check.OK] == k
    assert crc_ok(NONE, b"")
    assert counter_of(NONE, b"abc") is None


def test_the_profiles_are_those_of_the_standard():
    assert [p.value for p in Profile] == [0, 1, 2]
    assert HEADER_BYTES == {Profile.NONE: 0, Profile.P02: 2, Profile.P05: 3}
    assert COUNTERS == {Profile.NONE: 1, Profile.P02: 16, Profile.P05: 256}
    receiver = Receiver(P02)
    assert (receiver.missed, counts_of(receiver)) == (0, (0, 0, 0, 0))


@pytest.mark.parametrize("spec", [P02, P05])
def test_every_verdict_is_counted_once(spec):
    receiver = Receiver(spec)

    def counts():
        return (*counts_of(receiver), receiver.lost)

    wanted = {
        0: (1, 0, 0, 0, 0), 1: (2, 0, 0, 0, 0), 3: (3, 0, 0, 0, 1), 9: (3, 0, 0, 1, 1),
    }  # fmt: skip
    for counter, seen in wanted.items():
        receiver.check(frame(spec, counter))
        assert counts() == seen
    receiver.check(frame(spec, 9))
    assert counts() == (3, 0, 1, 1, 1)
    receiver.check(bytes(8 if spec is P02 else 64))
    receiver.check(b"")
    assert counts() == (3, 2, 1, 1, 1)


# ---- state machine -----------------------------------------------------------------------------

G, L, E, R, W, N = (
    Check.OK, Check.OK_SOME_LOST, Check.ERROR, Check.REPEATED, Check.WRONG_SEQUENCE,
    Check.NO_NEW_DATA,
)  # fmt: skip


def states(*verdicts):
    """States after each verdict: d(ata missing), i(nit), v(alid), x (invalid)."""
    receiver = Receiver(P02)
    return "".join("divx"[receiver.cycle(verdict)] for verdict in verdicts)


@pytest.mark.parametrize(
    ("verdicts", "wanted"),
    [
        ((N, N, E, N), "dddd"), ((G, G, G), "ivv"), ((L, L), "iv"), ((R, G, G), "iiv"),
        ((W, G, G), "iiv"), ((G, E), "ix"), ((E, G), "di"), ((E, G, G), "dix"),
        ((E, G, G, G, G, G), "dixxxv"), ((G, G, E, G, G), "ivvvv"), ((G, G, G, E, E), "ivvvx"),
        ((G, G, G, E, G, E), "ivvvvx"), ((G, G, G, G, G, N, N, N, N), "ivvvvvvvx"),
        ((G, G, G, G, G, R, R, R, R), "ivvvvvvvx"), ((G, G, G, G, G, W, W, W, W), "ivvvvvvvx"),
        ((G, G, G, E, E, G, G, G, G, G), "ivvvxxxxxv"), ((G, N, N, N, N, N, N), "iiiiiii"),
    ],
)  # fmt: skip
def test_paths_through_the_states(verdicts, wanted):
    assert states(*verdicts) == wanted


TRANSITIONS = {
    "NO_DATA": ["NO_DATA", "INIT"],
    "INIT": ["INIT", "VALID", "INVALID"],
    "VALID": ["VALID", "INVALID"],
    "INVALID": ["INVALID", "VALID"],
}


def test_every_transition_of_the_standard_happens_and_no_other():
    seen = set()
    for verdicts in itertools.product((G, E, N), repeat=7):
        receiver = Receiver(P02)
        before = receiver.state
        for verdict in verdicts:
            after = receiver.cycle(verdict)
            seen.add((before.name, after.name))
            before = after
    assert seen == {(state, after) for state, afters in TRANSITIONS.items() for after in afters}


def test_windows_are_those_of_the_promise():
    assert (WINDOW, MAX_DELTA) == (5, 3)
