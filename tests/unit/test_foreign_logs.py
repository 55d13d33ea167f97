"""Logs of other programs: the right frames, and a count for every line or object that is none.

Each case is of a kind that people have reported: the sources are python-can's issues 255, 1595,
1786, 2022 and 2101, can-utils' 348, lib.c and candump.c, PEAK's and Vector's descriptions of their formats,
SavvyCAN's exporters, BUSMASTER's log converter, and CSS' description of the CLX000 format.
"""
# ruff: noqa: E501 lines of logs

import gzip
from collections import Counter

import pytest

from dbc.candump.grammar import Verdict, format_frame
from dbc.candump.reader import LogError
from dbc.logs.dialects import BUSMASTER, SCREEN
from dbc.logs.opening import open_reader
from dbc.logs.pattern import Pattern, PatternError
from dbc.logs.proposals import proposed
from dbc.logs.screen import DIFFERENCES, LOCAL, SINCE_START
from gateway.cli import main
from tests.work import calls

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


def lines_of(path):
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
def test_lines(tmp_path, name, text, frames, counts, encoding):
    path = tmp_path / name
    data = text.lstrip("\ufeff").encode(encoding) if encoding == "utf-16" else text.encode()
    path.write_bytes(gzip.compress(data) if encoding == "gz" else data)
    assert lines_of(path) == (frames, counts)


def test_times_before_the_trigger_are_kept(tmp_path):
    path = tmp_path / "a.asc"
    path.write_text(EVENTS + "-0.02 1 181 Rx d 1 01\n0.0 1 181 Rx d 1 02\n")
    assert lines_of(path)[0] == ["0.98 181#01", "1 181#02"]
    reader = open_reader(path, strict=False)
    assert list(reader.blocks())
    assert reader.notes == ["times begin before 0: all are moved forward by 1 s"]


@pytest.mark.parametrize("name", ["a.asc", "a.trc", "a.csv"])
def test_strict_stops_at_the_first_fault_and_gives_what_came_before(tmp_path, name):
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


@pytest.mark.parametrize("every", [1, 7, 999])
@pytest.mark.parametrize("odd", ODD)
def test_lines_one_by_one_and_many_at_once(tmp_path, odd, every):
    """Compiled for runs of plain lines; the others in between are read by Python."""
    lines = list(MANY[:700] if every < 40 else MANY)
    for k in range(len(lines) // every * every, 0, -every):
        lines.insert(k, odd)
    path = tmp_path / "a.asc"
    path.write_text(EVENTS + "\n".join(lines) + "\n")
    frames, counts = lines_of(path)
    expected = Counter()
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
def test_a_base_that_changes(tmp_path, base):
    other = "dec" if base == "hex" else "hex"
    lines = [f"{k}.0 1 100 Rx d 1 16" for k in range(50)]
    path = tmp_path / "a.asc"
    path.write_text("\n".join([f"base {base}", *lines, f"base {other}", *lines, ""]))
    said = {"hex": "100#16", "dec": "064#10"}
    frames, _ = lines_of(path)
    assert [f.split()[1] for f in frames] == [said[base]] * 50 + [said[other]] * 50


@pytest.mark.parametrize("suffix", [".asc", ".trc", ".asc.gz", ".csv"])
def test_gigabytes_of_blank_lines(tmp_path, suffix):
    path = tmp_path / f"log{suffix}"
    text = b"\n" * (50 << 20)
    path.write_bytes(gzip.compress(text, 1) if suffix.endswith(".gz") else text)
    read = []
    work = calls(lambda: read.append(lines_of(path)))
    assert work < len(text) / 100, "not every line is looked at"
    assert read == [([], {"blank": 50 << 20})]


# ---- patterns ----------------------------------------------------------------------------------


def test_a_pattern(tmp_path):
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


def test_fields_in_any_order(tmp_path):
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
     ("{s} {id} {id} {data}", "{id} is given twice"), ("{s} {ident} {data}", "{ident}"),
     ("{s} {id} {data", "is no field")],
)  # fmt: skip
def test_patterns_that_cannot_be_used(pattern, why):
    with pytest.raises(PatternError, match=why):
        Pattern(pattern)


BUS = "***BUSMASTER Ver 3.2.2***\n***PROTOCOL CAN***\n***{}***\n***{} MODE***\n"
PANDAS = "timestamp,arbitration_id,extended,remote,error,dlc,data\n"

