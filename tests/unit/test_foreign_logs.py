"""Logs of other programs: the right frames, and a count for every line or object that is none.

Each case is of a kind that people have reported: the sources are python-can's issues 255, 1595,
1786, 2022 and 2101, can-utils' 348, PEAK's and Vector's descriptions of their formats, and SavvyCAN's
exporters.
"""
# ruff: noqa: E501 lines of logs

from __future__ import annotations

import gzip
import struct
import zlib
from collections import Counter
from pathlib import Path

import pytest

from dbc.candump.grammar import Verdict, format_frame
from dbc.candump.reader import LogError
from dbc.logs.blf import Blf
from dbc.logs.opening import open_reader
from dbc.logs.pattern import Pattern, PatternError
from dbc.logs.proposals import proposed

HEAD = "date Mon May 15 10:00:00.000 am 2023\nbase hex  timestamps absolute\n"
EVENTS = HEAD + "internal events logged\n"
BLOCK = "Begin Triggerblock Mon May 15 10:00:{:02}.000 am 2023\n"
TRC = ";$FILEVERSION={}\n;$STARTTIME=37704.5\n"

TEXTS = [
    # ASC: python-can's reader takes the first frame for a part of the header.
    ("a.asc", HEAD + "0.100000 1 201 Rx d 2 AA 01\n0.2 1 201 Rx d 2 AA 02\n",
     ["0.1 201#AA01", "0.2 201#AA02"], {"header": 2}),
    ("a.asc", "date Mon Dec 6 11:21:13 am 2021\nbase hex  no internal events logged\n// version 7.1\n"
     "40874.808200 1 122 Rx d 1 E3\n40874.810800 1 16A954A6x Rx d 1 00\n",
     ["40874.8082 122#E3", "40874.8108 16A954A6#00"], {"header": 2, "comment": 1}),
    ("a.asc", EVENTS.replace("absolute", "relative")
     + "0.0 1 181 Rx d 1 11\n0.010 1 Statistic: D 0 R 0\n0.010 1 181 Rx d 1 12\n0.5 1 181 Rx d 1 13\n",
     ["0 181#11", "0.02 181#12", "0.52 181#13"], {"header": 3, "event": 1}),
    ("a.asc", "\ufeffbase dec  timestamps absolute\n0.1 1  385  Rx d 2 16 255\n",
     ["0.1 181#10FF"], {"header": 1}),
    ("a.asc", EVENTS.replace("hex", "dec") + "1.0 3  1003  Rx  d 2 225 254  Length = 235988 ID = 1003\n"
     "1.1 CANFD   2 Rx  105  Motor_12  1 0 8  8 10 20 30 40 50 60 70 80  102031 130 323000 b0011297\n"
     "1.2 CANFD   2 Rx  105  1 0 9 12 01 02 03 04 05 06 07 08 09 0a 0b 0c  0 0 323040 0\n",
     ["1 3EB#E1FE", "1.1 105##11020304050607080", "1.2 105##10102030405060708090A0B0C"],
     {"header": 3}),
    ("a.asc", EVENTS + BLOCK.format(0) + " 0.000000 CANFD   Start of measurement\n"
     " 0.1 CANFD 1 Rx 080   1 0 0 0    0  0   3000 0 0\n 0.2 CANFD 1 Rx 081 0 1 8 8 1 2 3 4 5 6 7 8 0 0 5000\n"
     " 0.3 CANFD 1 Rx 50005x  0 0 5 0   140000   73   200050 7a60\nEnd TriggerBlock\n",
     ["0.1 080##1", "0.3 00050005#R5"], {"header": 5, "event": 1, "malformed": 1}),
    ("a.asc", EVENTS + BLOCK.format(0) + "0.0 1 181 Rx d 1 11\n1.0 1 181 Rx d 1 12\nEnd TriggerBlock\n"
     + BLOCK.format(50) + "0.0 1 181 Rx d 1 13\n2.0 2 181 Rx d 1 14\n",
     ["0 181#11", "1 181#12", "50 181#13", "52 181#14"], {"header": 6}),
    ("a.asc", EVENTS + "0.1 1 201 TxRq d 2 AA 01\n0.2 1 201 Tx d 2 AA 01 Length = 0 BitCount = 64\n"
     "0.3 1 Engine Rx d 1 55 Length = 0 BitCount = 64 ID = 513\n0.4 1 123 Rx r 4\n0.5 1 ErrorFrame\n"
     "0.6 1 123 Rx d 2 AA\n0.7 1 FFF Rx d 1 AA\n0.8 LIN1 something\n0.9 1 xyz\n",
     ["0.2 201#AA01 T", "0.3 201#55", "0.4 123#R4", "0.5 20000000#"],
     {"header": 3, "request": 1, "bad_length": 1, "bad_id": 1, "event": 1, "malformed": 1}),
    ("a.asc", EVENTS + "0.3 1  201  Rx  d 2 01 7F\n0.4 1  201  Rx  d 2 01 7", ["0.3 201#017F"],
     {"header": 3, "cut": 1}),
    ("a.asc", EVENTS + "0.3 1  201  Rx  d 2 01 7F", ["0.3 201#017F"], {"header": 3}),
    ("a.asc", EVENTS.replace("hex", "dec") + "0.3 1  201  Rx  d 2 1 12", [], {"header": 3, "cut": 1}),
    ("a.asc", (EVENTS + "0.3 1  201  Rx  d 2 01 7F\n").replace("\n", "\r"), ["0.3 201#017F"],
     {"header": 3}),
    # TRC: version 1.2, PEAK's semicolon, errors and states, a byte too few.
    ("a.trc", TRC.format("1.1").replace("37704.5", "37704.5;")
     + " 1)  1059.9  Rx  0300  2  00 04\n 2)  1346.8  Warng  FFFFFFFF  4  00 00 00 04  BUSLIGHT\n"
     " 3)  1349.2  Error  0008  4  00 19 08 08\n 4)  1352.7  Rx  0100  3  RTR\n 5) 1353.0 Rx 0300 2 00\n",
     ["1048507201.0599 300#0004", "1048507201.3492 20000000#", "1048507201.3527 100#R3"],
     {"header": 2, "event": 1, "bad_length": 1}),
    ("a.trc", TRC.format("1.2") + " 1) 1059.900 1 Rx 0300 1 11\n 2) 1298.945 2 Tx 18FEF100 1 22\n",
     ["1048507201.0599 300#11", "1048507201.298945 18FEF100#22 T"], {"header": 2}),
    ("a.trc", TRC.format("2.1") + ";$COLUMNS=N,O,T,B,I,d,R,L,D\n"
     " 1 0.100 DT 1 0123 Rx - 2 AA BB\n 2 0.2 ER 1 - Rx - 5 04 00 02 00 00\n 3 0.3 ST 1 - Rx - 4 0 0 0 8\n"
     " 4 0.4 EC 1 - Rx - 2 7F 80\n 5 0.5 RR 1 0123 Rx - 8\n"
     " 6 0.6 FB 1 0124 Rx - 9 01 02 03 04 05 06 07 08 09 0A 0B 0C\n",
     ["1048507200.0001 123#AABB", "1048507200.0002 20000000#", "1048507200.0005 123#R8",
      "1048507200.0006 124##10102030405060708090A0B0C"], {"header": 3, "event": 2}),
    ("a.trc", ";  a header without a version\n 1) 17  0300  1  11\n 2) 19 FFFFFFFF 4 00 00 00 04\n",
     ["0.017 300#11"], {"comment": 1, "event": 1}),
    # CSV: python-can's (also as pandas writes it), SavvyCAN's, CANedge's.
    ("a.csv", "timestamp,arbitration_id,extended,remote,error,dlc,data\n1.5,0x181,False,False,False,2,AQI=\n"
     "1.6,0x181,True,False,False,2,AQI=\n1.7,0x181,0,0,0,8,AgICAgIC", ["1.5 181#0102", "1.6 00000181#0102"],
     {"header": 1, "cut": 1}),
    ("a.csv", "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"
     "166064000,0000021A,false,Rx,0,3,FE,36,12,\n166065000,18FEF100,true,Tx,1,2,FE,36,,,,,,\n",
     ["166.064 21A#FE3612", "166.065 18FEF100#FE36 T"], {"header": 1}),
    ("a.csv", "TimestampEpoch;BusChannel;ID;IDE;DLC;DataLength;Dir;EDL;BRS;ESI;RTR;DataBytes\n"
     "1.5;1;7FF;0;1;1;0;0;0;0;0;AA\n1.6;1;00000000;1;9;12;0;1;1;0;0;AAAAAAAAAAAAAAAAAAAAAAAA\n"
     "1.7;1;7FF;0;4;0;0;0;0;0;1;\n1.8;1;7FF;0;2;2;0;0;0;0;0;A\n",
     ["1.5 7FF#AA", "1.6 00000000##1" + 12 * "AA", "1.7 7FF#R4"], {"header": 1, "malformed": 1}),
    # By their lines: an inverter's own recorder, SavvyCAN's exports; by their content: ASC, UTF-16.
    ("a.txt", "0000026Bx000005220108160000000000\n0000026Ex0CFFA001052302082B000000\n",
     ["0.619 522#0108160000000000", "0.622 0CFFA001#052302082B000000"], {}),
    ("a.txt", "166.064 CXX GVRET-PC\n166.064 R11 0000021A FE 36\n166.065 R29 0000021A 01\n",
     ["166.064 21A#FE36", "166.065 0000021A#01"], {"comment": 1}),
    ("a.log", "//----\nMicrochip\n166064;RX;0x0000021A;2;0xFE;0x36;\n166065;RX;0x18FEF100;1;0xFE;\n",
     ["166.064 21A#FE36", "166.065 18FEF100#FE"], {"comment": 1, "header": 1}),
    ("a.log", "***BUSMASTER***\n23:59:59:992 Rx 0 0000021A s 2 FE 36\n00:00:00:002 Rx 0 21A xr 2\n",
     ["86399.992 21A#FE36", "86400.002 0000021A#R2"], {"comment": 1}),
    ("a.log", EVENTS + "0.3 1  201  Rx  d 2 01 7F\n", ["0.3 201#017F"], {"header": 3}),
]  # fmt: skip


