"""Candump lines: every case gets the verdict it deserves, and the counts add up to the lines."""

import gzip
import io
import random
import threading
from collections import Counter
from pathlib import Path

import pytest

from dbc.candump.grammar import MAX_LINE, Verdict, format_frame, parse_line
from dbc.candump.reader import LogError, Reader
from dbc.candump.writer import Writer
from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, TX, Frame
from dbc.frames import block_of
from tests.reference import candump as reference
from tests.work import calls

V = Verdict
LOGS = Path(__file__).parents[1] / "data" / "logs"
T = b"(1436509052.249713) can0 "
NS = 1_436_509_052_249_713_000


def frame(can_id, data=b"", flags=0, dlc=-1):
    return Frame(NS, can_id, data, flags, "can0", dlc)


GOOD = [
    # lib.h and candump.c, one example each
    (b"123#", V.OK, frame(0x123)),
    (b"123#00", V.OK, frame(0x123, b"\0")),
    (b"123#1122334455667788", V.OK, frame(0x123, bytes.fromhex("1122334455667788"))),
    (b"123#1122334455667788_E", V.OK, frame(0x123, bytes.fromhex("1122334455667788"), 0, 14)),
    (b"123#11.22.33.44.55.66.77.88", V.OK, frame(0x123, bytes.fromhex("1122334455667788"))),
    (b"123#11.2233.44556677.88", V.OK, frame(0x123, bytes.fromhex("1122334455667788"))),
    (b"7fF#aB", V.OK, frame(0x7FF, b"\xab")),
    (b"12345678#112233", V.OK, frame(0x12345678, b"\x11\x22\x33", EXTENDED)),
    (b"00000123#", V.OK, frame(0x123, b"", EXTENDED)),
    (b"123#R", V.REMOTE, frame(0x123, b"", REMOTE)),
    (b"123#R0", V.REMOTE, frame(0x123, b"", REMOTE)),
    (b"7A1#r", V.REMOTE, frame(0x7A1, b"", REMOTE)),
    (b"123#R7", V.REMOTE, frame(0x123, b"", REMOTE, 7)),
    (b"123#R8", V.REMOTE, frame(0x123, b"", REMOTE, 8)),
    (b"123#R8_9", V.REMOTE, frame(0x123, b"", REMOTE, 9)),
    (b"12345678#R8_C", V.REMOTE, frame(0x12345678, b"", REMOTE | EXTENDED, 12)),
    (b"123##0112233", V.FD, frame(0x123, b"\x11\x22\x33", FD)),
    (b"123##1112233", V.FD, frame(0x123, b"\x11\x22\x33", FD | BRS)),
    (b"123##2112233", V.FD, frame(0x123, b"\x11\x22\x33", FD | ESI)),
    (b"123##3", V.FD, frame(0x123, b"", FD | BRS | ESI)),
    (b"123##5112233", V.FD, frame(0x123, b"\x11\x22\x33", FD | BRS)),
    (b"123##F", V.FD, frame(0x123, b"", FD | BRS | ESI)),
    (b"123##1" + b"AB" * 64, V.FD, frame(0x123, b"\xab" * 64, FD | BRS)),
    (b"123##0.11.22", V.FD, frame(0x123, b"\x11\x22", FD)),
    (b"20000040#0000000000000000", V.ERROR_FRAME, frame(0x40, bytes(8), ERROR)),
    (b"20000088#0000080000000000", V.ERROR_FRAME, frame(0x88, b"\0\0\x08\0\0\0\0\0", ERROR)),
    (b"32345678#112233", V.ERROR_FRAME, frame(0x12345678, b"\x11\x22\x33", ERROR)),
]
BAD = {
    V.BAD_ID: b"FFF#00 800#00 40000000#00 80000123#00 FFFFFFFF#00 60000001#00".split(),
    V.MALFORMED: [
        *b"123456789#00 12#00 1234#00 12G#00 #00 123 12345678 123#0 123#001 123#0G 123#00.".split(),
        *b"123#..00 123#1122_9 123##G 123##10 123## 20000001##100 20000001#R".split(),
        *(b"123#1122334455667788" + end for end in (b"_8", b"_", b"_EE")),
        *b"123#R9 123#R7_9 123#R8_8 123#R88 123#R00".split(),
        *b"45123#81:00:af#00 45123#81:00:12345678#".split(),
        *(b"123#00" + end for end in (b" X", b" R T", b"\xff", b"\0\0\0")),
    ],
    V.BAD_LENGTH: [b"123#112233445566778899", *(b"123##1" + b"00" * size for size in (9, 63, 100))],
}
BAD_ONES = [(body, verdict) for verdict, bodies in BAD.items() for body in bodies]
LINES = [
    (b"", V.BLANK),
    (b"  \t ", V.BLANK),
    (b"# comment", V.COMMENT),
    (b"; comment", V.COMMENT),
    (b"// comment", V.COMMENT),
    (b"/ no comment", V.MALFORMED),
    (b"/", V.MALFORMED),
    (b"DROPCOUNT: dropped 3 CAN frames on 'can0' socket (total drops 12)", V.DROPCOUNT),
    (b"DROPCOUNT: dropped 1 CAN frame on 'can0' socket (total drops 1)", V.DROPCOUNT),
    (b"DROPCOUNT: dropped", V.MALFORMED),
    (b"(1.000000) can0 45123#81:00:12345678#11223344.556677", V.XL),
    (b"(1.000000) can0 123#81:00:12345678#00", V.XL),
    (b"(nan) can0 123#00", V.MALFORMED),
    (b"(inf) can0 123#00", V.MALFORMED),
    (b"(-1.000000) can0 123#00", V.MALFORMED),
    (b"(1) can0 123#00", V.MALFORMED),
    (b"(1.000000] can0 123#00", V.MALFORMED),
    (b"(1.000000)" + 22 * b" " + b"can0 123#00", V.MALFORMED),
    (b"(1.000000) c\x7fn0 123#00", V.MALFORMED),
    (b"(1.0) can0 123#00", V.MALFORMED),
    (b"(1.00000000) can0 123#00", V.MALFORMED),
    (b"(1e3.000000) can0 123#00", V.MALFORMED),
    (b"(9000000000.000000) can0 123#00", V.MALFORMED),
    (b"(1436509052.2497", V.MALFORMED),
    (b"(1.000000)", V.MALFORMED),
    (b"(1.000000) can0", V.MALFORMED),
    (b"(1.000000) 123#00", V.MALFORMED),
    (b"(1.000000)can0 123#00", V.MALFORMED),
    (b"(1.000000)\tcan0\t123#00", V.MALFORMED),
    (b" (1.000000) can0 123#00", V.MALFORMED),
    (b"\xef\xbb\xbf(1.000000) can0 123#00", V.MALFORMED),
    (b"(1.000000) a-name-longer-than-any-netdev 123#00", V.MALFORMED),
    (b"  can0  123   [3]  11 22 33", V.MALFORMED),
    (b"(2024-01-01 12:00:00.000000)  can0  123   [1]  11", V.MALFORMED),
    (b"(2024-01-01 12:00:00.000000) can0 123#11", V.MALFORMED),
    (b"\0" * 512, V.MALFORMED),
    (b"\xff\xfe garbage", V.MALFORMED),
    (b"(1.000000) can0 123#11(2.000000) can0 123#22", V.MALFORMED),
    (b"(1.000000) can0 " + b"0" * MAX_LINE, V.MALFORMED),
]


