"""Text logs and CSV of further recorders, in the forms of public files; the lines are made up."""

import re
import struct

import asammdf
import can
import numpy as np
import pytest

from dbc.candump.grammar import Verdict
from dbc.candump.reader import LogError
from dbc.frame import BRS, ESI, EXTENDED, FD, SECOND, TX
from dbc.logs.opening import open_reader
from dbc.logs.proposals import proposed
from dbc.spec import DbcMismatch
from dbc.text import decoded
from dbc.tolerant import read_any_dbc
from gateway.cli import main
from gateway.mapping.guess import SURE, candidates
from tests.unit.test_foreign_logs import lines_of
from tests.unit.test_odd_logs import read, shown

CANKING = "Chn Identifier Flg   DLC  D0...1...2...3...4...5...6..D7       Time     Dir\n"
CARBUS = "@ TEXT @ 3 @ 64 @ 0 @ 3 @ 21701 @ 00:00:21.701 @\r# $LocalTime=05:16:53.581\r"
VEHICLE_SPY = (
    "ISO8601 Timestamp,2018/06/29T13:00:47.000019,,\n\nLine,Abs Time(Sec),Rel Time (Sec),Status,Er,"
    "Tx,Description,Network,Node,Arb ID,Remote,Xtd,B1,B2,B3,B4,B5,B6,B7,B8,Value,Trigger,Signals\n"
)
IXXAT = (
    "ASCII Trace IXXAT MiniMon V3\nDate: 5/9/2024\n"
    '"Time","Identifier (hex)","Format","Flags","Data (hex)"\n'
)
ANALYZER = "ParserFlags\tCh\tCounter\tT/R\tTime\tFlags\tCAN ID\tLen\tData\n"
KVASER = (
    "CSV CAN data\n\nFormat of data field;{}\nFormat of id field;{}\n"
    "Time;Channel;id;Flags;DLC;Data0;Data1;Data2;Data3;Counter;AbsTime\n"
)
BYTES = "Timestamp,CAN_ID,DLC,DATA0,DATA1,DATA2,Label\n"
BUSMASTER = "***BUSMASTER Ver 2.4.0***\n***HEX***\n"

