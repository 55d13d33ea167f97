"""The codec against cantools: any DBC, any bytes; block, reference and one frame alike."""

import math
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from cantools.database import DecodeError
from hypothesis import given, settings
from hypothesis import strategies as st

from dbc import codec as codec_module
from dbc.codec import bind
from dbc.contract import ANY
from dbc.load import load
from dbc.spec import ABSENT, EXTENDED_KEY
from tests.dbc_text import of_layout
from tests.fuzz import examples
from tests.reference import codec as reference
from tests.strategies import layouts

SHIPPED = Path(codec_module.__file__).parent
FOREIGN = Path(__file__).parents[1] / "data" / "dbc"
FILES = {
    "traction": SHIPPED / "traction.dbc",
    "traction_fd": SHIPPED / "traction_fd.dbc",
    "multiplex": FOREIGN / "cantools_multiplex_2.dbc",
    "motohawk_fd": FOREIGN / "cantools_motohawk_fd.dbc",
    "negative_scaling": FOREIGN / "cantools_issue_636_negative_scaling.dbc",
    "dlc_zero": FOREIGN / "cantools_message-dlc-zero.dbc",
    "leaf": FOREIGN / "savvycan_LeafPowertrainBus.dbc",
}


@cache
def bound(name):
    return bind(FILES[name], (), ANY)


@cache
def oracle(name):  # cantools' Database
    return load(FILES[name])


def cantools_decode(name, spec, data):
    """Scaled numbers; None where no multiplexer value fits, which cantools calls an error."""
    message = oracle(name).get_message_by_name(spec.name)
    try:
        return message.decode(data, decode_choices=False)
    except (DecodeError, KeyError):
        return None


def block(codec, spec, data):
    payload = np.frombuffer(data.ljust(64, b"\0"), np.uint8).reshape(1, 64)
    index = np.array([spec.index], np.int32)
    value, validity = codec.decode_rows(index, payload)
    plain_value, plain_validity = reference.decode_rows(codec, index.tolist(), payload)
    assert np.array_equal(value, plain_value, equal_nan=True)
    assert np.array_equal(validity, plain_validity)
    return value[0].tolist(), validity[0].tolist()


def assert_same(name, spec, data):
    codec = bound(name)
    value, validity = block(codec, spec, data)
    readings = codec.decode(spec, data)
    wanted = cantools_decode(name, spec, data)
    assert all(code == ABSENT for code in validity[len(spec.signals) :])
    for k, signal in enumerate(spec.signals):
        reading = readings[signal.name]
        assert reading.validity == validity[k]
        assert reading.value == value[k] or math.isnan(value[k])
        if validity[k] == ABSENT:
            assert wanted is None or signal.name not in wanted
        elif wanted is not None:
            number = float(wanted[signal.name])
            assert value[k] == pytest.approx(number, rel=1e-15, nan_ok=True), signal


@pytest.mark.parametrize("name", FILES)
def test_random_payloads(name):
    codec = bound(name)
    generator = np.random.default_rng(2)
    for spec in codec.messages:
        for _ in range(6):
            assert_same(name, spec, generator.bytes(spec.length))
        assert_same(name, spec, bytes(spec.length))
        assert_same(name, spec, b"\xff" * spec.length)


@pytest.mark.parametrize("name", ["traction", "traction_fd"])
def test_raw_extremes_and_codes_of_every_signal(name):
    """Each signal at its type's ends, its range's ends, beyond them and at its code."""
    codec = bound(name)
    for spec in codec.messages:
        message = oracle(name).get_message_by_name(spec.name)
        for s in spec.signals:
            low = -(1 << (s.length - 1)) if s.is_signed else 0
            high = low + (1 << s.length) - 1
            cases = {low, high, s.raw_min, s.raw_max, s.raw_min - 1, s.raw_max + 1, s.start_raw}
            cases |= {s.not_available} if s.not_available is not None else set()
            for raw in sorted(case for case in cases if low <= case <= high):
                data = message.encode(
                    {t.name: raw if t is s else 0 for t in spec.signals},
                    scaling=False,
                    strict=False,
                )
                assert codec.decode(spec, data)[s.name].raw == raw
                assert_same(name, spec, data)


@given(layout=layouts(), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=examples(150))
def test_any_layout_equals_cantools_both_ways(layout, seed):
    with tempfile.TemporaryDirectory() as folder:
        path = of_layout(Path(folder) / "one.dbc", layout)
        codec, database = bind(path, (), ANY), load(path)
    spec, message = codec.messages[0], database.messages[0]
    generator = np.random.default_rng(seed)
    for data in (generator.bytes(layout.size), b"\xff" * layout.size, bytes(layout.size)):
        value, _ = block(codec, spec, data)
        number = message.decode(data)["S"]
        assert value[0] == pytest.approx(float(number), rel=1e-15, nan_ok=True)
        if layout.length <= 48 and math.isfinite(number):
            assert bytes(codec.encode(spec, {"S": number})) == message.encode(
                {"S": number}, strict=False
            )


@given(data=st.data())
@settings(max_examples=examples(200))
def test_encode_round_trip(data):
    """Every valid raw value comes back, and cantools encodes the same bytes."""
    name = data.draw(st.sampled_from(["traction", "traction_fd"]))
    codec = bound(name)
    spec = data.draw(st.sampled_from(codec.messages))
    body = spec.signals[2:]
    raws = {s.name: data.draw(st.integers(s.raw_min, s.raw_max), label=s.name) for s in body}
    values = {s.name: raws[s.name] * s.scale + s.offset for s in body}
    payload = bytes(codec.encode(spec, values))
    assert {n: r.raw for n, r in codec.decode(spec, payload).items() if n in raws} == raws
    message = oracle(name).get_message_by_name(spec.name)
    assert payload == message.encode({"Crc": 0, "Counter": 0, **values}, strict=True)


def test_multiplexed_encode_equals_cantools():
    codec, database = bound("multiplex"), oracle("multiplex")
    cases = {
        "Normal": [{"S0": 0, "S1": -3}, {"S0": 1, "S2": 77}],
        "Extended": [
            {"S0": 0, "S1": 0, "S2": 5, "S3": -2000, "S6": 1, "S7": 123456},
            {"S0": 0, "S1": 2, "S4": -100000, "S6": 2, "S8": -1},
            {"S0": 1, "S5": 99999, "S6": 1, "S7": -1},
        ],
        "Shared": [{"S0": 3, "S1": 7, "S2": -128}, {"S0": 4, "S2": 3}],
        "ExtendedTypes": [{"S11": 5, "S9": 1.5}, {"S11": 3, "S0": 0, "S10": -2.25}],
    }
    for name, wanted in cases.items():
        for values in wanted:
            data = database.get_message_by_name(name).encode(values)
            spec = codec.by_name[name]
            assert bytes(codec.encode(spec, values)) == data
            readings = codec.decode(spec, data)
            present = {n: r.value for n, r in readings.items() if r.validity != ABSENT}
            assert present == pytest.approx(values)


def test_extended_ids_have_their_own_keys():
    spec = bound("motohawk_fd").by_name["ExampleMessage"]
    assert spec.is_extended
    assert spec.is_fd
    assert bound("motohawk_fd").by_id == {0x1F0 | EXTENDED_KEY: spec}
