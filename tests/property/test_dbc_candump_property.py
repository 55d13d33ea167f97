"""Candump: writing and reading are inverse, and no bytes whatever make the reader raise."""

from __future__ import annotations

import io

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbc.candump import LogError, Reader, format_frame, parse_line
from dbc.frame import Frame
from dbc.logline import Verdict
from tests.strategies import frames, log_lines


@given(frames())
@settings(max_examples=500, deadline=None)
def test_parse_of_format_is_the_frame(frame: Frame) -> None:
    line = format_frame(frame)
    verdict, back = parse_line(line)
    assert back == frame
    assert not verdict.is_fault
    assert format_frame(back) == line


@given(log_lines() | st.binary(max_size=80))
@settings(max_examples=1000, deadline=None)
def test_any_bytes_get_a_verdict(line: bytes) -> None:
    verdict, frame = parse_line(line)
    assert (frame is not None) == (verdict <= Verdict.ERROR_FRAME)
    if frame is not None:
        assert parse_line(format_frame(frame))[1] == frame


@given(st.lists(frames().map(format_frame) | log_lines(), max_size=20), st.booleans())
@settings(max_examples=300, deadline=None)
def test_counts_add_up_to_the_lines(lines: list[bytes], terminated: bool) -> None:
    data = b"\n".join(lines) + (b"\n" if terminated else b"")
    reader = Reader(io.BytesIO(data))
    found = list(reader)
    expected = data.count(b"\n") + (bool(data) and not data.endswith(b"\n"))
    assert reader.lines == reader.counts.total() == expected
    assert len(found) == sum(reader.counts[v] for v in Verdict if v <= Verdict.ERROR_FRAME)
    parsed = [parse_line(line)[1] for line in data.split(b"\n")]
    whole = [frame for frame in parsed if frame is not None]
    assert found in (whole, whole[:-1])


@given(st.lists(frames().map(format_frame) | log_lines(), max_size=10))
@settings(deadline=None)
def test_strict_stops_at_the_first_fault(lines: list[bytes]) -> None:
    data = b"".join(line.replace(b"\n", b"") + b"\n" for line in lines)
    lenient = Reader(io.BytesIO(data))
    found = list(lenient)
    strict = Reader(io.BytesIO(data), strict=True)
    if lenient.problems:
        with pytest.raises(LogError) as caught:
            list(strict)
        assert caught.value.line == lenient.problems[0].line == strict.lines
    else:
        assert list(strict) == found


@given(frames(), st.data())
@settings(max_examples=300, deadline=None)
def test_a_cut_last_line_is_never_another_frame(frame: Frame, data: st.DataObject) -> None:
    line = format_frame(frame)
    size = data.draw(st.integers(0, len(line) - 1))
    found = list(Reader(io.BytesIO(line + b"\n" + line[:size])))
    assert found == [frame]
