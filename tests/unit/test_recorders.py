"""Logs and DBCs as common recorders, converters and tools write them."""

import bz2
import lzma
import zipfile
from pathlib import Path

import asammdf
import can
import numpy as np
import pytest

from dbc.candump.reader import LogError
from dbc.codec import Match, bind_usable
from dbc.frame import FD, SECOND, Frame
from dbc.logs.opening import open_reader
from dbc.tolerant import read_any_dbc
from gateway.io.log_file import BadLogError, open_log
from gateway.logfiles.signals import Decoder
from tests.unit.test_odd_logs import ASC, read, shown

CANEDGE = Path(__file__).parents[1] / "data" / "logs" / "css_FCBF0606.MF4"
COMPUTED = ("BusChannel", "IDE", "DataLength", "Dir", "EDL", "BRS")
"""Columns that a CANedge does not record if they are constant: asammdf computes them, as floats."""
LONG = b"\x12\x34\x56\x78\x90\xab\xcd\xef" * 2


def test_an_mf4_whose_columns_are_computed(tmp_path):
    with asammdf.MDF(CANEDGE, process_bus_logging=False) as source:
        old = source.get("CAN_DataFrame", 0)
        fields = {name: old.samples.dtype[name] for name in old.samples.dtype.names}
        computed = {f"CAN_DataFrame.{name}" for name in COMPUTED}
        kinds = [(name, "<f8" if name in computed else kind) for name, kind in fields.items()]
        new = np.zeros(len(old.samples), dtype=kinds)
        for name in fields:
            new[name] = old.samples[name]
        signal = asammdf.Signal(new, old.timestamps, name="CAN_DataFrame", source=old.source)
        with asammdf.MDF(version="4.11") as made:
            made.append([signal], common_timebase=True)
            made.header.start_time = source.header.start_time
            made.save(tmp_path / "computed.mf4")
    frames = list(open_reader(tmp_path / "computed.mf4", strict=False))
    assert {frame.channel for frame in frames} == {"1", "2"}
    assert frames == list(open_reader(CANEDGE, strict=False))


@pytest.mark.parametrize(
    ("title", "texts", "seconds"),
    [
        ("Time (us)", ("1000", "2000.5"), (0.001, 0.0020005)),
        ("Time (us)", ("1000.5", "2000"), (0.0010005, 0.002)),
        ("Time Stamp", ("166064000", "166084000"), (166.064, 166.084)),
        ("Time Stamp", ("166064000.0", "166084000.0"), (166.064, 166.084)),
        ("Time Stamp", ("166.064000", "166.084000"), (166.064, 166.084)),
    ],
)
def test_the_unit_of_times_in_csv(tmp_path, title, texts, seconds):
    text = f"{title},ID,Data\n" + "".join(f"{text},181,0A14\n" for text in texts)
    frames, counts, _ = read(tmp_path, "a.csv", text)
    assert not counts
    assert [frame.t_ns for frame in frames] == [round(s * SECOND) for s in seconds]


def test_can_fd_frames_in_a_database_of_python_can(tmp_path):
    with can.Logger(str(tmp_path / "a.db")) as log:
        log(can.Message(timestamp=1.0, arbitration_id=0x123, data=LONG, is_fd=True))
        log(can.Message(timestamp=2.0, arbitration_id=0x123, data=LONG[:8]))
    (long, short) = open_reader(tmp_path / "a.db", strict=False)
    assert (long.data, long.flags & FD) == (LONG, FD)
    assert (short.data, short.flags & FD) == (LONG[:8], 0)


@pytest.mark.parametrize(("code", "size"), [("9", 12), ("10", 16), ("a", 16)])
def test_can_fd_frames_that_a_converter_writes_as_classic_lines(tmp_path, code, size):
    data = " ".join(f"{byte:02X}" for byte in LONG[:size])
    text = f"{ASC}0.1 1 123 Rx d {code} {data}\n0.2 1 124 Rx d 2 01 02 Length = 1\n"
    frames, counts, _ = read(tmp_path, "a.asc", text)
    assert not counts
    assert [(f.data, f.flags & FD) for f in frames] == [(LONG[:size], FD), (b"\1\2", 0)]


def test_a_classic_frame_with_a_long_length_code_stays_one(tmp_path):
    text = f"{ASC}0.1 1 123 Rx d f {'11 ' * 8} Length = 240000\n"
    assert shown(read(tmp_path, "a.asc", text)[0]) == ["123#1111111111111111_F"]


