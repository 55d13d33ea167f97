"""Logs of people's programs that are odd and yet right, or wrong in a way that must be seen."""

from __future__ import annotations

import struct

import can
import pytest

from dbc.candump.grammar import format_frame
from dbc.logs.opening import open_reader
from dbc.logs.proposals import proposed
from dbc.tolerant import read_any_dbc

ASC = "date Mon Mar 4 10:31:20.000 am 2024\nbase hex  timestamps absolute\n"
TRC = ";$FILEVERSION=1.1\n;$STARTTIME=37704.5\n"
CSV = "timestamp,id,extended,rtr,dlc,data\n"
START = 40
"""Of a BLF: where its year stands."""
SCREEN = " (1684144800.{:06d})  can0  {}\n"


def read(folder, name, text):
    """Frames as candump shows them, and counts of the lines that are none."""
    path = folder / name
    path.write_bytes(text.encode("latin-1"))
    reader = open_reader(path, strict=False)
    shown = [format_frame(frame).split()[-1].decode() for frame in reader]
    counts = {verdict.name.lower(): n for verdict, n in reader.counts.items() if n}
    return shown, counts


@pytest.mark.parametrize(("name", "text", "wanted", "fault"), [
    ("a.asc", ASC + "0.1 1 \xa0 Rx d 1 01\n0.2 1 123 Rx d 1 01\n", "123#01", "bad_id"),
    ("a.trc", TRC + " 1) 1059.9  Rx  \xa0  2  00 01\n 2) 1060.9  Rx  0123  2  00 01\n", "123#0001",
     "malformed"),
    ("a.asc", ASC + "0.1 1 102 Rx r e4\n0.2 1 123 Rx r 8\n", "123#R8", "bad_length"),
    ("a.csv", CSV + "0.1,0x181,0,1,200,\n0.2,0x181,0,1,8,\n", "181#R8", "bad_length"),
    ("a.csv", CSV + "0.1,181,0,0,2,1 2 3 4\n0.2,181,0,0,2,1 2\n", "181#0102", "bad_length"),
])  # fmt: skip
def test_what_is_no_frame_is_counted_and_the_next_one_is_read(tmp_path, name, text, wanted, fault):
    shown, counts = read(tmp_path, name, text)
    assert shown == [wanted]
    assert counts[fault] == 1


@pytest.mark.parametrize(("name", "text", "wanted"), [
    ("a.csv", "timestamp,id,data\n0.1,181,1 2 3 4\n", "181#01020304"),
    ("a.csv", 'timestamp,id,data\n0.2,181,"[12, 34, 255, 1]"\n', "181#0C22FF01"),
    ("a.csv", "timestamp,id,data\n0.2,181,0x0c22ff01\n", "181#0C22FF01"),
    ("a.csv", "time,addr,bus,data\n0.2,0x181,0,0x0c22ff01\n", "181#0C22FF01"),
    ("a.asc", ASC + "0.1 1 18FF60A2x Rx r Length = 0 BitCount = 0 ID = 18FF60A2x\n", "18FF60A2#R"),
])  # fmt: skip
def test_one_frame_in_an_unusual_form(tmp_path, name, text, wanted):
    assert read(tmp_path, name, text)[0] == [wanted]


def test_what_candump_says_of_an_error_frame_is_a_comment(tmp_path):
    """`candump -e`: lines with a tab behind it."""
    error = "20000088   [8]  00 00 80 19 00 00 08 00   ERRORFRAME"
    text = SCREEN.format(0, "123   [1]  11") + "".join(
        SCREEN.format(k, error) + "\tprotocol-violation{{bus-error}{}}\n\tbus-error\n"
        for k in range(1, 11)
    )
    shown, counts = read(tmp_path, "a.txt", text)
    assert len(shown) == 11
    assert counts == {"ok": 1, "error_frame": 10, "comment": 20}


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
