"""`dbc/decode.c` and `dbc/encode.c` equal the reference in plain Python, on any numbers."""

import copy
import math
from pathlib import Path

import numpy as np
import pytest
from _traction_core import ffi, lib

from dbc.codec import Codec, bind
from dbc.codec_tables import CodecTables
from dbc.contract import ANY
from dbc.e2e import configs
from dbc.spec import ABSENT, MessageSpec, Profile, SignalSpec, Validity
from gateway.settings.config import shipped_dbc
from tests.encode_loop import encode_rows, given_of
from tests.reference import codec as reference
from tests.reference import e2e as reference_e2e

FOREIGN = Path(__file__).parents[1] / "data" / "dbc"
FILES = (
    shipped_dbc("traction.dbc"), shipped_dbc("traction_fd.dbc"),
    FOREIGN / "cantools_multiplex_2.dbc", FOREIGN / "cantools_issue_636_negative_scaling.dbc",
)  # fmt: skip
ODD = (0.0, -0.0, 0.5, -0.5, 1.5, 2.5, 1e308, -1e308, 2.0**53 + 2, -(2.0**62), 2.0**63, -(2.0**63),
       1.5 * 2.0**63, 2.0**64, math.inf, -math.inf, math.nan)  # fmt: skip


def of(*signals, size=64):
    """A codec of one message."""
    spec = MessageSpec("M", 1, size, True, False, 0, Profile.NONE, b"", signals, 0, 0, "M")
    return Codec(Path("one.dbc"), [spec])


def limits(start, length, **more):
    """An integer whose range is that of its type."""
    signed = more.get("is_signed", False)
    low = -(1 << (length - 1)) if signed else 0
    more = {"raw_min": low, "raw_max": low + (1 << length) - 1, **more}
    return SignalSpec(f"S{start}", start, length, **more)


def start_of(first, big):
    """Where a DBC has the signal begin whose bits begin here in its own order."""
    return 8 * (first >> 3) + 7 - (first & 7) if big else first


def assert_decodes_as_the_reference(codec, payload, message=0):
    index = np.full(len(payload), message, np.int32)
    value, validity = codec.decode_rows(index, payload)
    plain_value, plain_validity = reference.decode_rows(codec, index.tolist(), payload)
    assert np.array_equal(value, plain_value, equal_nan=True)
    assert np.array_equal(validity, plain_validity)
    spec = codec.messages[message]
    for row in payload[:3]:
        data = row.tobytes()[: spec.length]
        one, plain = codec.decode(spec, data), reference.decode(spec, data)
        assert list(one) == list(plain)
        for name, reading in one.items():
            assert reading.validity == plain[name].validity
            if not isinstance(reading.raw, float):
                assert reading.raw == plain[name].raw


def assert_encodes_as_the_reference(codec, values):
    spec = codec.messages[0]
    assert codec.encode(spec, values) == reference.encode(spec, values), values