LOGS = [
    ("a.txt", CANKING + " 0    00000181         2  01  02                        1.500000 R\n"
     " 1    00002102 X       1  60                                    1.600000 T\n"
     " 0    00000000            ErrorFrame                        1.700000 R\n"
     " 0    00000182 Q       1  60                                    1.800000 T\n"
     "Logging stopped.\n",
     ["1.5 181#0102", "1.6 00002102#60 T", "1.7 20000000#"], {"comment": 2, "malformed": 1}),
    ("a.trc", CARBUS + "59,990000\t1\t00000004\t181\t2\t24 00                   \t00000000\t$ \t\r"
     "00,010000\t2\t00000005\t00000182\t1\t7F\t00000000\t\t\r01,010000\t2\t0006\t182\t1\t7F\t0000\t\t\r",
     ["59.99 181#2400", "60.01 00000182#7F"], {"comment": 2, "malformed": 1}),
    # Before python-can 2.0: a digit each for remote, 29 bits, error.
    ("a.txt", "Timestamp: 1.500000        ID: 0350    000    DLC: 2    05 28\n"
     "Timestamp: 1.600000        ID: 05f0    100    DLC: 8\n"
     "Timestamp: 1.700000    ID: 18ff0102    010    DLC: 1    05\n",
     ["1.5 350#0528", "1.6 5F0#R8", "1.7 18FF0102#05"], {}),
    ("a.csv", VEHICLE_SPY + "2,2550.368293675,0.003,8,F,F,HS,HS CAN,,119,F,F,00,1,,,,,,,7,,\n"
     "3,2550.5,0.001,67371008,F,T,,HS CAN,,18FF0102,F,T,01,02,03,,,,,,,,\n"
     "4,2550.6,0.001,67371008,F,F,,HS CAN,,120,T,F,,,,,,,,,,,\n",
     ["2550.368293675 119#0001", "2550.5 18FF0102#010203 T", "2550.6 120#R"],
     {"header": 2, "blank": 1}),
    ("a.csv", IXXAT + '"00:30:06.866","184","Std","","00 06"\n"00:30:06.882","374","Ext","","00"\n'
     '"00:30:06.892","374","Std","Rtr",""\n',
     ["1806.866 184#0006", "1806.882 00000374#00", "1806.892 374#R"], {"header": 3}),
    # Cabana: addresses are decimal, in later versions hexadecimal with 0x.
    ("a.csv", "time,addr,bus,data\n0.5,308,0,0acc\n0.6,0x440,1,0x4000\n",
     ["0.5 134#0ACC", "0.6 440#4000"], {"header": 1}),
    # Bytes of `arbitration_id` are Base64 in files of python-can only.
    ("a.csv", "Timestamp,Arbitration_ID,DLC,Data,Class\n0.5,153,3,20 A1 10,Normal\n"
     "0.6,153,4,20A11000,Normal\n0.7,153,3,20A1,Normal\n",
     ["0.5 153#20A110", "0.6 153#20A11000", "0.7 153#DB4035"], {"header": 1}),
    ("a.csv", '"Message Number","Time (ms)","Time","ID","Data (Hex)","Length"\n'
     '"0","1.500","8:09","0x2E1","10 21 ","2"\n',
     ["0.0015 2E1#1021"], {"header": 1}),
    # Kvaser's converter for the logs of a Memorator: error 32, sent 64, 29 bits 4, CAN FD 65536 ..
    ("a.csv", KVASER.format("DEC", "DEC") + "0,50000;1;385;2;2;16;99;;;1;2017-08-01\n"
     "0,60000;2;419365122;68;1;16;;;;2;\n0,70000;1;;34;;;;;;3;\n0,80000;1;385;196610;3;1;2;3;;4;\n"
     "0,90000;1;385;3;2;;;;;5;\n", ["0.5 181#1063", "0.6 18FF0102#10 T", "0.7 20000000#",
     "0.8 181##1010203", "0.9 181#R2"], {"header": 4, "blank": 1}),
    ("a.csv", KVASER.format("HEX", "HEX") + "0,50000;1;181;2;2;10;99;;;1;2017-08-01\n",
     ["0.5 181#1099"], {"header": 4, "blank": 1}),
    # Bytes are decimal if one has three digits, and none has a letter or a zero in front.
    ("a.csv", BYTES + "0.5,790,3,5,104,9,0\n0.6,399,1,16,,,1\n", ["0.5 316#056809", "0.6 18F#10"],
     {"header": 1}),
    ("a.csv", BYTES + "0.5,7e0,2,5,104,,0\n", ["0.5 7E0#0568"], {"header": 1}),
    ("a.csv", BYTES + "0.5,790,2,5,10,,0\n0.6,790,2,5,08,,0\n", ["0.5 790#0510", "0.6 790#0508"],
     {"header": 1}),
    ("a.csv", "Time,Ch,Dir,State,Type,Format,ID,DL,D1,D2\n0.5,1,R,OK,Data Frm.,Ext,181,2,01,02\n"
     "0.6,1,T,OK,Remote Frm.,Std,182,2,,\n0.7,1,R,NG,Error,Std,,0,,\n",
     ["0.5 00000181#0102", "0.6 182#R2 T", "0.7 20000000#"], {"header": 1}),
    ("a.csv", "ID,LEN,D1,D2,D3,Time\n181,2,0A,14,,0.5\n182,3,01,02,03,0.6\n",
     ["0.5 181#0A14", "0.6 182#010203"], {"header": 1}),
    # BUSMASTER's own converter: numbers of one digit, bytes behind a request for data.
    ("a.log", BUSMASTER + "0:0:1:0603 Tx 1 0x150 sr 8 00 00 00 00 00 00 00 00\n"
     "0:0:2:0000 Rx 1 0x151 s 1 05\n",
     ["1.0603 150#R8 T", "2 151#05"], {"comment": 2}),
    # SavvyCAN's BUSMASTER: 2 and 37 ms.
    ("a.log", BUSMASTER + "0:0:1:992 Rx 1 151 s 1 05\n0:0:2:2 Rx 1 151 s 1 06\n"
     "0:0:2:37 Rx 1 151 s 1 07\n", ["1.992 151#05", "2.002 151#06", "2.037 151#07"],
     {"comment": 2}),
    # Lines of TRC that somebody has cut out of a file: their times are ms.
    ("a.txt", "   335)      4486.6  Rx     05150000  2  00 01 \n336)  4486.9  Rx  022A0000  0  \n",
     ["4.4866 05150000#0001", "4.4869 022A0000#"], {}),
    ("a.txt", "307      3868.800 DT 05150000 Rx 2  00 01 \n308      3869.100 DT     022A Tx 0  \n",
     ["3.8688 05150000#0001", "3.8691 22A# T"], {}),
    # Titles say that a column is hexadecimal, beside the same in decimal; or that times are ms.
    ("a.csv", "time_ms,id,id_hex,length,data_hex\n20,385,181,2,0102\n", ["0.02 181#0102"],
     {"header": 1}),
    ("a.csv", "relative_ms,protocol,can_id,byte0,byte1\n12,CAN,256,65,255\n",
     ["0.012 100#41FF"], {"header": 1}),
    # ROS' can_msgs/Frame: every number is decimal, even if none shows it.
    ("a.csv", "%time,field.header.seq,field.id,field.is_rtr,field.is_extended,field.is_error,"
     "field.dlc,field.data0,field.data1\n1684144800123456789,1,385,0,0,0,2,1,10\n"
     "1684144800223456789,2,385,1,1,0,2,0,0\n",
     ["1684144800.123456789 181#010A", "1684144800.223456789 00000181#R2"], {"header": 1}),
]  # fmt: skip


