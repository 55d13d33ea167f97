"""What a raw value says of itself, and what a message is known by. `make mutation` runs these."""

import dataclasses
import struct
import sys
from pathlib import Path

import pytest

from dbc import spec
from dbc.codec import Codec
from dbc.spec import DbcMismatch, Match, MessageSpec, Profile, SignalSpec, Validity

SIGNED = SignalSpec(
    "T", 0, 8, is_signed=True, scale=0.5, offset=-3.0, raw_min=-100, raw_max=90, not_available=-128
)
UNSIGNED = SignalSpec("U", 0, 8, raw_min=1, raw_max=250, not_available=255)
PLAIN = SignalSpec("P", 0, 8, is_signed=True, raw_min=-5, raw_max=5)
FLOAT = SignalSpec("F", 0, 32, is_float=True, is_signed=True, scale=0.5, offset=1.0,
                   float_min=-3.0, float_max=5.0, not_available=1)  # fmt: skip


@pytest.mark.parametrize(
    ("signal", "raw", "validity"),
    [
        (SIGNED, 0, Validity.VALID), (SIGNED, -99, Validity.VALID), (SIGNED, 89, Validity.VALID),
        (SIGNED, -100, Validity.SATURATED), (SIGNED, 90, Validity.SATURATED),
        (SIGNED, -101, Validity.RANGE), (SIGNED, 91, Validity.RANGE),
        (SIGNED, int("-128"), Validity.NOT_AVAILABLE), (UNSIGNED, 1, Validity.VALID),
        (UNSIGNED, 250, Validity.VALID), (UNSIGNED, 0, Validity.RANGE),
        (UNSIGNED, 251, Validity.RANGE), (UNSIGNED, 255, Validity.NOT_AVAILABLE),
        (PLAIN, -5, Validity.VALID), (PLAIN, 5, Validity.VALID), (PLAIN, 6, Validity.RANGE),
        (FLOAT, -8.0, Validity.VALID), (FLOAT, 8.0, Validity.VALID), (FLOAT, 1.0, Validity.VALID),
        (FLOAT, -8.01, Validity.RANGE), (FLOAT, 8.01, Validity.RANGE),
        (FLOAT, float("nan"), Validity.NOT_A_NUMBER), (FLOAT, float("inf"), Validity.NOT_A_NUMBER),
    ],
)  # fmt: skip
def test_a_raw_value_says_what_it_is(signal, raw, validity):
    one = MessageSpec("M", 1, 8, False, False, 0, Profile.NONE, b"", (signal,), 0, 0, "M")
    data = struct.pack("<f", raw) if signal.is_float else (raw & 0xFF).to_bytes(1, "little")
    reading = Codec(Path("one.dbc"), [one]).decode(one, data.ljust(8, b"\0"))[signal.name]
    assert reading.validity is validity
    if validity is Validity.VALID and not signal.is_float:
        assert reading == (raw, raw * signal.scale + signal.offset, validity)


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("floating", [False, True])
@pytest.mark.parametrize("code", [None, 0, 7])
def test_the_ends_mean_or_beyond_only_of_signed_integers_with_a_code_for_none(
    signed, floating, code
):
    signal = SignalSpec("S", 0, 16, is_signed=signed, is_float=floating, not_available=code)
    assert signal.saturates is (signed and not floating and code is not None)


def test_numbers_of_validities_and_matches():
    assert [code.value for code in Validity] == list(range(6))
    names = ("VALID", "NOT_AVAILABLE", "RANGE", "SATURATED", "ABSENT")
    for number, name in enumerate(names):
        assert getattr(spec, name) == Validity[name] == number
    assert [int(match) for match in Match] == list(range(6))
    assert Match.OK == 0


def test_what_is_not_said_of_a_signal():
    signal = SignalSpec("S", 3, 5)
    largest = sys.float_info.max
    assert dataclasses.astuple(signal) == (
        "S", 3, 5, False, False, 1.0, 0.0, "", 0, 0, None, 0, {}, False, -largest, largest, None,
        (),
    )  # fmt: skip
    assert SignalSpec.float_limits() == (-largest, largest)
    with pytest.raises(dataclasses.FrozenInstanceError):
        signal.scale = 2.0
    assert not hasattr(signal, "__dict__")


def message(**more):
    return MessageSpec("Drive3_Motion", 0x122, 8, False, False, 10, Profile.NONE, b"",
                       (SIGNED, UNSIGNED, PLAIN), 0, 3, "Motion", **more)  # fmt: skip


def test_a_message_is_known_by_its_identifier_and_how_long_that_is():
    assert message().key == 0x122
    assert message(is_extended=True).key == 0x8000_0122
    assert not any((message().is_extended, message().is_gateway, message().is_either))
    with pytest.raises(dataclasses.FrozenInstanceError):
        message().can_id = 1
    assert not hasattr(message(), "__dict__")


@pytest.mark.parametrize(("is_fd", "is_either", "classic", "fd"), [
    (False, False, True, False), (True, False, False, True), (False, True, True, True),
])  # fmt: skip
def test_a_message_comes_in_frames_of_its_own_format(is_fd, is_either, classic, fd):
    one = dataclasses.replace(message(), is_fd=is_fd, is_either=is_either)
    assert (one.has_format(False), one.has_format(True)) == (classic, fd)


def test_columns_are_found_by_name():
    assert [message().column(name) for name in "TUP"] == [0, 1, 2]
    with pytest.raises(KeyError, match="Drive3_Motion\\.X"):
        message().column("X")


def test_a_mismatch_lists_its_problems_a_line_each_and_printable():
    told = DbcMismatch(Path("a.dbc"), ["one", "two\x1b[2J"])
    assert told.path == Path("a.dbc")
    assert len(told.problems) == 2
    assert "\x1b" not in told.problems[1]
    assert str(told).splitlines() == ["a.dbc:", "  one", f"  {told.problems[1]}"]


@pytest.mark.parametrize(
    ("kind", "node", "is_gateway", "expected"),
    [
        ("Adhesion", 1, True, True),
        ("Adhesion", 0, True, False),
        ("Adhesion", 1, False, False),
        ("Thermal", 1, True, False),
        ("A", 1, True, False),
    ],
)
def test_only_the_gateways_adhesion_of_a_drive_is_sent_on_request(kind, node, is_gateway, expected):
    one = MessageSpec(
        "M", 1, 8, False, False, 0, Profile.NONE, b"", (), 0, node, kind, is_gateway=is_gateway
    )
    assert one.is_optional is expected
    assert Codec(Path("one.dbc"), [one]).own(creep=False) == (
        [one] if is_gateway and not expected else []
    )
