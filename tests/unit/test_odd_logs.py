"""Logs of people's programs that are odd and yet right, or wrong in a way that must be seen."""

import struct

import can
import pytest

from dbc.candump.grammar import Verdict, format_frame
from dbc.frame import SECOND
from dbc.logs.opening import open_reader
from dbc.logs.proposals import proposed
from dbc.tolerant import read_any_dbc
from gateway.cli import main

ASC = "date Mon Mar 4 10:31:20.000 am 2024\nbase hex  timestamps absolute\n"
TRC = ";$FILEVERSION={}\n;$STARTTIME=43000.0\n"


def read(folder, name, text, encoding="latin-1"):
    """Frames, counts of lines that are none, and notes."""
    path = folder / name
    path.write_bytes(text.encode(encoding))
    reader = open_reader(path, strict=False)
    frames = list(reader)
    counts = {verdict.name.lower(): n for verdict, n in reader.counts.items() if n}
    assert sum(counts.values()) == reader.lines == len(text.splitlines())
    for header in ("header", "ok", "fd", "remote", "error_frame"):
        counts.pop(header, None)
    return frames, counts, reader.notes


def shown(frames):
    return [format_frame(frame).split()[-1].decode() for frame in frames]


@pytest.mark.parametrize(
    ("line", "wanted"),
    [
        # Of python-can's test_CanFdMessage64.asc, shortened: flags 0x11, 12 bytes.
        ("0.1 CANFD 4 Rx 4EE 0 1 9 12 " + "A1 " * 12 + "1331984 11 0 46500250 460a0250", "##2"),
        ("0.1 CANFD 1 Rx 123 1 0 8 8 " + "11 " * 8 + "130000 130 0 0 0 0 0 0", "##1"),
        ("0.1 CANFD 1 Rx 123 0 0 8 8 " + "11 " * 8 + "130000 130 0 0 0 0 0 0", "#1"),
        ("0.1 CANFD 1 Rx 123 0 0 8 8 " + "11 " * 8 + "130000 130 1000 0 0 0 0 0", "##0"),
    ],
)
def test_fd_is_seen_from_size_and_switches_where_the_flag_is_left_out(tmp_path, line, wanted):
    frames, counts, _ = read(tmp_path, "a.asc", f"{ASC}{line}\n")
    assert not counts
    assert wanted in shown(frames)[0]


@pytest.mark.parametrize("base", ["hex", "dec"])
def test_a_name_that_could_be_a_number_is_a_name(tmp_path, base):
    """`ID =` says it, decimal in both bases; a frame without it has its number in front."""
    behind = "Length = 228000 BitCount = 118 ID = "
    lines = [f"base {base}  timestamps absolute"]
    lines += [f"0.{k} 1 {name} Rx d 2 01 02 {behind}{number}" for k, (name, number) in enumerate([
        ("AC", "386"), ("ABCDx", "419361024x"), ("EBC", "387"), ("FACE", "388"), ("Engine", "389"),
        ("AC", "386"), ("AC", "386"),
    ])]  # fmt: skip
    lines += ["0.8 1 123 Rx d 2 01 02"] * 40
    frames, counts, _ = read(tmp_path, "a.asc", "\n".join(lines) + "\n")
    assert not counts
    plain = "123#0102" if base == "hex" else "07B#0102"
    wanted = ["182#0102", "18FEF100#0102", "183#0102", "184#0102", "185#0102"]
    assert shown(frames) == [*wanted, "182#0102", "182#0102", *[plain] * 40]


