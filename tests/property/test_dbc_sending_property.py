"""Frames encoded and protected in a compiled loop equal the reference: any DBC, any numbers."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbc.codec import Codec, bind
from dbc.codec_tables import CodecTables
from dbc.contract import ANY
from dbc.e2e import configs, protect
from gateway.settings.config import shipped_dbc
from tests.dbc_text import of_layout
from tests.encode_loop import encode_rows, given_of
from tests.fuzz import examples
from tests.reference import codec as reference
from tests.strategies import Layout, layouts

HEADER = ("Crc", "Counter")
ODD = (0.0, -0.0, 0.5, 1e308, -1e308, float("inf"), float("-inf"), float("nan"), 2.0**53 + 2)


@cache
def bound(name: str) -> Codec:
    return bind(shipped_dbc(name), (), ANY)


def compiled(codec: Codec, given: dict[str, list[str]], value: np.ndarray, counter: int) -> bytes:
    """One frame of every message, one after the other."""
    specs = [codec.by_name[name] for name in given]
    tables, n = CodecTables(specs), len(specs)
    payload = np.full((n, 64), 0xAA, dtype=np.uint8)
    encode_rows(
        np.arange(n), value, np.full(n, counter), tables.address, given_of(specs, given),
        configs(specs), payload,
    )  # fmt: skip
    return payload.tobytes()


def plain(codec: Codec, given: dict[str, list[str]], value: np.ndarray, counter: int) -> bytes:
    out = b""
    for row, (name, signals) in zip(value.tolist(), given.items(), strict=True):
        spec = codec.by_name[name]
        payload = reference.encode(spec, {signal: row[spec.column(signal)] for signal in signals})
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
    layout=layouts(),
    numbers=st.lists(st.floats() | st.integers(-(1 << 53), 1 << 53).map(float), min_size=20),
)
@settings(max_examples=examples(100), deadline=None)
def test_any_layout(layout: Layout, numbers: list[float]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        codec = bind(of_layout(Path(folder) / "one.dbc", layout), (), ANY)
    for number in numbers:
        value = np.array([[number]])
        assert compiled(codec, {"M": ["S"]}, value, 0) == plain(codec, {"M": ["S"]}, value, 0)
