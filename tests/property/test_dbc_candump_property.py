"""Candump: writing and reading are inverse, and no bytes whatever make the reader raise."""

import io

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from dbc.candump import reader as candump
from dbc.candump import writer as logwriter
from dbc.candump.grammar import Verdict, format_frame, parse_line
from dbc.candump.reader import LogError, Reader
from dbc.candump.writer import Writer
from dbc.frame import BRS, FD, REMOTE, Frame
from dbc.frames import block_of
from tests.fuzz import examples
from tests.reference import candump as reference
from tests.strategies import frames, log_lines


@given(frames())
@settings(max_examples=examples(200))
def test_parse_of_format_is_the_frame(frame):
    line = format_frame(frame)
    verdict, back = parse_line(line)
    assert back == frame
    assert not verdict.is_fault
    assert format_frame(back) == line


@given(log_lines() | st.binary(max_size=80))
@settings(max_examples=examples(300))
def test_any_bytes_get_a_verdict(line):
    verdict, frame = parse_line(line)
    assert (frame is not None) == (verdict <= Verdict.ERROR_FRAME)
    if frame is not None:
        assert parse_line(format_frame(frame))[1] == frame


@given(st.lists(frames().map(format_frame) | log_lines(), max_size=20), st.booleans())
@settings(max_examples=examples(150))
def test_counts_add_up_to_the_lines(lines, terminated):
    data = b"\n".join(lines) + (b"\n" if terminated else b"")
    reader = Reader(io.BytesIO(data))
    found = list(reader)
    expected = data.count(b"\n") + (bool(data) and not data.endswith(b"\n"))
    assert reader.lines == reader.counts.total() == expected
    assert len(found) == sum(reader.counts[v] for v in Verdict if v <= Verdict.ERROR_FRAME)
    parsed = [parse_line(line)[1] for line in data.split(b"\n")]
    whole = [frame for frame in parsed if frame is not None]
    assert found in (whole, whole[:-1])


PLAIN_LINES = st.builds(
    lambda seconds, micros, name, can_id, flags, data, end: (
        b"(%d.%06d) %b %03X#%b%b%b"
        % (seconds, micros, name, can_id, flags, data.hex().upper().encode(), end)
    ),
    st.integers(0, 10_000_000_000),
    st.integers(0, 999_999),
    st.sampled_from([b"can0", b"vcan1", b"\xff\xfe", b"x" * 22, b" can0"]),
    st.integers(0, 0x8FF),
    st.sampled_from([b"", b"#1", b"#3", b"#", b"R"]),
    st.binary(max_size=9) | st.sampled_from([bytes(12), bytes(13), bytes(64), bytes(65)]),
    st.sampled_from([b"", b" R", b" T", b"\r", b" R\r", b"  R", b" ", b"\t", b"A", b"_9", b"\r\r"]),
)
"""Lines that are plain, or nearly."""
NO_FRAMES = st.sampled_from([
    b"", b"\n\n\n", b"\r", b" \t", b"\t\r", b"\r\r", b"\x0b", b"#", b"#x", b";", b"//", b"/", b" #",
    b"D", b"D" * 20, b"a", b"a" * 20, b"(1.000000) a 12#", b"(1.000000) a 123#",
    b"(0.000000) a 123#\r",
])  # fmt: skip
"""Blank lines, comments and others, of which there may be many."""


@given(
    st.lists(PLAIN_LINES | frames().map(format_frame) | log_lines() | NO_FRAMES, max_size=20),
    st.booleans(),
    st.booleans(),
    st.integers(1, 200),
    st.sampled_from([0, 1, 3, 100]),
)
@settings(max_examples=examples(300))
def test_reading_equals_the_reference(lines, terminated, strict, chunk, problems):
    """Frames, verdicts, counts and the fault in strict mode are those of reading line by line."""
    data = b"\n".join(lines) + (b"\n" if terminated else b"")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(candump, "_CHUNK", chunk)
        patch.setattr(candump, "PROBLEMS_KEPT", problems)
        reader = Reader(io.BytesIO(data), strict=strict)
        found = []
        fault = ""
        try:
            for frame in reader:
                found.append(frame)  # noqa: PERF402 - what came before a fault counts
        except LogError as error:
            fault = str(error)
    read = (found, +reader.counts, reader.lines, reader.problems, reader.drops, fault)
    assert read == reference.read(data, strict=strict, problems_kept=problems)


@given(st.lists(frames().map(format_frame) | log_lines(), max_size=10))
@settings(deadline=None)
def test_strict_stops_at_the_first_fault(lines):
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
@settings(max_examples=examples(150))
def test_a_cut_last_line_is_never_another_frame(frame, data):
    line = format_frame(frame)
    size = data.draw(st.integers(0, len(line) - 1))
    found = list(Reader(io.BytesIO(line + b"\n" + line[:size])))
    assert found == [frame]


ODD_FRAMES = st.builds(
    Frame,
    st.integers(-5, 5) | st.integers(0, 9_100_000_000 * 10**9),
    st.integers(0, 0xFFFFFFFF),
    st.binary(max_size=10) | st.sampled_from([bytes(12), bytes(13), bytes(64)]),
    st.integers(0, 63),
    st.sampled_from(["", "can0", "x" * 21, "x" * 22, "a b", "\udcff"]),
    st.integers(-1, 16),
)
"""Frames of which most cannot be written."""


@given(st.lists(frames(), max_size=20), st.sampled_from(["", "vcan1"]), st.integers(1, 5))
@settings(max_examples=examples(150))
def test_a_block_is_written_as_its_frames_are(many, channel, room):
    """Whatever room there is for lines at once."""
    one, other = io.BytesIO(), io.BytesIO()
    writer = Writer(one)
    for frame in many:
        writer.write(frame, channel)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(logwriter, "_LINES", room)
        Writer(other).write_block(block_of(many), channel)
    assert other.getvalue() == one.getvalue()
    assert one.getvalue() == b"".join(format_frame(f, channel or "can0") + b"\n" for f in many)


@given(frames() | ODD_FRAMES, st.sampled_from(["can0", "vcan1", "a b"]))
@settings(max_examples=examples(300))
@example(Frame(-(1 << 63) - 1, 1), "can0")
@example(Frame(0, 1 << 64), "can0")
@example(Frame(0, 1, b"", REMOTE, "", 1 << 31), "can0")
def test_a_written_line_equals_the_reference(frame, channel):
    try:
        line = format_frame(frame, channel)
    except ValueError:
        line = None
    assert line == reference.write(frame, channel)


@given(frames(), ODD_FRAMES)
@settings(max_examples=examples(500))
@example(Frame(0, 1), Frame(0, 1, bytes(8), BRS))
@example(Frame(0, 1), Frame(0, 0x800))
@example(Frame(0, 1), Frame(0, 1, bytes(65), FD))
def test_what_no_line_can_say_is_refused_in_a_block_too(good, odd):
    """And what stands before it is written."""
    stream = io.BytesIO()
    writer = Writer(stream)
    try:
        line = format_frame(odd)
    except ValueError:
        with pytest.raises(ValueError, match="candump line"):
            writer.write_block(block_of([good, odd]))
        assert stream.getvalue() == format_frame(good) + b"\n"
    else:
        writer.write_block(block_of([good, odd]))
        assert stream.getvalue() == format_frame(good) + b"\n" + line + b"\n"