@pytest.mark.parametrize(("body", "verdict", "wanted"), GOOD)
@pytest.mark.parametrize("end", [b"", b"\n", b"\r\n", b" R\n", b" T", b" R\r\n", b"  \n"])
def test_frames(body, verdict, wanted, end):
    sent = TX if end.startswith(b" T") else 0
    assert parse_line(T + body + end) == (verdict, wanted._replace(flags=wanted.flags | sent))


@pytest.mark.parametrize(("body", "verdict"), BAD_ONES)
def test_what_is_no_frame(body, verdict):
    assert parse_line(T + body) == (verdict, None)


@pytest.mark.parametrize(("line", "verdict"), LINES)
def test_whole_lines(line, verdict):
    assert parse_line(line) == (verdict, None)


def test_time_is_whole_nanoseconds():
    assert parse_line(b"(1436509052.249713123) can0 1#")[1] is None
    assert parse_line(b"(1436509052.249713123) can0 001#")[1].t_ns == 1436509052249713123
    assert parse_line(b"(0000000000.000001) can0 001#")[1].t_ns == 1000
    assert parse_line(b"(8999999999.999999999) can0 001#")[1].t_ns == 8999999999999999999


def test_names_are_padded_and_keep_their_bytes():
    assert parse_line(b"(1.000000)   can0 001#")[1].channel == "can0"
    odd = parse_line(b"(1.000000) c\xff\xe9 001#")[1]
    assert format_frame(odd) == b"(0000000001.000000) c\xff\xe9 001#"
    assert parse_line("(1.000000) über 001#".encode())[1].channel == "über"