@pytest.mark.parametrize(("name", "text", "frames", "counts"), LOGS)
def test_logs_of_further_recorders(tmp_path, name, text, frames, counts):
    path = tmp_path / name
    path.write_text(text)
    assert lines_of(path) == (frames, counts)


@pytest.mark.parametrize(
    ("title", "first", "step", "seconds", "note"),
    [
        ("Time", 8_949_243, 6, 8949.243, "taken for ms"),
        ("Time", 8_949_243, 1, 8949.243, "taken for ms"),
        ("Time", 8_949_243, 1500, 8.949243, "taken for us"),
        ("Time", 1_700_000_000, 7, 1_700_000_000, "since 1970, in s"),
        ("Time (s)", 8_949_243, 6, 8_949_243, ""),
        ("Time Stamp", 8_949_243, 300, 8.949243, ""),
        ("Time Stamp", 8_949_243, 3, 8949.243, "taken for ms"),
    ],
)
def test_the_unit_of_whole_times_in_csv_is_guessed_and_said(
    tmp_path, title, first, step, seconds, note
):
    rows = "".join(f"{first + step * k},181,0A\n" for k in range(30))
    frames, counts, notes = read(tmp_path, "a.csv", f"{title},ID,Data\n{rows}")
    assert not counts
    assert frames[0].t_ns == round(seconds * SECOND)
    assert note in "".join(notes)
    assert bool(note) == bool(notes)


def test_times_in_us_are_known_by_their_irregular_distances(tmp_path):
    stamps = [8_949_243 + 400 * k + 13 * k * k for k in range(30)]
    rows = "".join(f"{stamp},181,0A\n" for stamp in stamps)
    frames, _, notes = read(tmp_path, "a.csv", f"Time,ID,Data\n{rows}")
    assert frames[0].t_ns == 8_949_243_000
    assert "taken for us" in notes[0]


def test_zeros_before_a_short_identifier_do_not_make_it_long(tmp_path):
    text = f"{ANALYZER}1\t0\t1\tRX\t10.5\t\t0x00000605\t2\t0x00 1f \n"
    text += "1\t0\t2\tTX\t10.6\t\t0x1cff0605\t1\t0x00 \n"
    frames, counts, _ = read(tmp_path, "a.log", text)
    assert not counts
    assert shown(frames) == ["605#001F", "T"]
    assert [frame.flags & EXTENDED for frame in frames] == [0, EXTENDED]


def test_a_log_whose_first_frame_is_not_its_earliest(tmp_path):
    text = "Time Stamp,ID,Data\n-5.5,181,01\n-99.25,181,02\n-99.0,181,03\n"
    frames, _, (note,) = read(tmp_path, "a.csv", text)
    assert [frame.t_ns / SECOND for frame in frames] == [94.5, 0.75, 1.0]
    assert note == "times begin before 0: all are moved forward by 100 s"


def test_lines_like_candumps_with_fewer_decimals(tmp_path):
    """Battery-Emulator's: `--line auto` proposes the pattern of candump's screen output."""
    path = tmp_path / "a.log"
    path.write_text("(371.19) RX0 583 [2] 00 40\n(371.20) TX1 1B000010 [1] 10\n")
    out = tmp_path / "out.log"
    assert main(["convert", str(path), str(out), "--line", "auto"]) == 0
    assert [frame.t_ns for frame in open_reader(out, strict=False)] == [
        371_190_000_000,
        371_200_000_000,
    ]


