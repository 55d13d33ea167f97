"""Codec: validity before scaling, what a frame must be to be decoded, saturation."""

import math
from pathlib import Path

import numpy as np
import pytest

from dbc import generate as build
from dbc.codec import bind
from dbc.frame import ERROR, EXTENDED, FD, REMOTE, Frame
from dbc.spec import NOT_AVAILABLE, RANGE, SATURATED, VALID, Match

FOLDER = Path(build.__file__).parent


@pytest.fixture(scope="module")
def codec():
    return bind(FOLDER / "traction.dbc", range(1, 17))


@pytest.fixture(scope="module")
def fd_codec():
    return bind(FOLDER / "traction_fd.dbc", range(1, 17))


def place(raw, start, length, size=8):
    return ((raw & ((1 << length) - 1)) << start).to_bytes(size, "little")


# The contract's "Not available" paragraph, raw value by raw value.
SIGNED_16 = [
    (32767, NOT_AVAILABLE), (32766, SATURATED), (32765, VALID), (0, VALID), (-32765, VALID),
    (-32766, SATURATED), (-32767, RANGE), (-32768, RANGE),
]  # fmt: skip
UNSIGNED_16 = [(0xFFFF, NOT_AVAILABLE), (0xFFFE, VALID), (0, VALID)]
TEMPERATURE = [(0xFFF, NOT_AVAILABLE), (3601, RANGE), (3600, VALID), (0, VALID), (0xFFE, RANGE)]
CASES = [
    ("Drive1_PhaseCurrents", "Ia", 16, 16, SIGNED_16),
    ("Drive1_StatorVoltages", "Ubeta", 32, 16, SIGNED_16),
    ("Drive1_StatorVoltages", "Udc", 48, 16, UNSIGNED_16),
    ("Drive1_Status", "Irms", 16, 16, UNSIGNED_16),
    ("Drive1_Motion", "Torque", 48, 16, SIGNED_16),
    (
        "Drive1_Motion", "Speed", 16, 16,
        [(32767, NOT_AVAILABLE), (32001, RANGE), (31999, VALID), (-31999, VALID), (-32001, RANGE)],
    ),
    (
        "Drive1_Motion", "ElectricalAngle", 32, 16,
        [(0xFFFF, NOT_AVAILABLE), (36000, RANGE), (35999, VALID), (0, VALID)],
    ),
    ("Drive1_Temperatures", "Tstator", 16, 12, TEMPERATURE),
    ("Drive1_Temperatures", "Tambient", 52, 12, TEMPERATURE),
    (
        "Drive1_PhaseCurrents", "Quality", 12, 4,
        [(15, NOT_AVAILABLE), (0, VALID), (1, VALID), (2, VALID), (3, RANGE), (14, RANGE)],
    ),
    ("Gateway_Adhesion", "Adhesion1", 16, 2, [(0, VALID), (1, VALID), (2, VALID), (3, RANGE)]),
    ("Gateway_Adhesion", "Age", 56, 8, [(255, NOT_AVAILABLE), (254, VALID), (0, VALID)]),
    ("Gateway_Status", "BusLoad", 52, 7, [(127, NOT_AVAILABLE), (100, VALID), (101, RANGE)]),
]  # fmt: skip


@pytest.mark.parametrize(("name", "column", "start", "length", "raws"), CASES)
def test_validity_is_judged_on_raw_values(codec, name, column, start, length, raws):
    spec = codec.by_name[name]
    k = spec.column(column)
    for raw, wanted in raws:
        data = place(raw, start, length)
        reading = codec.decode(spec, data)[column]
        assert (reading.raw, reading.validity) == (raw, wanted), raw
        row = np.frombuffer(data.ljust(64, b"\0"), np.uint8).reshape(1, 64)
        value, validity = codec.decode_rows(np.array([spec.index], np.int32), row)
        assert validity[0, k] == wanted
        assert value[0, k] == reading.value == raw * spec.signals[k].scale + spec.signals[k].offset


def test_samples_of_a_fd_frame(fd_codec):
    spec = fd_codec.by_name["Drive16_Samples"]
    signed_14 = [
        (0x1FFF, NOT_AVAILABLE), (8190, SATURATED), (8189, VALID), (-8190, SATURATED),
        (-8191, RANGE), (-8192, RANGE),
    ]  # fmt: skip
    for k in range(8):
        for j, name in enumerate(("Ia", "Ib", "Ualpha", "Ubeta")):
            for raw, wanted in signed_14:
                data = place(raw, 64 + 56 * k + 14 * j, 14, 64)
                reading = fd_codec.decode(spec, data)[f"{name}_{k}"]
                assert (reading.raw, reading.validity) == (raw, wanted)
    quality = fd_codec.decode(spec, place(15, 24, 8, 64))["Quality"]
    assert quality.validity == NOT_AVAILABLE
    assert fd_codec.decode(spec, place(0xFFFF, 32, 16, 64))["SampleIndex"].validity == RANGE
    assert fd_codec.decode(spec, place(65528, 32, 16, 64))["SampleIndex"].validity == VALID