@pytest.mark.parametrize(
    "whole",
    [
        "0.3 CANFD 1 Rx 123 1 0 8 8 01 02 03 04 05 06 07 08 130000 130 303000 a b c",
        "0.3 1 Eng Rx d 2 01 02 Length = 1 BitCount = 1 ID = 419361024x",
        "0.3 1 AC Rx d 2 01 02 Length = 1 BitCount = 1 ID = 419361024x",
        "0.3 1 123 Rx r 8",
        "0.3 1 123 Rx d 2 01 02 Length = 1 BitCount = 1 ID = 291",
        "0.3 1 18FEF100x Rx d 8 01 02 03 04 05 06 07 08",
    ],
)
def test_a_line_that_was_cut_is_another_frame_nowhere(tmp_path, whole):
    """Cut behind any character: the frame that it was, or none and the word `cut`."""
    for size in range(1, len(whole)):
        frames, counts, _ = read(tmp_path, "a.asc", f"{ASC}{whole}\n{whole[:size]}")
        twice = frames[1:] == frames[:1] and not counts
        assert twice or (len(frames) == 1 and counts == {"cut": 1}), whole[:size]


@pytest.mark.parametrize(
    ("first", "later", "encoding"),
    [
        ("Mit Mär 4 10:31:20.000 2020", "Mit Mär 4 10:31:21.500 2020", "utf-8"),
        ("Mit Mär 4 10:31:20.000 2020", "Mit Mär 4 10:31:21.500 2020", "latin-1"),
        ("04.03.2020 10:31:20", "04.03.2020 10:31:21.500", "utf-8"),
        ("2020-03-04 10:31:20", "2020-03-04 10:31:21,500", "utf-8"),
        ("03/04/2020 11:59:59 AM", "03/04/2020 12:00:00.5 PM", "utf-8"),
        ("Wed 4 Mar 2020 10:31:20", "Wed 4 Mar 2020 10:31:21.5", "utf-8"),
        ("Wed Mar 4 2020 10:31:20", "Wed Mar 4 2020 10:31:21.5", "utf-8"),
        ("Mit Dez 30 11:59:59 vorm. 2020", "Mit Dez 30 12:00:00.5 nachm. 2020", "utf-8"),
        ("mar. mars 3 10:31:20 2020", "mar. mars 3 10:31:21.5 2020", "utf-8"),
        ("mer. juil. 1 10:31:20 2020", "mer. juil. 1 10:31:21.5 2020", "utf-8"),
    ],
)
def test_a_second_block_is_as_much_later_as_its_date(tmp_path, first, later, encoding):
    block = "Begin Triggerblock {}\n0.0 1 123 Rx d 1 01\n0.1 1 123 Rx d 1 02\nEnd TriggerBlock\n"
    blocks = [block.format(date) for date in (first, later)]
    frames, counts, notes = read(tmp_path, "a.asc", ASC + "".join(blocks), encoding)
    assert [frame.t_ns * 10 // SECOND for frame in frames] == [0, 1, 15, 16]
    assert not counts
    assert not notes


def test_a_second_block_of_an_unknown_date_follows_the_first_and_a_note_says_so(tmp_path):
    block = "Begin Triggerblock yesterday\n0.0 1 123 Rx d 1 01\n0.1 1 123 Rx d 1 02\n"
    frames, _, notes = read(tmp_path, "a.asc", ASC + block + block)
    assert [frame.t_ns * 10 // SECOND for frame in frames] == [0, 1, 1, 2]
    assert notes == ["times restart at a date that cannot be read: they continue without a gap"]


def test_a_faulty_line_of_a_log_of_differences_keeps_its_own(tmp_path):
    bad = ["1 123", "1 123 Rx r", "1 123 Rx d", "1 123 Rx d 3 01", "CANFD 1 Rx", "1 XYZ Rx d 1 01"]
    lines = [f"0.1 {line}\n" for line in ["1 123 Rx d 1 01", *bad, "1 123 Rx d 1 03"]]
    text = "base hex  timestamps relative\n" + "".join(lines)
    frames, _, _ = read(tmp_path, "a.asc", text)
    assert frames[-1].t_ns == (len(bad) + 2) * SECOND // 10


@pytest.mark.parametrize("line", [
    "0.1 1  J1939TP FEE3p 6 0 0 - Rx d 23 A0 0F A6 60 3B D1 40 1F DE 80 25",
    "0.1 1  OverloadFrame",
    "0.1 1  Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%",
    "0.1 CAN 1 Status:chip status error active",
])  # fmt: skip
def test_what_is_no_frame_is_an_event(tmp_path, line):
    assert read(tmp_path, "a.asc", f"{ASC}{line}\n")[:2] == ([], {"event": 1})


def test_what_stands_behind_the_data_is_no_data(tmp_path):
    text = f"{ASC}0.1 1 123 Rx d 2 01 02  BitCount = 118\n0.2 1 123 Rx d 2 01 02 ACK\n"
    for base in ("hex", "dec"):
        frames, counts, _ = read(tmp_path, "a.asc", text.replace("hex", base))
        assert [frame.data for frame in frames] == [b"\1\2"] * 2
        assert not counts


@pytest.mark.parametrize(("version", "line"), [
    ("1.0", "     2)    17540 FFFFFFFF  4  00 00 00 08 -- -- -- -- BUSHEAVY"),
    ("1.1", "     2)    17540.1  Warng  FFFFFFFF  4  00 00 00 08  BUSHEAVY"),
    ("2.0", "     14   1500.300 EV Lap"),
    ("2.1", "     10   7024.500 EV 1  Lap 3"),
    ("2.1", "     10   7024.500 ST 1  -  Rx - 4 00 00 00 08"),
])  # fmt: skip
def test_a_state_in_a_trc_is_an_event(tmp_path, version, line):
    assert read(tmp_path, "a.trc", TRC.format(version) + line + "\n")[:2] == ([], {"event": 1})


def test_a_short_line_of_a_trc_is_a_fault(tmp_path):
    counts = read(tmp_path, "a.trc", TRC.format("2.1") + "     10   7024.500 DT 1\n")[1]
    assert counts == {Verdict.MALFORMED.name.lower(): 1}


CSV = "timestamp,id,extended,rtr,dlc,data\n"
START = 40
"""Of a BLF: where its year stands."""
SCREEN = " (1684144800.{:06d})  can0  {}\n"


@pytest.mark.parametrize(("name", "text", "wanted", "fault"), [
    ("a.asc", ASC + "0.1 1 \xa0 Rx d 1 01\n0.2 1 123 Rx d 1 01\n", "123#01", "bad_id"),
    ("a.trc", TRC.format("1.1") + " 1) 1059.9  Rx  \xa0  2  00 01\n 2) 1060.9  Rx  0123 2 00 01\n",
     "123#0001",
     "malformed"),
    ("a.asc", ASC + "0.1 1 102 Rx r e4\n0.2 1 123 Rx r 8\n", "123#R8", "bad_length"),
    ("a.csv", CSV + "0.1,0x181,0,1,200,\n0.2,0x181,0,1,8,\n", "181#R8", "bad_length"),
    ("a.csv", CSV + "0.1,181,0,0,2,1 2 3 4\n0.2,181,0,0,2,1 2\n", "181#0102", "bad_length"),
])  # fmt: skip
def test_what_is_no_frame_is_counted_and_the_next_one_is_read(tmp_path, name, text, wanted, fault):
    frames, counts, _ = read(tmp_path, name, text)
    assert shown(frames) == [wanted]
    assert counts == {fault: 1}


@pytest.mark.parametrize(("name", "text", "wanted"), [
    ("a.csv", "timestamp,id,data\n0.1,181,1 2 3 4\n", "181#01020304"),
    ("a.csv", 'timestamp,id,data\n0.2,181,"[12, 34, 255, 1]"\n', "181#0C22FF01"),
    ("a.csv", "timestamp,id,data\n0.2,181,0x0c22ff01\n", "181#0C22FF01"),
    ("a.csv", "time,addr,bus,data\n0.2,0x181,0,0x0c22ff01\n", "181#0C22FF01"),
    ("a.asc", ASC + "0.1 1 18FF60A2x Rx r Length = 0 BitCount = 0 ID = 18FF60A2x\n", "18FF60A2#R"),
])  # fmt: skip
def test_one_frame_in_an_unusual_form(tmp_path, name, text, wanted):
    assert shown(read(tmp_path, name, text)[0]) == [wanted]


def test_what_candump_says_of_an_error_frame_is_a_comment(tmp_path):
    """`candump -e`: lines with a tab behind it."""
    error = "20000088   [8]  00 00 80 19 00 00 08 00   ERRORFRAME"
    text = SCREEN.format(0, "123   [1]  11") + "".join(
        SCREEN.format(k, error) + "\tprotocol-violation{{bus-error}{}}\n\tbus-error\n"
        for k in range(1, 11)
    )
    frames, counts, _ = read(tmp_path, "a.txt", text)
    assert len(frames) == 11
    assert counts == {"comment": 20}


def test_times_of_two_interfaces_that_come_in_another_order_are_no_differences(tmp_path):
    stamps = [100 * k + (200, 0)[k % 2] for k in range(60)]
    lines = [f" (000.{t:06d})  can{k % 2}  100   [1]  11" for k, t in enumerate(stamps)]
    path = tmp_path / "a.txt"
    path.write_text("\n".join(lines) + "\n")
    assert max(frame.t_ns for frame in open_reader(path, strict=False)) < 10_000_000


@pytest.mark.parametrize(("short", "long"), [("S", "X"), ("STD", "EXT")])
def test_auto_sees_a_word_for_the_length_of_the_identifier(short, long):
    lines = [f"0.00{k} {short} 181 2 01 0{k}" for k in range(5)]
    lines += [f"0.00{k} {long} 00000182 2 01 0{k}" for k in range(5, 9)]
    found = proposed(lines)
    assert found is not None
    assert found.pattern == "{s} {type} {id} {dlc} {data}"


@pytest.mark.parametrize("count", [3, 40])
def test_a_blf_of_a_recorder_without_a_clock_counts_from_0(tmp_path, count):
    """SYSTEMTIME of 1601, with many objects and with few."""
    path = tmp_path / "a.blf"
    with can.BLFWriter(path) as writer:
        for k in range(count):
            writer.on_message_received(can.Message(1e9 + k / 1e3, 0x100, False, data=bytes(8)))
    data = bytearray(path.read_bytes())
    data[START : START + 2] = struct.pack("<H", 1601)
    path.write_bytes(data)
    frames = list(open_reader(path, strict=False))
    assert len(frames) == count
    assert frames[-1].t_ns < 1_000_000_000


def test_many_values_of_relations_that_nobody_defines_cost_themselves(tmp_path):
    good = [
        "BO_ 256 D: 8 B", ' SG_ X : 0|8@1+ (1,0) [0|0] "" B',
        'CM_ SG_ 256 X "speed";', 'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 1000;',
        'BA_ "GenMsgCycleTime" BO_ 256 20;',
    ]  # fmt: skip
    bad = [f'BA_REL_ "T{k}" BU_SG_REL_ B SG_ 256 X 0;' for k in range(18)]
    path = tmp_path / "a.dbc"
    path.write_text("\n".join(["BU_: B", *good, *bad]) + "\n")
    (spec,), notes = read_any_dbc(path)
    assert len(notes) == len(bad)
    assert all("BA_DEF_REL_" in note for note in notes)
    assert spec.cycle_ns == 20_000_000


def test_a_table_that_is_no_log_is_told_apart_in_full(tmp_path, capsys):
    path = tmp_path / "gray.csv"
    path.write_text("a,b,c\n1,2,3\n")
    assert main(["replay", str(path)]) == 2
    assert capsys.readouterr().err == (
        f"traction-gateway: {path}: cannot be read: not one of its 2 lines is a frame; line 1: "
        "malformed: no header names columns for time, identifier and data (docs/files.md): a,b,c; "
        f"for text of another program: `traction-gateway convert {path} OUT.log --line auto`\n"
    )


def test_mf4_without_its_library(tmp_path, capsys, monkeypatch):
    path = tmp_path / "a.mf4"
    path.write_bytes(b"MDF     4.10")
    monkeypatch.setattr("dbc.logs.mf4.mf4_module", lambda: None)
    assert main(["replay", str(path)]) == 2
    error = capsys.readouterr().err
    assert f"{path}: cannot be read: needs asammdf: pip install 'asammdf>=" in error