def test_reader_gives_the_same_as_parse_line():
    """The compiled reader and the grammar agree on every case above."""
    lines = [T + body for body, *_ in GOOD + BAD_ONES] + [line for line, _ in LINES]
    frames, reader = read(b"\n".join(lines) + b"\n")
    parsed = [parse_line(line) for line in lines]
    assert frames == [f for _, f in parsed if f is not None]
    assert reader.lines == len(lines) == reader.counts.total()
    assert all(reader.counts[v] == sum(p[0] is v for p in parsed) for v in Verdict)
    assert reader.drops == 4
    faults = [(k, v) for k, (v, _) in enumerate(parsed, 1) if v.is_fault]
    assert [(p.line, p.verdict) for p in reader.problems] == faults[:100]


class Many(io.RawIOBase):
    """The same line again and again; a gigabyte of it packs into a megabyte."""

    def __init__(self, line, size):
        self.piece, self.left = line * (1 << 20), size

    def read(self, size=-1):
        data = self.piece[: min(size, self.left)]
        self.left -= len(data)
        return data


@pytest.mark.parametrize(
    ("line", "size", "verdict"),
    [
        pytest.param(b"\n", 1 << 31, Verdict.BLANK, marks=pytest.mark.slow),
        (b"\r\n", 1 << 25, Verdict.BLANK),
        (b"#\n", 1 << 25, Verdict.COMMENT),
        (b"a\n", 1 << 25, Verdict.MALFORMED),
    ],
    ids=["2 GiB of newlines", "blank", "comments", "no frames"],
)
def test_a_bomb_of_short_lines_is_read_and_counted(line, size, verdict):
    """No line is judged by itself, which would take a minute and more of each."""
    reader = Reader(Many(line, size))
    sizes = []
    work = calls(lambda: sizes.extend(block.size for block in reader.blocks()))
    assert sum(sizes) == 0
    assert work < size // len(line) / 10
    assert +reader.counts == {verdict: size // len(line)}
    assert reader.lines == size // len(line)
    assert len(reader.problems) == (100 if verdict.is_fault else 0)


# ---- the end of the file -----------------------------------------------------------------------


def read(data):
    """What is read, which is what the reference reads."""
    reader = Reader(io.BytesIO(data))
    frames = list(reader)
    wanted = reference.read(data)
    assert frames == wanted.frames
    assert (reader.counts, reader.lines, reader.drops) == (wanted[1], wanted.lines, wanted.drops)
    assert [p[:2] for p in reader.problems] == [p[:2] for p in wanted.problems]
    return frames, reader


LAST = b"(1.000000) can0 123#1122334455667788\n(2.000000) can0 123#1122334455667788\n"


def test_every_cut_of_the_last_line():
    """However the last line is cut, no other frame comes out of it."""
    whole, _ = read(LAST)
    start = LAST.index(b"\n") + 1
    for size in range(start + 1, len(LAST)):
        frames, reader = read(LAST[:size])
        complete = size == len(LAST) - 1
        assert frames == (whole if complete else whole[:1])
        assert reader.counts == {V.OK: 2} if complete else {V.OK: 1, V.CUT: 1}
        assert reader.lines == 2


def test_a_text_that_ends_anywhere_in_its_first_line():
    for line in (b"(1.000000)  can0 123#1122 T\r\n", T + b"7FF##1" + b"00" * 64 + b" R\n"):
        for size in range(len(line)):
            frames, reader = read(line[:size])
            assert frames == []
            assert reader.counts == ({V.CUT: 1} if size else {})


def test_more_interfaces_than_are_looked_up_in_c():
    lines = [b"(1.000000) a%d 123#%02X\n" % (k % 100, k) for k in range(256)]
    frames, reader = read(b"".join(lines))
    assert [f.channel for f in frames] == [f"a{k % 100}" for k in range(256)]
    assert reader.counts == {V.OK: 256}


@pytest.mark.parametrize(
    ("before", "last", "verdict"),
    [
        (b"", b"123#11", V.CUT),
        (b"124#11", b"123#11", V.CUT),
        (b"123#11", b"123#22", V.OK),
        (b"123#1122", b"123#22", V.CUT),
        (b"18FEF100#1122", b"18F#", V.CUT),
        (b"123##1" + b"00" * 64, b"123##1" + b"00" * 48, V.CUT),
        (b"123##1" + b"00" * 64, b"123##1" + b"11" * 64, V.FD),
        (b"123#R8", b"123#R", V.CUT),
        (b"123#R8", b"123#R8", V.REMOTE),
        (b"123#R8_C", b"123#R8", V.CUT),
        (b"123#1122334455667788_E", b"123#1122334455667788", V.CUT),
        (b"20000040#00", b"20000040#00", V.ERROR_FRAME),
    ],
)
def test_unterminated_last_lines(before, last, verdict):
    data = (T + before + b"\n" if before else b"") + T + last
    frames, reader = read(data)
    assert reader.counts[verdict] >= 1
    assert (len(frames) == reader.lines) == (verdict is not V.CUT)
    if verdict is V.CUT:
        assert reader.problems[-1][:2] == (reader.lines, V.CUT)


def test_trailing_nuls_of_a_power_loss():
    frames, reader = read(LAST + b"\0" * 4096)
    assert len(frames) == 2
    assert reader.counts == {V.OK: 2, V.CUT: 1}


def test_a_line_without_end_is_not_collected():
    """Gigabytes without a line end are one malformed line, read piece by piece."""

    class Endless(io.RawIOBase):
        left = 64 << 20
        largest = 0

        def read(self, size=-1):
            self.largest = max(self.largest, size)
            size = min(size, self.left)
            self.left -= size
            return b"\0" * size

    stream = Endless()
    reader = Reader(stream)
    assert list(reader) == []
    assert (reader.lines, reader.counts) == (1, {V.CUT: 1})
    assert 0 < stream.largest <= 1 << 20
    long = b"(1.000000) can0 " + b"1" * (3 << 20)
    frames, reader = read(LAST + long + b"\n" + LAST)
    assert len(frames) == 4
    assert reader.counts == {V.OK: 4, V.MALFORMED: 1}


def test_frames_across_chunk_borders():
    count = 60_000
    line = b"(%010d.%06d) vcan0 %03X#%016X\n"
    data = b"".join(line % (k // 1000, k % 1000, k % 0x7FF, k) for k in range(count))
    assert len(data) > 2 << 20
    frames, reader = read(data)
    assert [int.from_bytes(f.data, "big") for f in frames] == list(range(count))
    assert reader.lines == reader.counts[V.OK] == count


# ---- gzip --------------------------------------------------------------------------------------


def test_gzip_whole_and_in_members(tmp_path):
    path = tmp_path / "log.gz"
    path.write_bytes(gzip.compress(LAST) + gzip.compress(LAST) + b"\0" * 32)
    reader = Reader(path)
    assert len(list(reader)) == 4
    assert reader.truncated == ""
    assert len(list(reader)) == 4, "a second pass starts anew"
    assert reader.lines == 4


def test_a_packed_log_that_is_left_early_leaves_no_thread(tmp_path):
    path = tmp_path / "long.log.gz"
    path.write_bytes(gzip.compress(LAST * 400_000, 1))
    others, blocks = set(threading.enumerate()), Reader(path).blocks()
    assert next(blocks).size
    assert set(threading.enumerate()) - others
    blocks.close()
    assert not set(threading.enumerate()) - others


def test_gzip_cut_short_gives_what_is_good_and_says_so(tmp_path):
    lines = b"".join(b"(%d.000000) can0 123#%016X\n" % (k, k * 7919) for k in range(20_000))
    packed = gzip.compress(lines)
    path = tmp_path / "cut.log.gz"
    path.write_bytes(packed[: len(packed) // 2])
    reader = Reader(path)
    frames = list(reader)
    assert 5_000 < len(frames) < 20_000
    assert "end early" in reader.truncated
    assert reader.problems[-1].text.startswith(reader.truncated)
    assert reader.counts.total() == reader.lines
    with pytest.raises(LogError, match="end early"):
        list(Reader(path, strict=True))
    path.write_bytes(gzip.compress(LAST)[:-8])
    ends_at_a_line = Reader(path)
    assert len(list(ends_at_a_line)) == 2
    assert ends_at_a_line.problems == [(2, V.CUT, "compressed data end early")]
    path.write_bytes(packed[: len(packed) // 2] + b"\xff" * 100 + packed[len(packed) // 2 + 100 :])
    damaged = Reader(path)
    assert len(list(damaged)) > 2_000
    assert "damaged" in damaged.truncated


def test_of_a_large_damaged_file_little_is_lost(tmp_path):
    rng = random.Random(5)
    lines = b"".join(
        b"(%d.%06d) can0 123#%016X\n" % (k, rng.randrange(10**6), rng.randrange(1 << 64))
        for k in range(60_000)
    )
    packed = bytearray(gzip.compress(lines))
    packed[-8] ^= 1  # of the checksum: what is before it is good
    path = tmp_path / "bus.log.gz"
    path.write_bytes(bytes(packed))
    reader = Reader(path)
    read = sum(block.size for block in reader.blocks())
    assert "damaged" in reader.truncated
    assert 59_000 < read < 60_000


# ---- strict, missing, real ---------------------------------------------------------------------


def test_strict_stops_with_the_line_number(tmp_path):
    path = tmp_path / "bad.log"
    path.write_bytes(b"# head\n" + LAST + b"\nDROPCOUNT: x\n" + LAST)
    reader = Reader(path, strict=True)
    frames = []
    with pytest.raises(LogError) as caught:
        frames.extend(reader)
    assert caught.value.line == 5
    assert str(caught.value) == f"{path}:5: malformed: DROPCOUNT: x"
    assert reader.lines == 5
    lenient = Reader(path)
    assert len(list(lenient)) == 4
    assert lenient.counts[V.MALFORMED] == 1


def test_strict_accepts_everything_that_is_no_fault():
    text = b"# c\n\n" + LAST + b"(1.000000) can0 45123#81:00:12345678#11\n"
    assert len(list(Reader(io.BytesIO(text), strict=True))) == 2


def test_a_missing_file_is_an_os_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        list(Reader(tmp_path / "none.log"))


def test_problems_are_bounded():
    _, reader = read(b"junk\n" * 10_000)
    assert len(reader.problems) == 100
    assert reader.counts == {V.MALFORMED: 10_000}


def test_counts_agree_when_the_reading_stops_early():
    reader = Reader(io.BytesIO(LAST * 40_000))
    frames = iter(reader)
    for _ in range(3):
        next(frames)
    frames.close()
    assert 3 <= reader.lines == reader.counts[V.OK] < 80_000


@pytest.mark.parametrize(
    ("name", "count", "channels"),
    [
        ("kona_ev_2019_head.log", 250, {"can0", "can1"}),
        ("savvycan_tesla_model_s_head.log", 120, {"vcan0"}),
    ],
)
def test_real_logs(name, count, channels):
    """Frames equal python-can's own reader; writing gives the log back."""
    import can

    path = LOGS / name
    frames, reader = read(path.read_bytes())
    assert reader.counts == {V.OK: count}
    assert {f.channel for f in frames} == channels
    with can.LogReader(path) as messages:
        for ours, theirs in zip(frames, messages, strict=True):
            assert (ours.can_id, ours.data) == (theirs.arbitration_id, bytes(theirs.data))
            assert ours.t_ns == round(theirs.timestamp * 1e6) * 1000
    original = path.read_bytes().split()
    again = [format_frame(f) for f in frames]
    assert [line.split()[1:] for line in again] == [
        [*pair] for pair in zip(original[1::3], original[2::3], strict=True)
    ]


# ---- writing -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("_body", "_verdict", "wanted"), GOOD)
def test_written_lines_come_back(_body, _verdict, wanted):
    assert parse_line(format_frame(wanted))[1] == wanted


def test_the_direction_comes_back(tmp_path):
    wanted = [frame._replace(flags=frame.flags | tx) for *_, frame in GOOD for tx in (0, TX)]
    for one in wanted:
        line = format_frame(one)
        assert line.endswith(b" T") == bool(one.flags & TX)
        assert parse_line(line)[1] == one
        assert line == reference.write(one)
    with Writer(tmp_path / "x.log") as writer:
        writer.write_block(block_of(wanted))
    assert list(Reader(tmp_path / "x.log")) == wanted


def test_how_lines_are_written():
    assert format_frame(frame(0x1A, b"\x0f")) == T + b"01A#0F"
    assert format_frame(Frame(1_000_001, 1, b"", REMOTE)) == b"(0000000000.001000001) can0 001#R"
    assert format_frame(Frame(0, 1), "vcan7") == b"(0000000000.000000) vcan7 001#"
    assert format_frame(frame(0x40, b"\1", ERROR)) == T + b"20000040#01"
    assert format_frame(frame(1, b"\1" * 12, FD | BRS)) == T + b"001##1" + b"01" * 12


@pytest.mark.parametrize(
    "impossible",
    [
        Frame(-1, 1), Frame(9_000_000_000_000_000_000, 1), Frame(0, -1), Frame(0, 0x800),
        Frame(0, 0x20000000, flags=EXTENDED), Frame(0, 0x20000000, flags=ERROR),
        Frame(0, 1, bytes(9)), Frame(0, 1, bytes(9), FD), Frame(0, 1, bytes(7), dlc=9),
        Frame(0, 1, bytes(8), dlc=16), Frame(0, 1, b"\1", REMOTE), Frame(0, 1, b"", REMOTE, dlc=16),
        Frame(0, 1, b"", REMOTE | FD), Frame(0, 1, b"", ERROR | REMOTE),
        Frame(0, 1, b"", ERROR | EXTENDED), Frame(0, 1, b"", BRS), Frame(0, 1, channel="two words"),
        Frame(0, 1, channel="x" * 22), Frame(0, 1, channel="a\nb"),
    ],
)  # fmt: skip
def test_what_no_line_can_say_is_refused(impossible):
    with pytest.raises(ValueError, match="cannot be written"):
        format_frame(impossible)


def test_writer_and_reader_are_inverse(tmp_path):
    frames = [wanted for _, _, wanted in GOOD]
    for name in ("out.log", "out.log.gz"):
        path = tmp_path / name
        with Writer(path) as writer:
            for one in frames:
                writer.write(one)
        reader = Reader(path)
        assert list(reader) == frames
        assert reader.problems == []
    assert (tmp_path / "out.log.gz").read_bytes()[:2] == b"\x1f\x8b"
    first = (tmp_path / "out.log.gz").read_bytes()
    with Writer(str(tmp_path / "again.gz")) as writer:
        for one in frames:
            writer.write(one)
    assert (tmp_path / "again.gz").read_bytes() == first, "same frames, same bytes"
    stream = io.BytesIO()
    with Writer(stream, "vcan3") as writer:
        writer.write(Frame(0, 1))
    assert stream.getvalue() == b"(0000000000.000000) vcan3 001#\n"


def test_gaps_between_parts_are_blanks_up_to_a_names_length():
    stamp, rest = b"(0000000001.000000)", b"can0 123#11\n"
    lines = [stamp + b" " * wide + rest for wide in (0, 1, 21, 22, 500)] + [
        stamp + b" " * 40 + b"\n"
    ]
    lines += [stamp + b" can0" + b" " * wide + b"123#11\n" for wide in (0, 1, 21, 22, 500)]
    found, reader = read(b"".join(lines))
    wanted = [parse_line(line) for line in lines]
    assert found == [frame for _, frame in wanted if frame is not None]
    assert reader.counts == Counter(verdict for verdict, _ in wanted)