def lines_of(path: Path) -> tuple[list[str], dict[str, int]]:
    """Frames as `time id#data`, counts of what is no frame; counts add up to the lines."""
    reader = open_reader(path, strict=False)
    frames = [frame for block in reader.blocks() for frame in block.frames()]
    counts = {verdict.name.lower(): n for verdict, n in reader.counts.items() if n}
    good = ("ok", "fd", "remote", "error_frame")
    assert sum(counts.values()) == reader.lines
    assert sum(counts.get(name, 0) for name in good) == len(frames)
    found = []
    for frame in frames:
        whole, part = divmod(frame.t_ns, 10**9)
        time = f"{whole}.{part:09}".rstrip("0").rstrip(".")
        found.append(f"{time} {format_frame(frame).decode().split(maxsplit=2)[-1]}")
    return found, {name: n for name, n in counts.items() if name not in good}


@pytest.mark.parametrize(("name", "text", "frames", "counts"), TEXTS)
@pytest.mark.parametrize("encoding", ["utf-8", "gz", "utf-16"])
def test_lines(
    tmp_path: Path, name: str, text: str, frames: list[str], counts: dict[str, int], encoding: str
) -> None:
    path = tmp_path / name
    data = text.lstrip("\ufeff").encode(encoding) if encoding == "utf-16" else text.encode()
    path.write_bytes(gzip.compress(data) if encoding == "gz" else data)
    assert lines_of(path) == (frames, counts)


