"""Text of programs that nobody knows: refused with a cure, proposed for, read by a pattern."""

import pytest

from dbc.candump.grammar import Verdict
from dbc.candump.reader import LogError
from dbc.logs.opening import open_reader
from dbc.logs.proposals import proposed
from gateway.cli import main
from tests.unit.test_foreign_logs import lines_of

BYTES = "02 A0 03 04 05 06 07 F1"


def convert(path, *options):
    return main(["convert", str(path), str(path.parent / "out.log"), "--frames", *options])


@pytest.mark.parametrize(
    "line",
    [f"0.0{{}} 181 8 {BYTES}", f"0.0{{}} 181 {BYTES}", "0.0{} 1 181 3 02 A0 03",
     f"{{}} 181 8 {BYTES}", f"0.0{{}} can0 181 {BYTES}", f"0.0{{}}\t181\t8\t{BYTES}",
     "0.0{} 181 02-A0-03", "10:00:00.0{} Rx 1 181 8 2 01 02"],
)  # fmt: skip
def test_text_that_no_reader_knows_is_refused_and_the_cure_named(tmp_path, capsys, line):
    path = tmp_path / "a.txt"
    path.write_text("".join(line.format(k) + "\n" for k in range(10, 22)))
    assert convert(path) == 2
    assert "OUT.log --line auto`" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out.log").exists()


def test_an_empty_pattern_is_no_pattern(tmp_path, capsys):
    path = tmp_path / "a.log"
    path.write_text("(1.000000) can0 181#01\n")
    assert convert(path, "--line", "") == 2
    assert "needs one time" in capsys.readouterr().err


@pytest.mark.parametrize("bus", ["", "2"])
def test_crtd_needs_its_types(tmp_path, bus):
    path = tmp_path / "a.txt"
    path.write_text(f"1.0 {bus}R11 181 01\n1.1 {bus}T29 182 02\n1.2 {bus}R12 183 03\n")
    assert lines_of(path) == (["1 181#01", "1.1 00000182#02 T"], {"malformed": 1})


def faults_of(path, line, *, strict=False):
    """Frames as `id#data`, faults with their lines."""
    reader = open_reader(path, strict=strict, line=line)
    frames = [f"{f.can_id:03X}#{f.data.hex()}" for b in reader.blocks() for f in b.frames()]
    return frames, [f"{problem.line}: {problem.text}" for problem in reader.problems]


@pytest.mark.parametrize("separator", [" ", ";"])
@pytest.mark.parametrize(
    ("data", "column", "found"),
    [("01 zz 03 04", 12, "zz 03 04"), ("01 0g 04", 13, "g 04"), ("01 xx 04", 12, "xx 04"),
     ("01 0x 04", 13, "x 04"), ("01;;04", 12, ";04"), ("01 012 04", 12, "012 04"),
     ("01 02 // 03", 15, "// 03"), ("01 -- 04", 13, "- 04")],
)  # fmt: skip
def test_a_damaged_byte_never_shortens_a_frame(tmp_path, separator, data, column, found):
    path = tmp_path / "a.txt"
    lines = ["1.0 181 01 02", f"2.0 181 {data}", "3.0 181 0x01,0x2 ,3,", "4.0 181 "]
    path.write_text("".join(line.replace(" ", separator, 2) + "\n" for line in lines))
    pattern = separator.join(["{s}", "{id}", "{data}"])
    frames, faults = faults_of(path, pattern)
    assert frames == ["181#0102", "181#010203", "181#"]
    assert len(faults) == 1
    assert faults[0].startswith(f"2: column {column}: a byte of {{data}}")
    assert f"expected, {found!r} found" in faults[0]
    with pytest.raises(LogError, match=f":2: malformed: column {column}"):
        faults_of(path, pattern, strict=True)


