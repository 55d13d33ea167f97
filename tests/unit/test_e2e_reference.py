"""`dbc/e2e.c` equals the library and the reference receiver, on good, damaged and random frames."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from _traction_core import ffi, lib

from dbc import e2e
from dbc.codec import bind
from dbc.e2e import HEADER_BYTES, Check, SmState, configs, states
from dbc.records import E2E_CONFIG, E2E_STATE, pointer
from dbc.spec import Profile
from gateway.settings.config import shipped_dbc
from tests.reference import e2e as reference

SPECS = [
    next(m for m in bind(shipped_dbc(file), (1, 2)).messages if m.name == name)
    for file, name in (
        ("traction.dbc", "Drive1_PhaseCurrents"),
        ("traction.dbc", "Drive2_Temperatures"),
        ("traction_fd.dbc", "Drive2_Samples"),
    )
]
CONFIGS = configs(SPECS)


def frame(spec, counter, rng):
    payload = bytearray(rng.integers(0, 256, spec.length, dtype=np.uint8).tobytes())
    reference.protect(spec, payload, counter)
    return payload


def rows(payload, at=0):
    """Three frames of 64 bytes, this one in a row of its own."""
    found = np.full((3, 64), 0xA5, np.uint8)
    found[at] = np.frombuffer(bytes(payload).ljust(64, b"\0"), dtype=np.uint8)
    return found


def e2e_check(data, row, c, config, state):
    """Of the frame in a row of data, by the records of message c."""
    return lib.e2e_check(
        pointer("struct e2e_config", config) + c, pointer("struct e2e_state", state) + c,
        pointer("uint8_t", data[row]),
    )  # fmt: skip


def e2e_sm_check(c, status, state):
    return lib.e2e_sm_check(pointer("struct e2e_state", state) + c, status)


def e2e_protect(data, row, c, counter, config):
    lib.e2e_protect(
        pointer("struct e2e_config", config) + c, pointer("uint8_t", data[row]), counter
    )


def test_the_numbers_are_those_of_the_reference():
    for ours, theirs in ((Check, reference.Check), (SmState, reference.SmState)):
        assert {x.name: x.value for x in ours} == {x.name: x.value for x in theirs}
    assert (e2e.WINDOW, e2e.MAX_DELTA) == (reference.WINDOW, reference.MAX_DELTA)


@pytest.mark.parametrize("c", range(3))
def test_checksums_equal_the_library(c):
    """Of every length, right and with one bit turned."""
    rng = np.random.default_rng(c)
    for length in range(HEADER_BYTES[SPECS[c].profile], SPECS[c].length + 1):
        spec = replace(SPECS[c], length=length)
        for k in range(40):
            payload = frame(spec, k, rng)
            payload[rng.integers(length)] ^= (k % 2) << int(rng.integers(8))
            assert e2e.crc_ok(spec, payload) == reference.crc_ok(spec, payload) == (k % 2 == 0)


@pytest.mark.parametrize("c", range(3))
def test_what_is_protected_in_a_loop_is_what_the_library_protects(c):
    rng = np.random.default_rng(c)
    for k in range(600):
        plain = bytearray(rng.integers(0, 256, SPECS[c].length, dtype=np.uint8).tobytes())
        three = rows(plain, at=1)
        e2e_protect(three, 1, c, k & 0xFF, CONFIGS)
        reference.protect(SPECS[c], plain, k)
        assert (three == rows(plain, at=1)).all()


def test_frames_shorter_than_their_header_do_not_fit():
    """Not even where the checksum of what there is would."""
    for c, header in ((0, 2), (2, 3)):
        short, fits = CONFIGS[[c]].copy(), set()
        for length in range(header + 1):
            short["length"] = length
            config = ffi.from_buffer("struct e2e_config *", short)
            for checksum in range(256 if header == 2 else 65536):
                data = checksum.to_bytes(header - 1, "little") + bytes(61)
                if lib.e2e_crc_fits(config, data):
                    fits.add(length)
            room = ffi.new("uint8_t[64]", bytes(range(64)))
            lib.e2e_protect(config, room, 9)
            assert (bytes(room) != bytes(range(64))) == (length == header), "nor are they touched"
        assert fits == {header}


@pytest.mark.parametrize("c", range(3))
@pytest.mark.parametrize("seed", range(5))
def test_results_and_states_equal_the_reference(c, seed):
    """A sender that loses, repeats, damages, restarts and falls silent."""
    rng = np.random.default_rng((c, seed))
    spec, receiver, state = SPECS[c], reference.Receiver(SPECS[c]), states(3)
    others = np.delete(state, c)
    counter, seen, checks = 0, set(), set()
    for _ in range(3000):
        roll = rng.choice(["good", "lose", "repeat", "damage", "jump", "silent"],
                          p=[0.8, 0.06, 0.04, 0.04, 0.02, 0.04])  # fmt: skip
        step = {"lose": int(rng.integers(2, 6)), "repeat": 0, "jump": int(rng.integers(256))}
        counter += step.get(roll, 1)
        if roll == "silent":
            check = reference.Check.NO_NEW_DATA
        else:
            payload = frame(spec, counter % (256 if spec.profile == Profile.P05 else 16), rng)
            if roll == "damage":
                payload[0] ^= 0x10
            check = receiver.check(bytes(payload))
            assert e2e_check(rows(payload, at=2), 2, c, CONFIGS, state) == check
            assert state[c]["missed"] == receiver.missed
        assert e2e_sm_check(c, int(check), state) == receiver.cycle(check) == state[c]["state"]
        seen.add(receiver.state)
        checks.add(check)
    assert checks == set(reference.Check)
    assert seen == set(reference.SmState) - {reference.SmState.NO_DATA}
    assert (np.delete(state, c) == others).all()


def test_the_state_machine_equals_the_reference_on_every_sequence_of_six_cycles():
    for sequence in product(Check, repeat=6):
        receiver, state = reference.Receiver(SPECS[0]), ffi.new("struct e2e_state *")
        lib.e2e_reset(state)
        for check in sequence:
            assert lib.e2e_sm_check(state, check) == receiver.cycle(reference.Check(check))


def test_without_protection_every_frame_is_good():
    """And whatever the last one proved lost is no more."""
    plain, state = CONFIGS.copy(), states(3)
    plain["profile"] = Profile.NONE
    state["missed"] = 2
    assert e2e_check(rows(b""), 0, 1, plain, state) == Check.OK
    assert state["missed"].tolist() == [2, 0, 2]
    assert state["counter"].tolist() == [-1, -1, -1]
    pointer = ffi.from_buffer("struct e2e_config[]", plain)
    assert lib.e2e_crc_fits(ffi.addressof(pointer[0]), b"") == 1
    three = rows(b"\1\2\3")
    e2e_protect(three, 0, 1, 7, plain)
    assert (three == rows(b"\1\2\3")).all()


def test_steps_of_the_counter():
    """1 for the first frame and the next, a whole turn for the same once more."""
    for c, turn in ((0, 16), (2, 256)):
        state = states(3)
        for counter, step in ((5, 1), (6, 1), (6, turn), (8, 2), (7, turn - 1)):
            payload = frame(SPECS[c], counter, np.random.default_rng(1))
            e2e_check(rows(payload), 0, c, CONFIGS, state)
            assert state[c]["step"] == step


def test_damaged_records_cost_no_more_than_a_wrong_answer():
    """Every value that memory could hold: what comes back is a status and a state all the same."""
    rng = np.random.default_rng(6)
    for _ in range(20_000):
        config = np.frombuffer(rng.bytes(E2E_CONFIG.itemsize), E2E_CONFIG).copy()
        config["length"] %= 65  # of a frame in 64 bytes of room: held by whoever made the record
        state = np.frombuffer(rng.bytes(E2E_STATE.itemsize), E2E_STATE).copy()
        config["profile"] %= 4
        data = rows(rng.bytes(64))
        status = e2e_check(data, 0, 0, config, state)
        assert status in list(Check)
        assert e2e_sm_check(0, status, state) in list(SmState)
        e2e_protect(data, 0, 0, 3, config)
        assert (data[1:] == 0xA5).all()