def test_times_before_the_trigger_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.asc"
    path.write_text(EVENTS + "-0.02 1 181 Rx d 1 01\n0.0 1 181 Rx d 1 02\n")
    assert lines_of(path)[0] == ["0.98 181#01", "1 181#02"]
    reader = open_reader(path, strict=False)
    assert list(reader.blocks())
    assert reader.notes == ["times begin before 0: all are moved forward by 1 s"]


@pytest.mark.parametrize("day", ["Mit M\xe4r 4 10:30:21.000 2020", "mer. mars 4 10:30:21 2020"])
def test_dates_of_other_languages(tmp_path: Path, day: str) -> None:
    later = day.replace("10:30:21", "10:30:31")
    path = tmp_path / "a.asc"
    text = (
        f"date {day}\nbase hex timestamps absolute\n// f\xfcr 90 \xb0C\nBegin Triggerblock {day}\n"
    )
    text += f"0.5 1 181 Rx d 1 01\nBegin Triggerblock {later}\n0.0 1 181 Rx d 1 02\n"
    path.write_bytes(text.encode("cp1252"))
    assert lines_of(path)[0] == ["0.5 181#01", "10 181#02"]


@pytest.mark.parametrize("name", ["a.asc", "a.trc", "a.csv"])
def test_strict_stops_at_the_first_fault_and_gives_what_came_before(
    tmp_path: Path, name: str
) -> None:
    heads = {"a.asc": EVENTS, "a.trc": TRC.format("1.1"), "a.csv": "time,id,len,data\n"}
    good = {"a.asc": "{} 1 300 Rx d 1 11", "a.trc": " 1) {} Rx 0300 1 11", "a.csv": "{},300,1,11"}
    text = heads[name] + "".join(good[name].format(k) + "\n" for k in range(4))
    path = tmp_path / name
    path.write_text(text + "what is this\n" + text[len(heads[name]) :])
    reader = open_reader(path, strict=True)
    blocks = reader.blocks()
    assert next(blocks).size == 4
    with pytest.raises(LogError, match="what is this") as caught:
        next(blocks)
    assert caught.value.line == reader.lines == 5 + heads[name].count("\n")