DIALECTS = [
    # candump -ta: length of FD in two digits, 29 bits in eight, remote and error frames.
    ("a.log", " (1684144800.1)  can0  no frame\n"
     " (1684144800.100000)  can0  123   [0]  remote request\n (1684144800.200000)  can0  123   [8]  remote request\n"
     " (1684144800.300000)  can0  00000123   [2]  01 02\n (1684144800.400000)  can0  124  [08]  11 22 33 44 55 66 77 88\n"
     " (1684144800.500000)  can0  20000080   [8]  00 00 00 00 00 00 00 00   ERRORFRAME\n"
     " (1684144800.600000)  can0  123   [2]  AB 01                     '.A'\n (1684144800.7) x\n",
     ["1684144800.1 123#R", "1684144800.2 123#R8", "1684144800.3 00000123#0102",
      "1684144800.4 124##01122334455667788", "1684144800.5 20000080#0000000000000000",
      "1684144800.6 123#AB01"], {"malformed": 2}),
    # -x: direction, BRS, ESI. -8: a raw length.
    ("a.log", " (1684144800.100000)  can0  RX - -  123   [2]  01 02\n (1684144800.200000)  can0  TX B -  123  [02]  01 02\n"
     " (1684144800.300000)  can0  RX B E  123  [00] \n (1684144800.400000)  can0  123   {9}  01 02 03 04 05 06 07 08\n",
     ["1684144800.1 123#0102", "1684144800.2 123##10102 T", "1684144800.3 123##3",
      "1684144800.4 123#0102030405060708_9"], {}),
    ("a.log", "$ candump -ta can0\n (1684144800.100000)  can0  8FF   [1]  01\n (1684144800.200000)  can0  123   [2]  01\n"
     " (1684144800.300000)  can0  123   [0] \n (1684144800.400000)  can0       123 [0012] (00|81:00:00000000)  01 02 ...\n"
     + "".join(f" (1684144800.{k}00000)  can0  123   [1]  01\n" for k in range(5, 9)),
     ["1684144800.3 123#", *(f"1684144800.{k} 123#01" for k in range(5, 9))], {"header": 1, "bad_id": 1, "bad_length": 1, "xl": 1}),
    # `remote request` was cut off, or not: nobody knows.
    ("a.log", " (1684144800.100000)  can0  123   [1]  01\n (1684144800.200000)  can0  123   [0]",
     ["1684144800.1 123#01"], {"cut": 1}),
    ("a.log", " (2023-05-15 10:00:00.100000)  can0  123   [1]  01\n (2023-05-15 10:00:00.123456789)  can0  123   [1]  02\n",
     ["1684144800.1 123#01", "1684144800.123456789 123#02"], {}),
    # BUSMASTER: base of its numbers, time from the line before, error frames, CAN FD.
    ("a.log", BUS.format("DEC", "SYSTEM") + "16:08:48:7100 Rx 1 385 s 8 255 001 2 3 4 5 6 016 \n"
     "16:08:48:7200 Rx 1 386 s 0 \n16:08:48:7300 Rx 2 387 sr 3 \n16:08:48:7400 Rx 1 387 s 1 256\n",
     ["58128.71 181#FF01020304050610", "58128.72 182#", "58128.73 183#R3"], {"comment": 4, "malformed": 1}),
    ("a.log", BUS.format("HEX", "RELATIVE") + "00:00:00:0000 Rx 1 0x181 s 1 01\n00:00:00:0100 Rx 1 0x181 s 1 02\n"
     "00:00:00:0100 Rx 1 ERR StuffError\n00:00:00:0050 Rx 1 what is this\n00:00:00:0050 Tx 1 0x181 x-fd 2 01 02\n",
     ["0 181#01", "0.01 181#02", "0.02 20000000#", "0.03 00000181##00102 T"], {"comment": 4, "malformed": 1}),
    ("a.log", BUS.format("HEX", "ABSOLUTE") + "00:00:01:0000 Rx 1 16 s 1 16\n" + BUS.format("DEC", "RELATIVE")
     + "00:00:02:0000 Rx 1 16 s 1 16\n00:00:01:0000 Rx 1 16 s 1 16\n", ["1 016#16", "2 010#10", "3 010#10"],
     {"comment": 8}),
    # `ERR` in place of the type, with and without an identifier and a length.
    ("a.log", BUS.format("HEX", "SYSTEM") + "00:00:01:0000 Rx 1 0x181 s 1 01\n00:00:01:0010 Rx 1 0x0 ERR 0\n"
     "00:00:01:0020 Tx 1 0x0 ERR 1 08 \n00:00:01:0030 Rx 1 0x0 ERR 2 08\n",
     ["1 181#01", "1.001 20000000#", "1.002 20000000#08 T"], {"comment": 4, "bad_length": 1}),
    # candump -c, all of its three ways to colour.
    ("a.log", " (1684144800.100000)  \x1b[31m  can0\x1b[0m  123   [1]  01\n (1684144800.200000)  \x1b[1;32m  can0  123   [1]  02\x1b[0m\n"
     " \x1b[33m(1684144800.300000)   can0  123   [0]  remote request\x1b[0m\n",
     ["1684144800.1 123#01", "1684144800.2 123#02", "1684144800.3 123#R"], {}),
    # python-can's text, of versions 4 and 2: kinds, text behind the data, no channel; what can_logger prints before.
    ("a.txt", "Connected to SocketcanBus: socketcan channel 'can0'\n"
     "Timestamp:        1.500000    ID:      181    S Rx                DL:  2    01 02                       Channel: can0\n"
     "Timestamp:        1.600000    ID: 00000181    X Tx   R            DL:  4                                Channel: can0\n"
     "Timestamp:        1.700000    ID:      181    S Rx     F BS EI    DL:  2    41 42                       'AB'    Channel: can0\n"
     "Timestamp:        1.800000    ID: 00000004    X Rx E              DL:  1    01\n"
     "Timestamp:        1.900000        ID: 0181    S                   DLC:  1    41                          'A'\n"
     "Timestamp:        2.000000    ID:      181    S Rx                DL:  2    01\nan error\n"
     "Timestamp:        2.100000    ID:      181    S Rx                DL:  1    01                          Channel: ca",
     ["1.5 181#0102", "1.6 00000181#R4 T", "1.7 181##34142", "1.8 20000004#01", "1.9 181#41"],
     {"header": 1, "bad_length": 1, "malformed": 1, "cut": 1}),
    # Only error frames: the first line says whose log it is.
    ("a.txt", BUS.format("HEX", "SYSTEM") + "00:00:01:0000 Rx 1 0 ERR BusOff\n", ["1 20000000#"], {"comment": 4}),
    ("a.crtd", "1.0 CXX OVMS\n1.1 1CEV Something\n1.5 1R11 402 FA 01\n1.6 2T29 123 01\n1.7 E11 402\n",
     ["1.5 402#FA01", "1.6 00000123#01 T"], {"comment": 2, "malformed": 1}),
    # CSV: pandas' index, quotes, exponents, dates with nanoseconds, a header that comes again.
    ("a.csv", "," + PANDAS + "0,1.5,0x181,False,False,False,2,AQI=\n1,1.68e+09,0x181,True,False,False,2.0,AQI=\n"
     "2,2023-05-15 10:00:00.123456789+00:00,0x181,False,True,False,4,\n",
     ["1.5 181#0102", "1680000000 00000181#0102", "1684144800.123456789 181#R4"], {"header": 1}),
    ("a.csv", '\n# made by hand\n"timestamp","arbitration_id","dlc","note","data"\n"1.5","0x181","2","a, b","AQI="\n'
     + "dlc,data,timestamp,arbitration_id\n2,AQI=,1.6,0x182\n1.7,0x182\n",
     ["1.5 181#0102", "1.6 182#0102"], {"header": 2, "blank": 1, "comment": 1, "malformed": 1}),
    # CL1000 and CL2000: types, stamps with the date or the day alone.
    ("a.txt", "# Logger type: CL2000\n# Time: 20230531T095959\n# Time format: 4\nTimestamp;Type;ID;Data\n"
     "31T100000250;0;123;0102\n31T100000260;1;123;\n01T000000000;9;18FEF100;01\n31T100000260;5;123;01\n",
     ["1685527200.25 123#0102", "1685527200.26 00000123#", "1685577600 18FEF100#01 T"],
     {"comment": 3, "header": 1, "malformed": 1}),
    ("a.csv", "Timestamp;Lost;Type;ID;Length;Data\n20230515T100000250;0;0;123;2;0102\n1684144801.5;0;1;123;1;01\n"
     "2023-05-15T10:00:02.250;0;8;123;1;01\n", ["1684144800.25 123#0102", "1684144801.5 00000123#01",
     "1684144802.25 123#01 T"], {"header": 1}),
]  # fmt: skip