@pytest.mark.parametrize(
    ("text", "pattern"),
    [
        # An identifier with a colon is no channel, and the first byte no identifier.
        ("820298   0x085: 7C 33\n820301   0x047: 20 00\n", "{ms} {id}: {data}"),
        # candump -x behind the time of day.
        ("16:10:30.19 can0  RX - -  181   [1]  01\n16:10:30.20 can0  TX - -  182   [0]\n",
         "{clock} {channel} {dir} {brs} {esi} {id} [{dlc}] {data}"),
        # Identifiers of decimal digits fall as often as they rise: they are no times.
        ("00000210,00 E3\n00000154,04 07\n00000258,2F 36\n00000116,00 10\n", ""),
    ],
)  # fmt: skip
def test_patterns_that_auto_proposes(text, pattern):
    found = proposed(text.splitlines())
    assert (found.pattern if found else "") == pattern


def test_flags_of_can_fd_behind_a_time_of_day_are_read(tmp_path):
    path, out = tmp_path / "a.log", tmp_path / "out.log"
    path.write_text(
        "12:00:00.1 can0 RX B E 123 [02] 01 02\n12:00:00.2 can0 TX B - 123 [12] "
        + "00 " * 12 + "\n12:00:00.3 can0 RX - - 123 [08] " + "00 " * 8
        + "\n12:00:00.4 can0 RX - - 123  [2] 01 02\n"
    )  # fmt: skip
    assert main(["convert", str(path), str(out), "--line", "auto"]) == 0
    flags = [frame.flags for frame in open_reader(out, strict=False)]
    assert flags == [FD | BRS | ESI, FD | BRS | TX, FD, 0]


def test_numbers_that_may_be_decimal_are_named(tmp_path):
    """Bytes without a leading zero, none of which has a letter: nothing tells their base."""
    _, counts, notes = read(tmp_path, "a.csv", "Time,ID,D0,D1\n0.5,385,1,10\n0.6,386,2,20\n")
    assert not counts
    assert notes == ["numbers are read as hexadecimal: no byte has a letter or 3 digits"]


def test_auto_names_the_cure_for_candump_without_times(tmp_path, capsys):
    path = tmp_path / "a.log"
    path.write_text("  can0  123   [2]  01 02\n" * 3)
    assert main(["convert", str(path), str(tmp_path / "out.log"), "--line", "auto"]) == 2
    assert "record with `candump -L IF`" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("name", "start", "why"),
    [
        ("a.pcap", b"\xd4\xc3\xb2\xa1\2\0\4\0", "is a capture of Wireshark (pcap): open it in Sav"),
        ("a.log", b"\n\r\r\n\x1c\0\0\0", "is a capture of Wireshark (pcap): open it in SavvyCAN"),
        (
            "a.xlsx",
            b"PK\3\4\x14\0\x08\x08",
            "is a workbook of a spreadsheet: save the sheet as CSV",
        ),
    ],
)
def test_files_that_other_programs_must_convert(tmp_path, name, start, why):
    path = tmp_path / name
    path.write_bytes(start + bytes(100))
    with pytest.raises(LogError, match=re.escape(why)):
        open_reader(path, strict=False)


@pytest.mark.parametrize("version", ["3.30", "4.10"])
def test_an_mdf_of_signals_holds_no_frames(tmp_path, version):
    with asammdf.MDF(version=version) as made:
        made.append([asammdf.Signal(np.arange(5.0), np.arange(5.0), name="speed")])
        path = made.save(tmp_path / "a.mf4")
    with pytest.raises(LogError, match="has no group of CAN frames"):
        list(open_reader(path, strict=False))


@pytest.mark.parametrize(
    ("ending", "cure"),
    [("kcd", "`cantools convert"), ("eds", "`check --eds` takes"), ("dbc", "in it")],
)
def test_a_description_of_another_kind_than_dbc(tmp_path, ending, cure):
    path = tmp_path / f"a.{ending}"
    path.write_text("<NetworkDefinition/>\n")
    with pytest.raises(DbcMismatch, match="is not a DBC: there is no entry of one in it") as caught:
        read_any_dbc(path)
    assert cure in str(caught.value)


DBC = """VERSION ""
BU_: A B
BO_ {0} Drive: 8 A
 SG_ Torque : 0|16@1- (0.5,0) [0|0] "Nm" B
 SG_ Mode M : 16|8@1+ (1,0) [0|0] "" B
 SG_ T1 m1 : 24|8@1+ (1,0) [0|0] "" B
 SG_ F : 32|32@1- (1,0) [0|0] "" B
BO_ 256 Other: 8 A
 SG_ X : 0|8@1+ (1,0) [0|0] "" B
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 100000;
BA_DEF_REL_ BU_SG_REL_ "Timeout" INT 0 100000;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_REL_ "Timeout" 0;
BA_ "GenMsgCycleTime" BO_ {0} 20;
BA_REL_ "Timeout" BU_SG_REL_ B SG_ {0} Torque 5000;
CM_ SG_ {0} Torque "not 441799690";
SIG_VALTYPE_ {0} F : 1;
SG_MUL_VAL_ {0} T1 Mode 1-1;
VAL_ {0} Mode 0 "off" 1 "on" ;
BO_TX_BU_ {0} : A,B;
"""