def random_payload(rng, spec, rows):
    payload = np.zeros((rows, 64), np.uint8)
    payload[:, : spec.length] = rng.integers(0, 256, (rows, spec.length))
    payload[0], payload[1, : spec.length] = 0, 0xFF
    return payload


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_random_frames_of_every_message(path):
    codec = bind(path, (), ANY)
    rng = np.random.default_rng(1)
    for spec in codec.messages:
        assert_decodes_as_the_reference(codec, random_payload(rng, spec, 8), spec.index)


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("signed", [False, True])
def test_every_place_and_width(big, signed):
    """At both ends of the 64 bytes, on the byte grid and off it, up to nine bytes wide."""
    rng = np.random.default_rng(2)
    for length in (1, 2, 7, 8, 9, 31, 32, 56, 57, 58, 63, 64):
        for first in {*range(17), 100, *range(512 - length - 9, 513 - length)}:
            if not 0 <= first <= 512 - length:
                continue
            codec = of(limits(start_of(first, big), length, is_signed=signed, is_big_endian=big,
                              scale=0.5, offset=-3.0))  # fmt: skip
            assert_decodes_as_the_reference(codec, random_payload(rng, codec.messages[0], 4))
            name = codec.messages[0].signals[0].name
            low, high = codec.messages[0].signals[0].raw_min, codec.messages[0].signals[0].raw_max
            for raw in (low, high, 0, 1, high // 3, low / 3, 2.5):
                assert_encodes_as_the_reference(codec, {name: raw * 0.5 - 3.0})


def test_a_signal_that_ends_behind_the_frame_is_refused():
    assert of(limits(500, 12), size=64).width == 1
    with pytest.raises(ValueError, match="S501: ends behind 64 bytes"):
        of(limits(501, 12))


@pytest.mark.parametrize("length", [32, 64])
@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize(("scale", "offset"), [(1.0, 0.0), (-0.5, 4.0), (1e-300, 0.0)])
def test_floats(length, big, scale, offset):
    """NaN, infinity, any exponent, on the byte grid and off it; ranges of both directions."""
    rng = np.random.default_rng(3)
    for first in (0, 3, 64, 512 - length):
        for low, high in (SignalSpec.float_limits(), (-10.0, 20.0)):
            signal = SignalSpec("F", start_of(first, big), length, True, big, scale, offset,
                                is_float=True, float_min=low, float_max=high)  # fmt: skip
            codec = of(signal)
            payload = random_payload(rng, codec.messages[0], 40)
            kind = np.float32 if length == 32 else np.float64
            for row, number in zip(payload[2:], (*ODD, low, high, 1.25, -7.5), strict=False):
                with np.errstate(over="ignore"):
                    bits = kind(number).view(f"u{length // 8}").item()
                row[:] = _placed(signal, bits)
            with np.errstate(over="ignore", invalid="ignore"):
                assert_decodes_as_the_reference(codec, payload)
            for number in (*ODD, low, high, 1.25, None):
                assert_encodes_as_the_reference(codec, {"F": number})


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_range_beyond_single_precision_ends_with_it(sign):
    low, high = sorted((sign * 1e300, sign * 2e300))
    signal = SignalSpec("F", 0, 32, True, is_float=True, float_min=low, float_max=high)
    codec = of(signal)
    for number in (0.0, 1e299, -1e299, 1.5e300, -1.5e300):
        made = codec.decode(
            codec.messages[0], bytes(codec.encode(codec.messages[0], {"F": number}))
        )
        assert made["F"].value == sign * float(np.finfo(np.float32).max)


def _placed(signal, bits):
    first = signal.start
    if signal.is_big_endian:
        first = 8 * (first >> 3) + 7 - (first & 7)
        data = (bits << (512 - first - signal.length)).to_bytes(64, "big")
    else:
        data = (bits << first).to_bytes(64, "little")
    return np.frombuffer(data, np.uint8)


def test_raw_value_of_a_float_is_the_number():
    for length, kind in ((32, np.float32), (64, np.float64)):
        codec = of(SignalSpec("F", 0, length, True, is_float=True, scale=2.0))
        data = kind(-1.375).tobytes().ljust(64, b"\0")
        assert codec.decode(codec.messages[0], data)["F"][:2] == (-1.375, -2.75)


@pytest.mark.parametrize("length", [8, 53, 64])
@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("none", [None, "top"])
def test_ranges_and_codes(length, signed, none):
    """Raw values at every edge: decoded, and encoded from numbers beyond it."""
    low = -(1 << (length - 1)) if signed else 0
    top = low + (1 << length) - 1
    for inside in (0, 3):
        signal = limits(8, length, is_signed=signed, raw_min=low + inside, raw_max=top - 1 - inside,
                        not_available=top if none else None, start_raw=low + 7)  # fmt: skip
        codec = of(signal)
        raws = {
            raw + k for raw in (low, top, low + inside, top - 1 - inside, 0) for k in range(-3, 4)
        }
        raws = sorted(raw for raw in raws if low <= raw <= top)
        mask = (1 << length) - 1
        payload = np.array([_placed(signal, raw & mask) for raw in raws])
        assert_decodes_as_the_reference(codec, payload)
        for number in (*map(float, raws), *ODD, None):
            assert_encodes_as_the_reference(codec, {signal.name: number})
        assert_encodes_as_the_reference(codec, {})


def test_a_code_inside_the_range_is_the_code():
    """`bind` refuses such a DBC; here it is decoded all the same."""
    for none in (0, 1, 4, 9, 10):
        for signed in (False, True):
            codec = of(SignalSpec("S", 0, 8, signed, raw_min=1, raw_max=9, not_available=none))
            payload = np.zeros((256, 64), np.uint8)
            payload[:, 0] = range(256)
            assert_decodes_as_the_reference(codec, payload)


def test_halves_are_rounded_to_even():
    codec = of(limits(0, 64, is_signed=True), limits(64, 64), limits(128, 12, is_signed=True))
    for k in range(-9, 10):
        for number in (k + 0.5, k + 0.25, float(k), math.nextafter(k + 0.5, 99), 2.0**52 + k,
                       2.0**51 + k + 0.5, -(2.0**51) + k + 0.5, 2.0**53 + 2 * k):  # fmt: skip
            names = [signal.name for signal in codec.messages[0].signals]
            assert_encodes_as_the_reference(codec, dict.fromkeys(names, number))


def multiplexed(bits, signed=False, more=0):
    """A selector S0 of so many bits; S16 at its values -1 to 1, S24 at 2 and 5, S32 always."""
    always = [limits(48 + k, 1) for k in range(more)]
    return of(
        limits(0, bits, is_signed=signed, start_raw=1),
        limits(16, 8, mux_parent="S0", mux_ranges=((-1, 1),), start_raw=0x55),
        limits(24, 8, mux_parent="S0", mux_ranges=((2, 2), (5, 5)), start_raw=0x66),
        limits(32, 8, start_raw=0x77), *always,
    )  # fmt: skip


@pytest.mark.parametrize("bits", [3, 8, 9, 16])
@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("more", [0, 60, 61])
def test_multiplexed_signals(bits, signed, more):
    """Listed by the selector's value where these and the signals are few; else looked up."""
    codec = multiplexed(bits, signed, more)
    assert codec.tables.messages["is_listed"].tolist() == [int(bits <= 8 and more <= 60)]
    payload = np.full((1 << bits, 64), 0x3C, np.uint8)
    payload.view("<u2")[:, 0] = range(1 << bits)
    assert_decodes_as_the_reference(codec, payload[:300])
    assert_decodes_as_the_reference(codec, payload[-300:])
    for selector in (None, 0, 1, 2, 3, 4, 5, 6, -1, -2, 1e9):
        for values in ({}, {"S16": 9, "S24": 17, "S32": 33}):
            given = values if selector is None else {**values, "S0": selector}
            assert_encodes_as_the_reference(codec, given)


def test_selectors_of_selectors():
    """Absent if any selector above says so, also where the others do not."""
    codec = of(
        limits(0, 4, mux_parent="S4", mux_ranges=((1, 2), (4, 4)), start_raw=2),
        limits(4, 4, start_raw=3),
        limits(8, 8, mux_parent="S0", mux_ranges=((2, 7),), start_raw=0x44),
        limits(16, 8, mux_parent="S8", mux_ranges=((0, 200),), start_raw=0x99),
        limits(24, 8, mux_parent="S4", mux_ranges=((0, 9),), start_raw=0x11),
    )
    payload = np.zeros((4096, 64), np.uint8)
    payload[:, 0] = np.arange(4096)
    payload[:, 1] = 40 + 30 * (np.arange(4096) // 256 % 16)
    payload[:, 2] = 5
    assert_decodes_as_the_reference(codec, payload)
    absent = codec.decode_rows(np.zeros(4096, np.int32), payload)[1] == ABSENT
    assert absent.any(axis=0).tolist() == [True, False, True, True, True]
    for s4 in range(16):
        for s0 in (None, 0, 1, 2, 7, 8):
            for s8 in (None, 10, 250):
                values = {"S4": s4, "S0": s0, "S8": s8, "S16": 7}
                given = {name: number for name, number in values.items() if number is not None}
                assert_encodes_as_the_reference(codec, given)


def test_numbers_that_are_no_message_and_unused_columns():
    codec = bind(shipped_dbc("traction.dbc"), (1, 2))
    n = len(codec.messages)
    payload = np.zeros((6, 64), np.uint8)
    index = np.array([0, -1, n - 1, n, 2**31 - 1, -(2**31)], np.int32)
    value, validity = codec.decode_rows(index, payload)
    plain = reference.decode_rows(codec, index.tolist(), payload)
    assert np.array_equal(value, plain[0], equal_nan=True)
    assert np.array_equal(validity, plain[1])
    assert (validity[[1, 3, 4, 5]] == ABSENT).all()


def test_nothing_is_written_beside_the_rows():
    codec = bind(shipped_dbc("traction_fd.dbc"), (1,))
    value, validity = np.full(5 * codec.width, 7.0), np.full(5 * codec.width, 7, np.uint8)
    message = ffi.new("int32_t[]", [0, 1, 2])
    lib.decode_frames(
        codec.tables.pointer, 3, message, bytes(192),
        ffi.from_buffer("double[]", value[codec.width :]),
        ffi.from_buffer("uint8_t[]", validity[codec.width :]),
    )  # fmt: skip
    for rows in (value.reshape(5, -1), validity.reshape(5, -1)):
        assert (rows[[0, 4]] == 7).all()
        assert (rows[1:4] != 7).all()


def test_frames_of_one_message_at_a_time_are_the_same_as_one_by_one():
    codec = bind(shipped_dbc("traction.dbc"), (1, 2))
    spec = codec.by_name["Drive2_PhaseCurrents"]
    names = ("Ic", "Ia")
    rng = np.random.default_rng(4)
    values = rng.normal(0.0, 1.0, (400, 2)) * rng.choice([1, 50, 1e3, 1e9], (400, 1))
    values[rng.random(values.shape) < 0.05] = np.nan
    values[rng.random(values.shape) < 0.02] = np.inf
    scale = np.array([spec.signals[spec.column(name)].scale for name in names])
    values[:50] = (rng.integers(-300, 300, (50, 2)) + 0.5) * scale
    for row, payload in zip(values, codec.encode_rows(spec, names, values), strict=True):
        given = dict(zip(names, row.tolist(), strict=True))
        assert payload == codec.encode(spec, given) == reference.encode(spec, given)
    with pytest.raises(KeyError):
        codec.encode_rows(spec, ["Nothing"], values[:, :1])


@pytest.mark.parametrize("name", ["traction.dbc", "traction_fd.dbc"])
def test_frames_in_a_compiled_loop_are_the_same(name):
    """Encoded and protected, any part of the signals, within and beyond every range."""
    codec = bind(shipped_dbc(name), (), ANY)
    specs, tables = codec.messages, codec.tables
    rng = np.random.default_rng(5)
    for share in (0.0, 0.5, 1.0):
        given = {
            spec.name: [s.name for s in spec.signals[2:] if rng.random() <= share] for spec in specs
        }
        value = np.zeros((len(specs), codec.width))
        for row, spec in zip(value, specs, strict=True):
            for k, s in enumerate(spec.signals):
                low, high = (raw * s.scale + s.offset for raw in (s.raw_min, s.raw_max))
                row[k] = rng.uniform(low - 0.1 * (high - low), high + 0.1 * (high - low))
        payload = np.full((len(specs), 64), 0xAA, np.uint8)
        encode_rows(
            np.arange(len(specs)), value, np.full(len(specs), 77), tables.address,
            given_of(specs, given), configs(specs), payload,
        )  # fmt: skip
        for row, made, spec in zip(value, payload, specs, strict=True):
            plain = reference.encode(spec, {n: row[spec.column(n)] for n in given[spec.name]})
            reference_e2e.protect(spec, plain, 77 % (256 if spec.profile == Profile.P05 else 16))
            assert made.tobytes() == bytes(plain).ljust(64, b"\0")


def test_a_scale_of_zero_costs_no_more_than_a_wrong_answer():
    """`bind` refuses it; memory could hold it."""
    for signal in (limits(0, 16, is_signed=True, scale=0.0), limits(0, 64, scale=0.0),
                   SignalSpec("S0", 0, 32, True, is_float=True, scale=0.0)):  # fmt: skip
        codec = of(signal)
        for number in (0.0, 1.0, -1.0):
            assert len(codec.encode(codec.messages[0], {signal.name: number})) == 64


def test_numbers_of_validities_are_the_headers():
    # The core has no code for NaN and infinite floats.
    assert Validity.NOT_A_NUMBER not in range(5)
    assert {v.name: v.value for v in Validity if v is not Validity.NOT_A_NUMBER} == {
        "VALID": 0, "NOT_AVAILABLE": 1, "RANGE": 2, "SATURATED": 3, "ABSENT": 4,
    }  # fmt: skip


def test_a_copy_of_tables_is_themselves():
    tables = CodecTables(())
    assert copy.deepcopy(tables) is tables
    assert tables.width == 0