@pytest.mark.parametrize(("name", "text", "frames", "counts"), DIALECTS)
def test_lines_of_dialects(tmp_path, name, text, frames, counts):
    path = tmp_path / name
    path.write_text(text)
    assert lines_of(path) == (frames, counts)


@pytest.mark.parametrize(
    ("stamps", "times", "note"),
    [
        ([0, 0.1, 0.100002, 0.099998], ["0", "0.1", "0.200002", "0.3"], DIFFERENCES),
        ([0, 0.1, 0.1, 0.1], ["0", "0.1", "0.2", "0.3"], DIFFERENCES),
        ([0, 0.1, 0.25], ["0", "0.1", "0.25"], SINCE_START),
        ([0, 0.1], ["0", "0.1"], SINCE_START),
        ([0], ["0"], SINCE_START),
    ],
)
@pytest.mark.parametrize("between", ["\n", "\n\n\n\n"])
def test_candumps_differences_and_times_since_the_start(tmp_path, stamps, times, note, between):
    path = tmp_path / "a.log"
    lines = [f" ({stamp:010.6f})  can0  123   [1]  01{between}" for stamp in stamps]
    path.write_text("".join(lines))
    reader = open_reader(path, strict=False)
    found = [frame.t_ns for block in reader.blocks() for frame in block.frames()]
    assert found == [round(float(time) * 1e9) for time in times]
    assert reader.notes == [note]