@pytest.mark.parametrize(
    ("lines", "wanted"),
    [
        ("     1)      1841.0  0001  8  00 00 00 00 00 00 00 00\n"
         "     2)      1842.0  0008  4  ERROR 00 19 08 08\n",
         [(1841, "001#0000000000000000"), (1842, "20000000#0000000000000000")]),
        (";$FILEVERSION=1.1\n     1)         7,2  Rx         0300  2  01 A3\n",
         [(7.2, "300#01A3")]),
    ],
)  # fmt: skip
def test_lines_of_trc(tmp_path, lines, wanted):
    frames, counts, _ = read(tmp_path, "a.trc", lines)
    assert not counts
    assert [f.t_ns for f in frames] == [round(ms * 1_000_000) for ms, _ in wanted]
    assert [text.split("#")[0] for text in shown(frames)] == [t.split("#")[0] for _, t in wanted]


def test_a_start_of_a_trc_is_as_exact_as_its_times(tmp_path):
    """Digits beyond a microsecond are those of a day's fraction; candump has six."""
    text = ";$FILEVERSION=2.1\n;$STARTTIME=44548.6281735577\n;$COLUMNS=N,O,T,I,d,L,D\n"
    frames, _, _ = read(tmp_path, "a.trc", f"{text} 1  0.0 DT 0300 Rx 2  01 A3\n")
    assert frames[0].t_ns % 1000 == 0


def test_why_a_log_has_no_frame(tmp_path):
    path = tmp_path / "a.asc"
    path.write_text(f"{ASC}0.1 1 123 TxRq d 1 01\n")
    with pytest.raises(BadLogError, match="request 1"):
        list(open_log(path, False).blocks)


def test_a_log_that_another_program_packed(tmp_path):
    frame = b"(1.000000) can0 123#01\n"
    (tmp_path / "a.log.xz").write_bytes(lzma.compress(frame))
    (tmp_path / "a.log.bz2").write_bytes(bz2.compress(frame))
    with zipfile.ZipFile(tmp_path / "a.log.zip", "w") as packed:
        packed.writestr("a.log", frame)
    for name, kind in (("xz", "xz"), ("bz2", "bzip2"), ("zip", "zip")):
        with pytest.raises(LogError, match=rf"compressed \({kind}\)"):
            open_log(tmp_path / f"a.log.{name}", False)


@pytest.mark.parametrize("name", ["a.csv", "a.asc", "a.trc"])
def test_text_of_candump_under_another_ending(tmp_path, name):
    assert shown(read(tmp_path, name, "(1.000000) can0 123#01\n")[0]) == ["123#01"]


FD_DBC = """VERSION ""
BU_: ECU
BO_ 256 Long: 24 ECU
 SG_ A : 0|16@1+ (1,0) [0|0] "" ECU
BO_ 257 Short: 8 ECU
 SG_ B : 0|16@1+ (1,0) [0|0] "" ECU
"""


def test_a_dbc_of_can_fd_that_does_not_say_so(tmp_path):
    """Only a CAN FD frame has more than 8 bytes; a short message may come in either kind."""
    (tmp_path / "fd.dbc").write_text(FD_DBC)
    codec = bind_usable(tmp_path / "fd.dbc")
    frames = [Frame(0, 256, bytes(24), FD, "can0"), Frame(0, 257, bytes(8), FD, "can0"),
              Frame(0, 257, bytes(8), 0, "can0")]  # fmt: skip
    assert [codec.match(frame)[0] for frame in frames] == [Match.OK] * 3
    log = "(1.000000) can0 100##0" + "00" * 24 + "\n(1.100000) can0 101##0" + "00" * 8 + "\n"
    (tmp_path / "a.log").write_text(log + "(1.200000) can0 101#" + "00" * 8 + "\n")
    decoder = Decoder(codec)
    for block in open_log(tmp_path / "a.log", False).blocks:
        decoder.match(block)
    assert decoder.counts == {Match.OK: 3}


def test_a_classic_dbc_takes_no_can_fd_frame(tmp_path):
    (tmp_path / "classic.dbc").write_text(FD_DBC.replace("Long: 24", "Long: 8"))
    codec = bind_usable(tmp_path / "classic.dbc")
    assert codec.match(Frame(0, 257, bytes(8), FD, "can0"))[0] is Match.WRONG_FORMAT


@pytest.mark.parametrize(
    ("kind", "value", "why"),
    [("STRING", '"Event"', []), ('ENUM "Cyclic","Event"', "-1", ["-1 is not an index of its 2"])],
)
def test_an_attribute_whose_value_is_no_index(tmp_path, kind, value, why):
    text = f'{FD_DBC}BA_DEF_ BO_ "GenMsgSendType" {kind};\nBA_DEF_DEF_ "GenMsgSendType" "";\n'
    (tmp_path / "a.dbc").write_text(f'{text}BA_ "GenMsgSendType" BO_ 257 {value};\n')
    specs, left_out = read_any_dbc(tmp_path / "a.dbc")
    assert [spec.name for spec in specs] == ["Long", "Short"]
    assert len(left_out) == len(why)
    assert all(text in left_out[0] for text in why)
