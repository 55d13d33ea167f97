"""The compiled encoder equals `Codec.encode` and `protect`: any DBC, any numbers."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbc._send_kernels import encode_rows
from dbc.codec import Codec, bind
from dbc.contract import ANY
from dbc.e2e import configs, protect
from dbc.sending import DOUBLE, WIDEST, form
from gateway.config import shipped_dbc
from tests.dbc_text import of_layout
from tests.fuzz import examples
from tests.strategies import Layout, layouts

HEADER = ("Crc", "Counter")
ODD = (0.0, -0.0, 0.5, 1e308, -1e308, float("inf"), float("-inf"), float("nan"), 2.0**53 + 2)


@cache
def bound(name: str) -> Codec:
    return bind(shipped_dbc(name), (), ANY)


def compiled(codec: Codec, given: dict[str, list[str]], value: np.ndarray, counter: int) -> bytes:
    """One frame of every message, one after the other."""
    n = len(given)
    payload = np.full((n, 64), 0xAA, dtype=np.uint8)
    encode_rows(
        np.arange(n), value, np.full(n, counter), form(codec, given),
        configs([codec.by_name[name] for name in given]), payload,
    )  # fmt: skip
    return payload.tobytes()


def plain(codec: Codec, given: dict[str, list[str]], value: np.ndarray, counter: int) -> bytes:
    out = b""
    for row, (name, signals) in zip(value.tolist(), given.items(), strict=True):
        spec = codec.by_name[name]
        payload = codec.encode(spec, {signal: row[spec.column(signal)] for signal in signals})
        protect(spec, payload, counter)
        out += bytes(payload).ljust(64, b"\0")
    return out


@pytest.mark.parametrize("name", ["traction.dbc", "traction_fd.dbc"])
@given(data=st.data(), counter=st.integers(0, 1 << 40))
@settings(max_examples=examples(60), deadline=None)
def test_any_numbers_in_any_shipped_message(name: str, data: st.DataObject, counter: int) -> None:
    """Numbers within and beyond every range, and any part of the signals."""
    codec = bound(name)
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    share = data.draw(st.sampled_from([0.0, 0.5, 1.0]))
    given = {
        spec.name: [s.name for s in spec.signals if s.name not in HEADER and rng.random() <= share]
        for spec in codec.messages
    }
    value = np.zeros((len(given), codec.width))
    for row, spec in zip(value, codec.messages, strict=True):
        for k, s in enumerate(spec.signals):
            low, high = (raw * s.scale + s.offset for raw in (s.raw_min, s.raw_max))
            spread = high - low
            drawn = [rng.uniform(low - 0.1 * spread, high + 0.1 * spread), low, high, *ODD]
            # Halves, too: what is rounded to even.
            drawn += [(rng.integers(s.raw_min, s.raw_max + 1) + 0.5) * s.scale + s.offset] * 4
            row[k] = drawn[rng.integers(len(drawn))]
    assert compiled(codec, given, value, counter) == plain(codec, given, value, counter)


@given(
    layout=layouts().filter(lambda one: one.length <= WIDEST or one.is_float),
    numbers=st.lists(st.floats() | st.integers(-(1 << 53), 1 << 53).map(float), min_size=20),
)
@settings(max_examples=examples(100), deadline=None)
def test_any_layout(layout: Layout, numbers: list[float]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        codec = bind(of_layout(Path(folder) / "one.dbc", layout), (), ANY)
    if layout.length == DOUBLE and layout.start % 8 != (7 if layout.is_big_endian else 0):
        with pytest.raises(ValueError, match="not for the compiled encoder: M"):
            form(codec, {"M": ["S"]})
        return
    for number in numbers:
        value = np.array([[number]])
        assert compiled(codec, {"M": ["S"]}, value, 0) == plain(codec, {"M": ["S"]}, value, 0)


def test_what_it_cannot_encode_is_refused_by_name() -> None:
    path = Path(__file__).parents[1] / "data" / "dbc" / "cantools_multiplex_2.dbc"
    codec = bind(path, (), ANY)
    with pytest.raises(ValueError, match="not for the compiled encoder: Extended"):
        form(codec, {"Extended": []})
    with pytest.raises(KeyError):
        form(codec, {"Nobody": []})


def test_it_is_the_same_function_uncompiled() -> None:
    codec = bound("traction.dbc")
    given = {"Gateway_Adhesion": ["Reason", "Adhesion3", "Age"], "Drive2_Estimate": ["Speed"]}
    value = np.random.default_rng(3).uniform(-300.0, 300.0, (2, codec.width))
    made = []
    for kernel in (encode_rows, encode_rows.py_func):
        payload = np.zeros((2, 64), dtype=np.uint8)
        specs = [codec.by_name[name] for name in given]
        with np.errstate(over="ignore"):
            kernel(
                np.arange(2), value, np.array([5, 21]), form(codec, given), configs(specs), payload
            )
        made.append(payload.tobytes())
    assert (
        made[0]
        == made[1]
        == b"".join(
            plain(codec, {name: given[name]}, value[k : k + 1], 5 + 16 * k)
            for k, name in enumerate(given)
        )
    )
