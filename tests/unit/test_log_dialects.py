"""Text logs of candump's screen, BUSMASTER, CRTD, pandas and CL2000, as these programs write them.

The forms are those of can-utils' lib.c and candump.c, BUSMASTER's log converter, and CSS'
description of the CLX000 format.
"""
# ruff: noqa: E501 lines of logs

from __future__ import annotations

from pathlib import Path

import pytest

from dbc.candump.grammar import Verdict
from dbc.logs.dialects import BUSMASTER, SCREEN
from dbc.logs.opening import open_reader
from dbc.logs.proposals import proposed
from dbc.logs.screen import DIFFERENCES, LOCAL, SINCE_START, is_screen_form
from gateway.cli import main
from tests.unit.test_foreign_logs import lines_of

BUS = "***BUSMASTER Ver 3.2.2***\n***PROTOCOL CAN***\n***{}***\n***{} MODE***\n"
PANDAS = "timestamp,arbitration_id,extended,remote,error,dlc,data\n"

TEXTS = [
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


@pytest.mark.parametrize(("name", "text", "frames", "counts"), TEXTS)
def test_lines(
    tmp_path: Path, name: str, text: str, frames: list[str], counts: dict[str, int]
) -> None:
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
def test_candumps_differences_and_times_since_the_start(
    tmp_path: Path, stamps: list[float], times: list[str], note: str, between: str
) -> None:
    path = tmp_path / "a.log"
    lines = [f" ({stamp:010.6f})  can0  123   [1]  01{between}" for stamp in stamps]
    path.write_text("".join(lines))
    reader = open_reader(path, strict=False)
    found = [frame.t_ns for block in reader.blocks() for frame in block.frames()]
    assert found == [round(float(time) * 1e9) for time in times]
    assert reader.notes == [note]


def test_frames_of_two_channels_in_another_order_are_no_differences(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    stamps = [k / 1000 for k in range(100)]
    stamps[50], stamps[51] = stamps[51], stamps[50]
    path.write_text("".join(f" ({t:010.6f})  can0  123   [1]  01\n" for t in stamps))
    reader = open_reader(path, strict=False)
    found = [frame.t_ns for block in reader.blocks() for frame in block.frames()]
    assert found == [round(t * 1e9) for t in stamps]


def test_a_date_without_a_zone_is_said(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_text(" (2023-05-15 10:00:00.100000)  can0  123   [1]  01\n")
    reader = open_reader(path, strict=False)
    assert list(reader.blocks())
    assert reader.notes == [LOCAL]


@pytest.mark.parametrize(
    ("line", "screen"),
    [("  can0  123   [2]  01 02", True), ("  can0  RX - -  123   [2]  01 02", True),
     ("  can0  TX B E  123  [02]  01 02", True), ("  can0  123   [2]  01 02   '..'", True),
     ("  can0  123   [8]  remote request", True), (" (2023-05-15 10:00:00.123456)  can0  123   [0] ", True),
     ("can0 123#01", False), ("nothing of that kind", False)],
)  # fmt: skip
def test_the_form_of_a_screen(line: str, screen: bool) -> None:
    assert is_screen_form(line) is screen


@pytest.mark.parametrize("line", ["  can0  RX - -  123   [2]  01 02", "  can0  123   [2]  01 02"])
def test_without_times_the_cure_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], line: str
) -> None:
    path = tmp_path / "a.log"
    path.write_text(line + "\n")
    assert main(["convert", str(path), str(tmp_path / "out.log"), "--frames"]) == 2
    assert "record with `candump -L IF`" in " ".join(capsys.readouterr().err.split())


def test_a_stamp_that_may_mean_anything_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("Timestamp;Type;ID;Data\n100000250;0;123;0102\n")
    reader = open_reader(path, strict=False)
    assert not list(reader.blocks())
    assert reader.counts[Verdict.MALFORMED] == 1
    assert reader.problems[0].text.startswith("unknown time '100000250', not 15T100000250 or sec")


@pytest.mark.parametrize(
    ("text", "pattern"),
    [(BUS.format("DEC", "SYSTEM") + "16:08:48:7100 Rx 1 385 s 2 255 001\n", BUSMASTER),
     (" (1684144800.100000)  can0  00000123   [8]  remote request\n", SCREEN)],
)  # fmt: skip
def test_a_proposed_pattern_is_read_as_the_recorder_wrote_it(
    tmp_path: Path, text: str, pattern: str
) -> None:
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