@pytest.mark.parametrize(
    ("message", "own"),
    [
        ("Gateway_Adhesion", ()),
        ("Gateway_Faults", ("SensorFault", "CommFault", "EstimatorFault", "Overrun")),
    ],
)
def test_two_bit_states_are_antivalent(codec, message, own):
    """No single flipped bit of a flag frame turns bad into good; empty frames say unknown."""
    spec = codec.by_name[message]
    by_drive = message.removeprefix("Gateway_") if not own else "Thermal"
    flags = dict.fromkeys((*(f"{by_drive}{n}" for n in range(1, 17)), *own), 2)
    frame = codec.encode(spec, flags)
    assert all(codec.decode(spec, bytes(frame))[name].raw == 2 for name in flags)
    for bit in range(64):
        flipped = bytearray(frame)
        flipped[bit >> 3] ^= 1 << (bit & 7)
        readings = codec.decode(spec, bytes(flipped))
        assert all(readings[name].raw != 1 or readings[name].validity != VALID for name in flags)
    for empty in (bytes(8), b"\xff" * 8):
        readings = codec.decode(spec, empty)
        assert all(readings[name].raw in (0, 3) for name in flags)


def test_match_refuses_what_is_not_this_message(codec, fd_codec):
    good = Frame(0, 0x181, bytes(8))
    assert codec.match(good) == (Match.OK, codec.by_name["Drive1_PhaseCurrents"])
    assert codec.match(good._replace(data=bytes(7)))[0] is Match.WRONG_LENGTH
    assert codec.match(good._replace(data=b""))[0] is Match.WRONG_LENGTH
    assert codec.match(good._replace(flags=REMOTE, data=b""))[0] is Match.REMOTE
    assert codec.match(good._replace(flags=ERROR))[0] is Match.ERROR_FRAME
    assert codec.match(good._replace(flags=EXTENDED)) == (Match.UNKNOWN_ID, None)
    assert codec.match(good._replace(can_id=0x7FF)) == (Match.UNKNOWN_ID, None)
    assert codec.match(good._replace(flags=FD))[0] is Match.WRONG_FORMAT
    assert fd_codec.match(good)[0] is Match.WRONG_FORMAT
    assert fd_codec.match(Frame(0, 0x181, bytes(64), FD))[0] is Match.OK


def test_no_frame_of_wrong_kind_is_ever_a_message(codec):
    """Every id, every length, every kind: only the DBC's own combinations match."""
    lengths = {m.can_id: m.length for m in codec.messages}
    for can_id in range(0x800):
        for size in range(9):
            frame = Frame(0, can_id, bytes(size))
            assert (codec.match(frame)[0] is Match.OK) == (lengths.get(can_id) == size)
        for flags in (EXTENDED, REMOTE, ERROR, FD, ERROR | REMOTE, EXTENDED | FD):
            assert codec.match(Frame(0, can_id, bytes(8), flags))[0] is not Match.OK


def test_decode_needs_the_right_length(codec):
    spec = codec.by_name["Drive1_Motion"]
    with pytest.raises(ValueError, match="7 bytes, expected 8"):
        codec.decode(spec, bytes(7))


def test_encode_defaults_and_saturation(codec):
    spec = codec.by_name["Drive1_PhaseCurrents"]

    def raws(values):
        return {n: r.raw for n, r in codec.decode(spec, bytes(codec.encode(spec, values))).items()}

    start = {"Crc": 0, "Counter": 0, "Quality": 0, "Ia": 0x7FFF, "Ib": 0x7FFF, "Ic": 0x7FFF}
    assert raws({}) == start
    assert raws({"Ia": 1.0, "Quality": 1}) == {**start, "Ia": 50, "Quality": 1}
    for absent in (None, math.nan, math.inf, -math.inf):
        assert raws({"Ia": absent})["Ia"] == 0x7FFF
    assert raws({"Ia": 1e9, "Ib": -1e9})["Ia"] == 32766
    assert raws({"Ia": 1e9, "Ib": -1e9})["Ib"] == -32766
    assert raws({"Ia": 1.7e308, "Ib": -1.7e308})["Ib"] == -32766
    assert raws({"Ia": 655.33})["Ia"] == 32766, "never the not-available code"
    with pytest.raises(KeyError):
        codec.encode(spec, {"Id": 1.0})


def test_encode_of_flags_and_counts(codec):
    flags = codec.by_name["Gateway_Adhesion"]
    data = bytes(codec.encode(flags, {"Adhesion1": 1, "Adhesion16": 2, "Age": None}))
    readings = codec.decode(flags, data)
    assert [readings[f"Adhesion{n}"].raw for n in (1, 2, 16)] == [1, 0, 2]
    assert readings["Reason"].raw == 1
    assert readings["Age"].raw == 255
    assert codec.decode(flags, bytes(codec.encode(flags, {"Age": 1e6})))["Age"].raw == 254
    status = codec.by_name["Gateway_Status"]
    data = bytes(codec.encode(status, {"LostFrames": 10**9, "BusLoad": 250.0}))
    assert codec.decode(status, data)["LostFrames"].raw == 0xFFE
    assert codec.decode(status, data)["BusLoad"].raw == 100