def test_a_long_identifier_without_the_bit_that_marks_it(tmp_path):
    """Editors that do not know the rule write the identifier as it is on the bus."""
    number = 441_799_690
    (tmp_path / "right.dbc").write_text(DBC.format(number | 1 << 31))
    (tmp_path / "bare.dbc").write_text(DBC.format(number))
    right, none = read_any_dbc(tmp_path / "right.dbc")
    bare, (note,) = read_any_dbc(tmp_path / "bare.dbc")
    assert bare == right
    assert not none
    assert note == (
        "line 3: BO_ 441799690 Drive: bit 31, which marks 29 bits, is missing: read as 29 bits"
    )


def test_what_a_spreadsheet_does_to_identifiers_is_explained(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("Time Stamp,ID,LEN,D1\n10.5,2.00E+06,1,0A\n")
    reader = open_reader(path, strict=False)
    assert not list(reader)
    (problem,) = reader.problems
    assert problem.text.startswith("2.00E+06 was a hexadecimal number before a spreadsheet")


@pytest.mark.parametrize("encoding", ["utf-8", "gb18030"])
def test_a_dbc_of_a_chinese_editor(tmp_path, encoding):
    text = DBC.format(512).replace('"Nm"', '"\u2103"').replace("off", "\u5173\u95ed")
    (tmp_path / "a.dbc").write_bytes(text.encode(encoding))
    (drive, _), notes = read_any_dbc(tmp_path / "a.dbc")
    assert not notes
    assert drive.signals[0].unit == "\u2103"
    assert drive.signals[1].labels == {0: "\u5173\u95ed", 1: "on"}


def test_western_text_is_not_taken_for_chinese():
    text = 'SG_ A : 0|8@1+ (1,0) [0|0] "\xb0C" Gr\xf6\xdfe \xb5\xb2\xb3 F\xfc\xdfe'
    assert decoded(text.encode("cp1252")) == text


def test_one_character_for_degrees_celsius_is_the_unit(tmp_path):
    text = 'BO_ 256 MCU: 8 A\n SG_ MotorTemp : 0|8@1+ (1,-40) [0|0] "\u2103" A\n'
    (tmp_path / "a.dbc").write_text(text)
    specs, _ = read_any_dbc(tmp_path / "a.dbc")
    (guess,) = [guess for guesses in candidates(specs).values() for guess in guesses]
    assert guess.quantity == "Tstator"
    assert guess.score >= SURE


def test_an_object_of_another_bus_in_a_blf_may_have_any_time(tmp_path):
    path = tmp_path / "a.blf"
    with can.BLFWriter(path, compression_level=0) as writer:
        for k in range(2):
            writer.on_message_received(can.Message(1e9 + k, 0x100, False, data=bytes(8)))
    data = bytearray(path.read_bytes())
    last = data.rindex(b"LOBJ")
    data[last + 12 : last + 16] = struct.pack("<L", 22)  # an object of MOST
    data[last + 24 : last + 32] = struct.pack("<Q", 1 << 62)
    path.write_bytes(data)
    reader = open_reader(path, strict=False)
    assert len(list(reader)) == 1
    assert +reader.counts == {Verdict.OK: 1, Verdict.EVENT: 1}


def test_a_bit_rate_in_a_dbc_is_no_fault(tmp_path):
    text = 'VERSION ""\nBS_: 500000 : 0,0\nBO_ 256 A: 8 N\n SG_ X : 0|8@1+ (1,0) [0|0] "" N\n'
    (tmp_path / "a.dbc").write_text(text)
    (spec,), notes = read_any_dbc(tmp_path / "a.dbc")
    assert (spec.name, notes) == ("A", [])


def test_a_number_may_begin_with_its_point(tmp_path):
    text = 'BO_ 256 A: 8 N\n SG_ X : 0|13@1+ (.25,-.5) [-.5|.75e1] "N.m" N\n'
    (tmp_path / "a.dbc").write_text(text)
    ((signal,),) = [spec.signals for spec in read_any_dbc(tmp_path / "a.dbc")[0]]
    assert (signal.scale, signal.offset, signal.unit) == (0.25, -0.5, "N.m")