def test_a_comment_behind_the_data_that_the_pattern_names(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("1.0 181 01 02 // 03\n2.0 181 01 zz // 03\n")
    frames, faults = faults_of(path, "{s} {id} {data} // {skip}")
    assert frames == ["181#0102"]
    assert [fault.split(":")[1] for fault in faults] == [" column 12"]


@pytest.mark.parametrize("data", ["300 02", "AA 3", "17,,3", "17x3"])
def test_decimal_bytes(tmp_path, data):
    path = tmp_path / "a.txt"
    path.write_text(f"1.0 181 17-3\n2.0 181 {data}\n3.0 181 255 008\n")
    frames, faults = faults_of(path, "{s} {id} {data:d}")
    assert frames == ["181#1103", "181#ff08"]
    assert [fault.split()[0] for fault in faults] == ["2:"]


@pytest.mark.parametrize(
    ("stamp", "t_ns"),
    [("10:00:00.1234567+02:00", 1684137600_123456700),
     ("10:00:00,123456789Z", 1684144800_123456789),
     ("10:00:00.123456789", 1684144800_123456789), ("10:00:00.12345678901+02:00", None),
     ("10:61:00+02:00", None)],
)  # fmt: skip
def test_dates_to_the_nanosecond_with_their_zone(tmp_path, stamp, t_ns):
    path = tmp_path / "a.txt"
    path.write_text(f"2023-05-15T08:00:00Z 181 00\n2023-05-15T{stamp} 181 01\n")
    reader = open_reader(path, strict=False, line="{date} {id} {data}")
    found = [frame.t_ns for block in reader.blocks() for frame in block.frames()]
    assert found[1:] == ([] if t_ns is None else [t_ns])
    assert [problem.line for problem in reader.problems] == ([2] if t_ns is None else [])


@pytest.mark.parametrize(
    ("pattern", "good", "bad"),
    [("{ms:x}", "3E8", "FFFFFFFFFFFFFFF"), ("{us:x}", "F4240", "7FFFFFFFFFFFFFF"),
     ("{s:x}", "1", "FFFFFFFFF"), ("{s}", "1", "99999999999"), ("{clock}", "0:00:01", "25:61:61.5"),
     ("{clock}", "0:00:01", "24:00:00"), ("{clock}", "0:00:01", "10:00:60")],
)  # fmt: skip
def test_times_that_are_none_are_malformed(tmp_path, pattern, good, bad):
    path = tmp_path / "a.txt"
    path.write_text(f"{good} 181 01\n {bad} 181 02\n")
    reader = open_reader(path, strict=False, line=f"{pattern} {{id}} {{data}}")
    frames = [frame for block in reader.blocks() for frame in block.frames()]
    assert [frame.t_ns for frame in frames] == [10**9]
    field = pattern.replace(":x", "")
    assert reader.problems[0].text.startswith(f"column 2: {field} expected, '{bad[:9]}")


@pytest.mark.parametrize("end", ["\n", ""])
def test_a_pattern_that_fits_no_line_names_line_and_column(tmp_path, capsys, end):
    path = tmp_path / "a.txt"
    path.write_text("a header\n" + "1.0;181;2;01 02\n" * 2 + "the end" + end)
    assert convert(path, "--line", "{s};{id},{data}") == 2
    words = " ".join(capsys.readouterr().err.split())
    assert "not one of its 4 lines is a frame; line 2: header: column 8: ',' expected" in words


@pytest.mark.parametrize(("last", "cut"), [("3.0 Tx 181 03", 0), ("3.0 Tx 182 03", 1)])
def test_a_last_line_is_compared_with_others_of_its_identifier(tmp_path, last, cut):
    path = tmp_path / "a.txt"
    path.write_text(f"1.0 Rx 181 01\n2.0 Rx 181 02\n{last}")
    reader = open_reader(path, strict=False, line="{s} {dir} {id} {data}")
    assert sum(block.size for block in reader.blocks()) == 3 - cut
    assert reader.counts[Verdict.CUT] == cut


@pytest.mark.parametrize(
    ("line", "step", "pattern", "assumed"),
    [(f"0.0{{}} 181 8 {BYTES}", 1, "{s} {id} {dlc} {data}", ""),
     (f"0.0{{}}\t181\t8\t{BYTES}", 1, "{s} {id} {dlc} {data}", ""),
     (f"0.0{{}} 181 {BYTES}", 1, "{s} {id} {data}", ""),
     ("0.0{} 1 181 3 02 A0 03", 1, "{s} {channel} {id} {dlc} {data}", ""),
     ("0.0{} can0 181 02-A0-03", 1, "{s} {channel} {id} {data}", ""),
     (f"170000000{{}}00 181 8 {BYTES}", 1, "{ms} {id} {dlc} {data}", "13 digits"),
     (f"170000000{{}}00000;181;8;{BYTES}", 1, "{us};{id};{dlc};{data}", "16 digits"),
     (f"1700000000{{}}0000000 181 8 {BYTES}", 1, "{ns} {id} {dlc} {data}", ""),
     ("{}0 181 3 02 A0 03", 1, "{ms} {id} {dlc} {data}", "mostly 10 apart: taken for ms"),
     ("{}0 181 3 02 A0 03", 100, "{us} {id} {dlc} {data}", "mostly 1000 apart: taken for us"),
     ("{} 181 3 02 A0 03", 1, "{ms} {id} {dlc} {data}", "mostly 1 apart: taken for ms"),
     ("{} 181 3 02 A0 03", 0, "{s} {id} {dlc} {data}", "mostly 0 apart: taken for s"),
     ("0.0{},0181,3,02,A0,03,R", 1, "{s},{id},{dlc},{data},{dir}", ""),
     ("0.0{},0181,3,02,A0,03,normal", 1, "{s},{id},{dlc},{data},{skip}", ""),
     (f"0,0{{}};181;8;{BYTES}", 1, "{s};{id};{dlc};{data}", ""),
     (f"[0.0{{}}] 0x181 [8] {BYTES}", 1, "[{s}] {id} [{dlc}] {data}", ""),
     ("t=0.0{} id=181 data=02 A0 03", 1, "t={s} id={id} data={data}", ""),
     ("time: 0.0{}, id: 0x181, len: 3, flags: 7, data: 02 A0 03", 1,
      "time: {s}, id: {id}, len: {dlc}, flags: {skip}, data: {data}", ""),
     ("0.0{} 385 4 2 160 3 255", 1, "{s} {id:d} {dlc} {data:d}", "identifiers decimal"),
     ("0.0{} 0x181 4 2 160 3 255", 1, "{s} {id} {dlc} {data:d}", "identifiers hexadecimal"),
     (f"0.0{{}} 1 181 Rx d 8 {BYTES}", 1, "{s} {channel} {id} {dir} d {dlc} {data}", ""),
     ("0.0{} 1 Rx 181 3 02 A0 03", 1, "{s} {channel} {dir} {id} {dlc} {data}", ""),
     ("(    0.0{}) can0 0631A000#40A0", 1, "( {s}) {channel} {id}#{data}", ""),
     ("10:00:00.0{} can0 181 3 02 A0 03", 1, "{clock} {channel} {id} {dlc} {data}", ""),
     ("0.0{} 181 3 02 A0 03 .x.", 1, "{s} {id} {dlc} {data} {skip}", "")],
)  # fmt: skip
def test_patterns_of_common_dialects_are_proposed(line, step, pattern, assumed):
    lines = [line.format(10 + k * step) for k in range(12)]
    found = proposed(["# a comment", "some header", *lines])
    assert found is not None
    assert found.pattern == pattern
    assert (found.good, found.bad) == (12, 1)
    assert assumed in found.assumed
    assert bool(assumed) == bool(found.assumed)


@pytest.mark.parametrize("separator", [" ", ";", ", "])
def test_numbers_of_lines_are_no_times(separator):
    lines = [f"{k};0.0{10 + k};181;3;02 A0 03".replace(";", separator) for k in range(12)]
    found = proposed(lines)
    assert found is not None
    assert found.pattern == separator.join(["{skip}", "{s}", "{id}", "{dlc}", "{data}"])


@pytest.mark.parametrize(
    "lines",
    [["1.0 181 2 01 02", "2.0 181 3 01 02", "3.0 181 4 01 02", "4.0 181 1 01 02"],
     ["hello world", "nothing of that kind"], ["1.0 oops 181 01 0", "", "xyz 02"], [], [""]],
)  # fmt: skip
def test_nothing_is_proposed_where_nothing_fits(lines):
    assert proposed(lines) is None


def test_a_damaged_line_does_not_change_the_proposal():
    lines = [f"0.0{k} 181 3 02 A0 03" for k in range(10, 60)]
    lines[20:22] = ["0.030 181 3 02 A0", "0.031 181 3 02 A0 zz"]
    found = proposed(lines)
    assert found is not None
    assert found[:3] == ("{s} {id} {dlc} {data}", 48, 2)


def test_what_was_assumed_is_printed(tmp_path, capsys):
    path = tmp_path / "a.txt"
    path.write_text("".join(f"{k}0 181 3 02 A0 03\n" for k in range(12)))
    assert convert(path, "--line", "auto") == 0
    out = capsys.readouterr().out
    assert "--line '{ms} {id} {dlc} {data}': fits 12 of 12 lines examined" in out
    assert "assumed: times are whole numbers, mostly 10 apart: taken for ms" in out