MANY = [
    f"{k / 1000:.6f} {1 + k % 3}  {0x180 + k % 5:X} Rx d {k % 9} " + " ".join(["5A"] * (k % 9))
    for k in range(3000)
]
ODD = {
    "0.5 1 Statistic: D 0 R 0": "event", "0.5 1 18F Rx d 2 AA": "bad_length", "// a comment": "comment",
    "0.5 1 ErrorFrame": "error_frame", "0.5 1 18F Rx d 1 XX": "bad_length", "": "blank", "0.5": "malformed",
    "0.5 CANFD 1 Rx 18F 1 0 8 8 01 02 03 04 05 06 07 08 0 0 323000": "fd", "0.5 1 18F Rx r 3": "remote",
    "0.5 1 FFF Rx d 1 11": "bad_id", "0.5 1 18F TxRq d 1 11": "request", "0.5 1 18F Rx d 1 1": "malformed",
    "0.5 1 18F Rx d 1 11 22": "bad_length", "0.5 1 18F Rx d 1 11 Length = 1": "ok",
}  # fmt: skip


@pytest.mark.parametrize("every", [1, 2, 7, 40, 999])
@pytest.mark.parametrize("odd", ODD)
def test_lines_one_by_one_and_many_at_once(tmp_path: Path, odd: str, every: int) -> None:
    """Compiled for runs of plain lines; the others in between are read by Python."""
    lines = list(MANY[:700] if every < 40 else MANY)
    for k in range(len(lines) // every * every, 0, -every):
        lines.insert(k, odd)
    path = tmp_path / "a.asc"
    path.write_text(EVENTS + "\n".join(lines) + "\n")
    frames, counts = lines_of(path)
    expected: Counter[str] = Counter()
    for line in lines:
        if line in ODD:
            expected[ODD[line]] += 1
    good = {"ok", "fd", "remote", "error_frame"}
    assert counts == {"header": 3, **{n: k for n, k in expected.items() if n not in good}}
    wanted = [line for line in lines if ODD.get(line, "ok") in good]
    assert len(frames) == len(wanted)
    for frame, line in zip(frames, wanted, strict=True):
        if line not in ODD:
            words = line.split()
            data = "".join(words[6:])
            assert frame.split()[1] == f"{words[2]}#{data}"
            assert float(frame.split()[0]) == float(words[0])


@pytest.mark.parametrize("base", ["hex", "dec"])
def test_a_base_that_changes(tmp_path: Path, base: str) -> None:
    other = "dec" if base == "hex" else "hex"
    lines = [f"{k}.0 1 100 Rx d 1 16" for k in range(50)]
    path = tmp_path / "a.asc"
    path.write_text("\n".join([f"base {base}", *lines, f"base {other}", *lines, ""]))
    said = {"hex": "100#16", "dec": "064#10"}
    frames, _ = lines_of(path)
    assert [f.split()[1] for f in frames] == [said[base]] * 50 + [said[other]] * 50


@pytest.mark.timeout(60)  # of minutes if every line were looked at
@pytest.mark.parametrize("suffix", [".asc", ".trc", ".asc.gz", ".csv"])
def test_gigabytes_of_blank_lines(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"log{suffix}"
    text = b"\n" * (200 << 20)
    path.write_bytes(gzip.compress(text, 1) if suffix.endswith(".gz") else text)
    assert lines_of(path) == ([], {"blank": 200 << 20})


# ---- patterns ----------------------------------------------------------------------------------


def test_a_pattern(tmp_path: Path) -> None:
    path = tmp_path / "a.dat"
    path.write_text("time id data\n3E8 181 01 02\n3E9 18FEF100 0x03,0x4\n3EA oops\n3EB 181 01 02")
    reader = open_reader(path, strict=False, line="{ms:x} {id:x} {data}")
    frames = [frame for block in reader.blocks() for frame in block.frames()]
    assert [(f.t_ns, f.can_id, f.data, f.flags) for f in frames] == [
        (1_000_000_000, 0x181, b"\1\2", 0), (1_001_000_000, 0x18FEF100, b"\3\4", 1),
        (1_003_000_000, 0x181, b"\1\2", 0),
    ]  # fmt: skip
    assert reader.counts[Verdict.HEADER] == reader.counts[Verdict.MALFORMED] == 1
    assert reader.problems[0].line == 4
    assert "column 5: {id} expected, 'oops' found" in reader.problems[0].text


def test_fields_in_any_order(tmp_path: Path) -> None:
    path = tmp_path / "a.dat"
    path.write_text(
        "[2] 17,3 can7 <385> 2023-05-15T10:00:00.25 x\n[1] 9 can8 <386> 2023-05-15T10:00:01 y\n"
    )
    reader = open_reader(
        path, strict=False, line="[{dlc}] {data:d} {channel} <{id:d}> {date} {skip}"
    )
    frames = [frame for block in reader.blocks() for frame in block.frames()]
    assert [(f.t_ns, f.can_id, f.data, f.channel) for f in frames] == [
        (1_684_144_800_250_000_000, 385, bytes([17, 3]), "can7"),
        (1_684_144_801_000_000_000, 386, bytes([9]), "can8"),
    ]


@pytest.mark.parametrize(
    ("pattern", "why"),
    [("{id} {data}", "needs one time"), ("{s} {ms} {id} {data}", "needs one time"),
     ("{s} {id} {id} {data}", "{id} stands twice"), ("{s} {ident} {data}", "{ident}"),
     ("{s} {id} {data", "is no field")],
)  # fmt: skip
def test_patterns_that_cannot_be_used(pattern: str, why: str) -> None:
    with pytest.raises(PatternError, match=why):
        Pattern(pattern)


@pytest.mark.parametrize(
    ("lines", "pattern"),
    [(["12.5 0x181 2 01 02", "12.6 0x181 2 01 03"], "{s} {id} {dlc} {data}"),
     (["1F4 181 01 02 03", "1F5 181 01 02 03"], "{ms:x} {id} {data}"),
     (["12.5,181,0102", "12.6,181,0103"], "{s},{id},{data}"),
     (["nothing of that kind"], None)],
)  # fmt: skip
def test_a_pattern_is_proposed(lines: list[str], pattern: str | None) -> None:
    found = proposed(lines)
    assert (found[0] if found else None) == pattern


# ---- BLF ---------------------------------------------------------------------------------------

START = (2025, 9, 1, 29, 13, 0, 0, 0)
START_NS = 1_759_150_800_000_000_000


def blf_object(kind: int, t_ns: int, body: bytes) -> bytes:
    """One with a header of version 1, in nanoseconds."""
    head = struct.pack("<4sHHLL", b"LOBJ", 32, 1, 32 + len(body), kind)
    data = head + struct.pack("<LHHQ", 2, 0, 0, t_ns % 2**64) + body
    return data + bytes(-len(data) % 4)


def message(t_ns: int, can_id: int, data: bytes) -> bytes:
    return blf_object(1, t_ns, struct.pack("<HBBL8s", 1, 0, len(data), can_id, data))


def container(data: bytes) -> bytes:
    body = struct.pack("<H6xL4x", 2, len(data)) + zlib.compress(data)
    text = struct.pack("<4sHHLL", b"LOBJ", 16, 1, 16 + len(body), 10) + body
    return text + bytes(len(body) % 4)


def blf_file(path: Path, *parts: bytes, size: int = 0) -> Path:
    head = struct.pack(
        "<4sLBBBBBBBBQQLL8H8H", b"LOGG", 144, 5, *[0] * 7, size, 0, 0, 0, *START, *START
    )
    path.write_bytes(head.ljust(144, b"\0") + b"".join(parts))
    return path


def test_blf_counts_what_is_no_frame_and_has_times_before_the_start(tmp_path: Path) -> None:
    objects = (
        message(-60_000_000, 0x181, b"\1"),
        blf_object(6, 0, bytes(16)),
        message(7, 0x182, b""),
    )
    whole = b"".join(objects)
    for parts in ([container(whole)], [container(whole[:50]), container(whole[50:])], objects):
        reader = Blf(blf_file(tmp_path / "a.blf", *parts))
        assert [(f.t_ns - START_NS, f.can_id) for f in reader] == [(-60_000_000, 0x181), (7, 0x182)]
        assert dict(reader.counts) == {Verdict.OK: 2, Verdict.EVENT: 1}
        assert reader.lines == 3


@pytest.mark.parametrize("cut", [5, 30, 60])
def test_blf_that_is_cut_or_damaged_says_so(tmp_path: Path, cut: int) -> None:
    whole = container(b"".join(message(k, 0x181, b"\1") for k in range(5)))
    path = blf_file(tmp_path / "a.blf", whole, whole)
    path.write_bytes(path.read_bytes()[:-cut])
    reader = Blf(path)
    frames = list(reader)
    assert 5 <= len(frames) <= 10
    assert reader.counts[Verdict.CUT] == 1
    assert f"ends early after {len(frames)} frames" in reader.truncated
    with pytest.raises(LogError, match="ends early"):
        list(Blf(path, strict=True).blocks())
    path = blf_file(tmp_path / "b.blf", whole, b"rubbish!" * 9, whole)
    reader = Blf(path)
    assert len(list(reader)) == 10
    assert reader.counts[Verdict.MALFORMED] in range(1, 11)  # about a container may be lost