def test_a_date_without_a_zone_is_said(tmp_path):
    path = tmp_path / "a.log"
    path.write_text(" (2023-05-15 10:00:00.100000)  can0  123   [1]  01\n")
    reader = open_reader(path, strict=False)
    assert list(reader.blocks())
    assert reader.notes == [LOCAL]


@pytest.mark.parametrize("line", ["  can0  RX - -  123   [2]  01 02", "  can0  123   [2]  01 02"])
def test_without_times_the_cure_is_named(tmp_path, capsys, line):
    path = tmp_path / "a.log"
    path.write_text(line + "\n")
    assert main(["convert", str(path), str(tmp_path / "out.log"), "--frames"]) == 2
    assert "record with `candump -L IF`" in " ".join(capsys.readouterr().err.split())


NO_COLUMNS = "no header names columns for time, identifier and data"


@pytest.mark.parametrize(("header", "row", "problem"), [
    ("Timestamp;Type;ID;Data", "100000250;0;123;0102",
     "unknown time '100000250', not 15T100000250 or sec"),
    ("t_s,channel,message,A.Speed", "0.5,0x181,1,AQ==", NO_COLUMNS),
    ("timestamp,arbitration_id,dlc", "0.5,0x181,1,AQ==", NO_COLUMNS),
    ("0.5,0x181,1", "0.5,0x181,1,AQ==", NO_COLUMNS), ("a", "0.5,0x181,1,AQ==", NO_COLUMNS),
])  # fmt: skip
def test_what_no_frame_can_be_made_of_is_named(tmp_path, header, row, problem):
    path = tmp_path / "a.csv"
    path.write_text(f"{header}\n{row}\n")
    reader = open_reader(path, strict=False)
    assert not list(reader.blocks())
    assert reader.counts[Verdict.MALFORMED] > 0
    assert reader.problems[0].text.startswith(problem)


@pytest.mark.parametrize(
    ("text", "pattern"),
    [(BUS.format("DEC", "SYSTEM") + "16:08:48:7100 Rx 1 385 s 2 255 001\n", BUSMASTER),
     (" (1684144800.100000)  can0  00000123   [8]  remote request\n", SCREEN)],
)  # fmt: skip
def test_a_proposed_pattern_is_read_as_the_recorder_wrote_it(tmp_path, text, pattern):
    found = proposed(text.splitlines())
    assert found is not None
    assert found[:3] == (pattern, 1, 0)
    path = tmp_path / "a.dat"
    path.write_text(text)
    by_hand, by_content = (
        open_reader(path, strict=False, line=pattern),
        open_reader(path, strict=False),
    )
    assert [f for b in by_hand.blocks() for f in b.frames()] == [
        f for b in by_content.blocks() for f in b.frames()
    ]
