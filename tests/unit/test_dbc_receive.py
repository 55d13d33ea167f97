"""Compiled protection equals the library and `Receiver`, on good, damaged and random frames."""

from dataclasses import replace

import numpy as np
import pytest

from dbc import _receive_kernels as kernels
from dbc._receive_kernels import crc_fits, cycle, judge
from dbc.codec import bind
from dbc.protection import (
    HEADER_BYTES,
    MAX_DELTA,
    WINDOW,
    Check,
    Profile,
    Receiver,
    SmState,
    crc_ok,
    protect,
)
from dbc.receive import guard, window
from gateway.config import shipped_dbc

SPECS = [
    next(m for m in bind(shipped_dbc(file), (1, 2)).messages if m.name == name)
    for file, name in (
        ("traction.dbc", "Drive1_PhaseCurrents"),
        ("traction.dbc", "Drive2_Temperatures"),
        ("traction_fd.dbc", "Drive2_Samples"),
    )
]
GUARD = guard(SPECS)


def frame(spec, counter, rng):
    payload = bytearray(rng.integers(0, 256, spec.length, dtype=np.uint8).tobytes())
    protect(spec, payload, counter)
    return payload


def rows(payload):
    return np.frombuffer(bytes(payload).ljust(64, b"\0"), dtype=np.uint8).reshape(1, 64)


@pytest.mark.parametrize("c", range(3))
def test_checksum_equals_the_library(c):
    rng = np.random.default_rng(c)
    spec, fits = SPECS[c], 0
    for k in range(2000):
        payload = frame(spec, k, rng)
        if k % 3 == 0:
            payload[rng.integers(spec.length)] ^= 1 << int(rng.integers(8))
        assert crc_fits(rows(payload), 0, c, GUARD) == crc_ok(spec, payload)
        fits += crc_ok(spec, payload)
    assert 1300 < fits < 1400


@pytest.mark.parametrize("c", [0, 2])
def test_checksum_of_every_length_equals_the_library(c):
    rng = np.random.default_rng(c)
    for length in range(HEADER_BYTES[SPECS[c].profile], SPECS[c].length + 1):
        spec = replace(SPECS[c], length=length)
        own = guard([spec])
        for k in range(6):
            payload = frame(spec, k, rng)
            payload[rng.integers(length)] ^= k % 2
            assert crc_fits(rows(payload), 0, 0, own) == crc_ok(spec, payload) == (k % 2 == 0)


def test_frames_shorter_than_their_header_do_not_fit():
    short = GUARD._replace(length=np.array([1, 0, 2]))
    assert not any(crc_fits(rows(b"\0\0"), 0, c, short) for c in range(3))
    # Not even where the checksum of what there is would.
    one = rows(bytes([kernels.sum_p02(rows(b""), 0, 0, short)]))
    two = rows(int(kernels.sum_p05(rows(b""), 0, 2, short)).to_bytes(2, "little"))
    assert not crc_fits(one, 0, 0, short)
    assert not crc_fits(two, 0, 2, short)


@pytest.mark.parametrize("c", range(3))
@pytest.mark.parametrize("seed", range(5))
def test_verdicts_and_states_equal_the_receiver(c, seed):
    """A sender that loses, repeats, damages, restarts and falls silent."""
    rng = np.random.default_rng((c, seed))
    spec, receiver, memory = SPECS[c], Receiver(SPECS[c]), window(3)
    counter, states, checks = 0, set(), set()
    for _ in range(3000):
        roll = rng.choice(["good", "lose", "repeat", "damage", "jump", "silent"],
                          p=[0.8, 0.06, 0.04, 0.04, 0.02, 0.04])  # fmt: skip
        step = {"lose": int(rng.integers(2, 6)), "repeat": 0, "jump": int(rng.integers(256))}
        counter += step.get(roll, 1)
        if roll == "silent":
            check = Check.NO_NEW_DATA
        else:
            payload = frame(spec, counter % (256 if spec.profile is Profile.P05 else 16), rng)
            if roll == "damage":
                payload[0] ^= 0x10
            check = receiver.check(bytes(payload))
            assert judge(rows(payload), 0, c, GUARD, memory) == check
            assert memory.missed[c] == receiver.missed
        assert cycle(c, int(check), memory) == receiver.cycle(check)
        assert (memory.oks[c], memory.errors[c]) == (receiver.oks_seen, receiver.errors_seen)
        states.add(receiver.state)
        checks.add(check)
    assert checks == set(Check)
    assert states == set(SmState) - {SmState.NO_DATA}


def test_the_numbers_are_those_of_the_words():
    checks = ("OK", "SOME_LOST", "ERROR", "REPEATED", "WRONG_SEQUENCE", "NO_NEW_DATA")
    assert [getattr(kernels, f"_{name}") for name in checks] == list(Check)
    assert [getattr(kernels, f"_{state.name}") for state in SmState] == list(SmState)
    assert (kernels._NONE, kernels._P02) == (Profile.NONE, Profile.P02)
    assert (kernels._MAX_DELTA, kernels._WINDOW) == (MAX_DELTA, WINDOW)


def test_without_protection_every_frame_is_good():
    """And whatever the last one proved lost is no more."""
    plain, memory = GUARD._replace(profile=np.zeros(3, dtype=np.int64)), window(3)
    memory.missed[:] = 2
    assert judge(rows(b""), 0, 1, plain, memory) == Check.OK
    assert memory.missed.tolist() == [2, 0, 2]


def test_silence_after_the_start_is_no_data():
    memory = window(3)
    for check in (Check.NO_NEW_DATA, Check.ERROR):
        assert cycle(1, int(check), memory) == SmState.NO_DATA
    assert cycle(1, int(Check.REPEATED), memory) == SmState.INIT


def test_compiled_equals_uncompiled():
    rng = np.random.default_rng(9)
    uncompiled = getattr(crc_fits, "py_func", crc_fits)
    for c, spec in enumerate(SPECS):
        for k in range(50):
            payload = frame(spec, k, rng)
            payload[3] ^= k % 2
            one = rows(payload)
            assert crc_fits(one, 0, c, GUARD) == uncompiled(one, 0, c, GUARD)
