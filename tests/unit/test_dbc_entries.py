"""One fault in a DBC of others costs what it is in, and nothing that is read as something else."""

import logging
import math
import random
import struct
from pathlib import Path

import cantools
import pytest

from dbc.codec import bind_usable
from dbc.entry_text import split
from dbc.spec import ABSENT, NOT_A_NUMBER, NOT_AVAILABLE, RANGE, VALID, DbcMismatch
from dbc.text import decoded
from gateway.cli import main
from tests.work import calls

HEAD = 'VERSION ""\nNS_ :\n\tCM_\n\tBA_DEF_\nBS_:\nBU_: A\n'
D = "BO_ 256 D: 8 A\n"
A = ' SG_ A : 0|16@1+ (1,0) [0|0] "x" A\n'
E = 'BO_ 257 E: 8 A\n SG_ Q : 0|8@1+ (1,0) [0|0] "" A\n'
F = ' SG_ F : 0|32@1- (1,0) [0|0] "" A\n'
FORMATS = ",".join(f'"{k}"' for k in range(14)) + ',"StandardCAN_FD","ExtendedCAN_FD"'
FD = f'BA_DEF_ BO_ "VFrameFormat" ENUM {FORMATS};\nBA_ "VFrameFormat" BO_ 256 14;\n'
CYCLE = 'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 1000;\nBA_ "GenMsgCycleTime" BO_ 257 10;\n'
START = 'BA_DEF_ SG_ "GenSigStartValue" {} ;\nBA_ "GenSigStartValue" SG_ 257 Q "abc";\n'


def codec_of(folder, text, head=HEAD, encoding="utf-8"):
    path = folder / "a.dbc"
    path.write_text(head + text, encoding=encoding, newline="")
    return bind_usable(path)


def signals(codec):
    return [f"{m.name}.{s.name}" for m in codec.messages for s in m.signals]


# ---- quotes and comments -----------------------------------------------------------------------


def test_a_quote_behind_a_backslash_ends_no_text(tmp_path):
    inch = r'"a 5\" wheel";' + "\n"
    codec = codec_of(tmp_path, D + F + f"CM_ SG_ 256 F {inch}SIG_VALTYPE_ 256 F : 1;\n")
    data = struct.pack("<f", 2.5).ljust(8, b"\0")
    assert codec.decode(codec.messages[0], data)["F"].value == 2.5
    codec = codec_of(tmp_path, f"CM_ {inch}" + D + A + E)
    assert signals(codec) == ["D.A", "E.Q"]
    assert codec.left_out == ()
    codec = codec_of(tmp_path, D + A + f'CM_ SG_ 256 A {inch}VAL_ 256 A 65535 "SNA" ;\n')
    assert codec.decode(codec.messages[0], b"\xff\xff" + bytes(6))["A"].validity == NOT_AVAILABLE
    codec = codec_of(tmp_path, D + A.replace('"x"', r'"5\" x"'))
    assert codec.messages[0].signals[0].unit == '5" x'


@pytest.mark.parametrize(
    "comment",
    ['CM_ "never ends', 'CM_ "never ends;', 'CM_ BO_ 256 "a 5" wheel";', r'CM_ "C:\";',
     'CM_ "never ends,\nfor two lines'],
)  # fmt: skip
@pytest.mark.parametrize("behind", ["", 'CM_ "another";\n', 'VAL_ 256 A 1 "x" ;\n'])
def test_a_comment_that_does_not_end_costs_itself(tmp_path, comment, behind):
    codec = codec_of(tmp_path, f"{D}{A}{comment}\n{behind}{E}")
    assert signals(codec) == ["D.A", "E.Q"]
    (note,) = codec.left_out
    assert note.startswith("line 9: CM_ ")
    assert "does not end" in note


def test_a_comment_may_look_like_entries(tmp_path):
    comment = r'CM_ SG_ 256 A "say \"' + D + A.replace('"', r"\"") + 'BO_ 5 X: 8 A\nthe end" ;\n'
    codec = codec_of(tmp_path, D + A + comment + E)
    assert signals(codec) == ["D.A", "E.Q"]
    assert codec.left_out == ()


# ---- attributes and labels ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("entry", "at", "why"),
    [
        ('BA_ "Nope" BO_ 256 1;\n', 0, "no attribute 'Nope' is defined"),
        ('BA_DEF_ SG_ "Bad" INT 0;\n', 0, "its limits '0' are left out: not two numbers"),
        ('BA_DEF_ SG_ "Bad" HEX 0x0 0xFF;\n', 0, "its limits '0x0 0xFF' are left out"),
        ('BA_DEF_ "Bad" ENUM a,b;\n', 0, "its values 'a,b' are left out"),
        ('VAL_ 257 Q 1.5 "x" 0 "y" ;\n', 0, "the label of 1.5 is left out"),
        (
            'BA_ "GenMsgCycleTime" BO_ 256 "x";\n',
            0,
            '"x" is not a number, as its type INT requires',
        ),
        (
            'BA_DEF_DEF_ "GenMsgCycleTime" "x";\n',
            0,
            '"x" is not a number, as its type INT requires',
        ),
        (START.format("FLOAT 0 100"), 1, '"abc" is not a number, as its type FLOAT requires'),
        (START.format("STRING"), 1, "GenSigStartValue is a number; it is defined as STRING"),
        ('BA_ "VFrameFormat" BO_ 257 77;\n', 0, "77 is not an index of its 16 values"),
        ('BA_DEF_ "X" INT 0 1E+999;\n', 0, "no number can be so large"),
        ("CM_ BO_ 256 unquoted;\n", 0, "cannot be read from 'unquoted;' on"),
    ],
)
def test_one_bad_attribute_costs_itself(tmp_path, entry, at, why):
    codec = codec_of(tmp_path, D.replace("8 A", "16 A") + A + E + CYCLE + FD + entry)
    assert [m.is_fd for m in codec.messages] == [True, False]
    assert codec.by_name["E"].cycle_ns == 10_000_000
    (note,) = codec.left_out
    assert note.startswith(f"line {15 + at}: ")
    assert why in note


def test_the_other_labels_stay(tmp_path):
    codec = codec_of(tmp_path, D + A + 'VAL_ 256 A 1.5 "x" 65535 "SNA" 0 "off" ;\n')
    assert codec.messages[0].signals[0].labels == {65535: "SNA", 0: "off"}


def test_a_frame_format_by_its_name(tmp_path):
    text = D.replace("8 A", "16 A") + A + FD.replace("256 14", '256 "StandardCAN_FD"')
    assert codec_of(tmp_path, text).messages[0].is_fd


def test_what_only_cantools_refuses_is_found(tmp_path):
    """A start value that is no number, by an attribute of a kind of its own."""
    text = 'BA_DEF_ BO_ "GenMsgSendType" INT 0 9;\nBA_ "GenMsgSendType" BO_ 256 3;\n'
    codec = codec_of(tmp_path, D.replace("8 A", "16 A") + A + E + CYCLE + FD + text)
    assert [m.is_fd for m in codec.messages] == [True, False]
    (note,) = codec.left_out
    assert 'BA_ "GenMsgSendType"' in note


# ---- what says how a signal is read ------------------------------------------------------------

MUX = (
    ' SG_ X m244 : 8|8@1+ (1,0) [0|0] "" A\n SG_ Y m1 : 8|8@1+ (1,0) [0|0] "" A\n'
    ' SG_ P : 16|8@1+ (1,0) [0|0] "" A\n'
)


@pytest.mark.parametrize(
    "selector",
    ["0|8@1+ (1,0) [nan|nan]", "0|80@1+ (1,0) [0|0]", "0|8@1+ (0,0) [0|0]", "900|8@1+ (1,0) [0|0]"],
)
def test_signals_go_with_their_selector(tmp_path, selector):
    codec = codec_of(tmp_path, D + f' SG_ M M : {selector} "" A\n' + MUX + E)
    assert signals(codec) == ["D.P", "E.Q"]
    lines = sorted(line.split(":")[0] for line in codec.left_out)
    assert lines == ["line 10", "line 8", "line 9"]
    assert sum("is multiplexed by M" in line for line in codec.left_out) == 2


@pytest.mark.parametrize(
    "selectors", ["", ' SG_ M M : 0|8@1+ (1,0) [0|0] "" A\n SG_ N M : 24|8@1+ (1,0) [0|0] "" A\n']
)
def test_multiplexed_by_nobody_knows_what(tmp_path, selectors):
    codec = codec_of(tmp_path, D + selectors + MUX)
    assert "D.X" not in signals(codec)
    assert "D.Y" not in signals(codec)
    assert "D.P" in signals(codec)
    assert sum("does not say by which signal" in line for line in codec.left_out) == 2


NESTED = (
    ' SG_ M M : 0|8@1+ (1,0) [0|0] "" A\n SG_ N m244M : 8|8@1+ (1,0) [0|0] "" A\n'
    ' SG_ X m10 : 16|8@1+ (1,0) [0|0] "" A\nSG_MUL_VAL_ 256 N M 244-244;\n'
)


@pytest.mark.parametrize(
    "entry",
    ["SG_MUL_VAL_ 256 X N 5..12;", "SG_MUL_VAL_ 256 X N 12-5;", "SG_MUL_VAL_ 256 X N;",
     "SG_MUL_VAL_ 256 X N 5-12", "SG_MUL_VAL_ 256 X N 5-70000;", "SG_MUL_VAL_ 256 X ! 5-12;"],
)  # fmt: skip
def test_a_signal_goes_with_its_multiplexing(tmp_path, entry):
    codec = codec_of(tmp_path, D + NESTED + entry + "\n" + E)
    assert signals(codec) == ["D.M", "D.N", "E.Q"]
    assert [line.split(" ")[1] for line in codec.left_out] == ["12:", "10:"]
    assert "its SG_MUL_VAL_ (line 12) cannot be used" in codec.left_out[1]


def test_ranges_with_blanks(tmp_path):
    codec = codec_of(tmp_path, D + NESTED + "SG_MUL_VAL_ 256 X N 5 - 12 , 20-20 ;\n")
    assert codec.messages[0].signals[2].mux_ranges == ((5, 12), (20, 20))


@pytest.mark.parametrize(
    "entry", ["256 F 1;", "256 F : 1", "256 F : 3;", "256 F : one;", "256 : F 1;"]
)
def test_a_signal_goes_with_its_type(tmp_path, entry):
    codec = codec_of(tmp_path, D + F + f"SIG_VALTYPE_ {entry}\n" + E)
    assert "D.F" not in signals(codec)
    assert "E.Q" in signals(codec)
    assert "its SIG_VALTYPE_ (line " in codec.left_out[1]


@pytest.mark.parametrize(
    "entry", ["SG_MUL_VAL_ 256 Nope M 1-2;", "SIG_VALTYPE_ 999 P : 1;", "SIG_VALTYPE_ 9 256 P;"]
)
def test_an_entry_of_another_signal_costs_none(tmp_path, entry):
    selector = ' SG_ M M : 0|8@1+ (1,0) [0|0] "" A\n'
    codec = codec_of(tmp_path, D + selector + MUX + entry + "\n")
    assert sorted(signals(codec)) == ["D.M", "D.P", "D.X", "D.Y"]
    (note,) = codec.left_out
    assert "of a signal that the file does not have" in note


# ---- identifiers and names ---------------------------------------------------------------------


@pytest.mark.parametrize("number", ["3221225473", "536871168", "4294967552", "9" * 26, "9" * 5000])
def test_an_identifier_that_no_frame_has_costs_its_message(tmp_path, number):
    codec = codec_of(tmp_path, D.replace("256", number) + A + f'VAL_ {number} A 0 "a" ;\n' + E)
    assert signals(codec) == ["E.Q"]
    (note,) = codec.left_out
    assert note.startswith("line 7: ")
    assert "no frame has the identifier" in note


@pytest.mark.parametrize("name", ["{}x", "Größe{}", "a-{}"])
def test_any_number_of_names_that_are_none(tmp_path, name):
    """The work grows with the size of the file and not with its square."""

    def text(count):
        return D + "".join(A.replace(" A ", f" {name.format(k)} ", 1) for k in range(count)) + A + E

    few = calls(lambda: codec_of(tmp_path, text(500)))
    assert calls(lambda: codec_of(tmp_path, text(2000))) < 6 * few
    codec = codec_of(tmp_path, text(2000))
    assert signals(codec) == ["D.A", "E.Q"]
    assert len(codec.left_out) == 2000


def test_any_number_of_entries_that_cantools_does_not_know(tmp_path):
    codec = codec_of(tmp_path, D + A + "".join(f"EV_: e{k};\n" for k in range(100)) + E)
    assert signals(codec) == ["D.A", "E.Q"]
    assert len(codec.left_out) == 100


# ---- which entry it is -------------------------------------------------------------------------


def test_nobody_receives_it(tmp_path):
    bare = A.replace(" A\n", "\n").replace(" A ", " C ", 1)
    for text in (bare, bare.replace("\n", "  \n"), bare.replace('"x"', '"x" Inv-1, Ab.c')):
        codec = codec_of(tmp_path, "BO_ 256 D: 8\n" + text + A + E)
        assert sorted(signals(codec)) == ["D.A", "D.C", "E.Q"]
        assert codec.left_out == ()


@pytest.mark.parametrize("line", ["FOO_ 256 bar;", "# hash", "\0\0", "/* block */", "a\nb\nc"])
@pytest.mark.parametrize("before", ["", A, A + 'VAL_ 256 A 0 "a" ;\n'])
def test_a_foreign_line_costs_itself(tmp_path, line, before):
    codec = codec_of(tmp_path, D + before + line + "\n" + E)
    assert signals(codec) == ["D.A"] * bool(before) + ["E.Q"]
    (note,) = codec.left_out
    assert note.startswith(f"line {8 + before.count(chr(10))}: ")
    assert "not an entry of a DBC" in note


@pytest.mark.parametrize("end", ["\x1a", "\0\0\0", "// the end", "\n\n\x1a\0"])
def test_what_may_stand_at_the_end(tmp_path, end):
    for text in (D + A, D + A.rstrip(), D + A + 'CM_ "x";'):
        codec = codec_of(tmp_path, E + text + end)
        assert signals(codec) == ["E.Q", "D.A"]
        assert codec.left_out == ()


def test_comments_behind_two_strokes(tmp_path):
    text = D + f" //{A}" + A + 'VAL_ 256 A 65535 "SNA"; // end\nCM_ "http://x";\n' + E
    codec = codec_of(tmp_path, text)
    assert signals(codec) == ["D.A", "E.Q"]
    assert codec.left_out == ()
    assert codec.messages[0].signals[0].not_available == 65535


def test_several_entries_in_a_line(tmp_path):
    text = (D + A + A.replace(" A ", " B ", 1).replace("0|16", "16|16")).replace("\n", " ") + "\n"
    more = 'VAL_ 256 A 65535 "SNA"; VAL_ 257 Q 255 "SNA";; CM_ SG_ 256 A "SG_ x : 1";\n'
    codec = codec_of(tmp_path, text + E + more)
    assert signals(codec) == ["D.A", "D.B", "E.Q"]
    assert [m.signals[0].not_available for m in codec.messages] == [65535, 255]
    assert codec.left_out == ()


def test_a_signal_without_a_message_is_listed(tmp_path):
    codec = codec_of(tmp_path, E + 'CM_ "x";\n' + A)
    (note,) = codec.left_out
    assert note == "line 10: SG_ A: does not follow a message"


def test_what_is_no_dbc(tmp_path):
    for text in ("", "nothing of it\n", "\0" * 100):
        with pytest.raises(DbcMismatch, match="no entry of one"):
            codec_of(tmp_path, text, head="")


def test_entries_keep_their_lines():
    text = "// first\nBU_: A\n  B\n" + D + A + '\nCM_ BO_\n  256\n "two\nlines"\n;VAL_TABLE_ t ;\n'
    assert [(e.line, e.keyword) for e in split(text)] == [
        (2, "BU_"), (4, "BO_"), (5, "SG_"), (7, "CM_"), (11, "VAL_TABLE_"),
    ]  # fmt: skip


# ---- numbers that are none ---------------------------------------------------------------------


def test_a_float_that_is_no_number_is_counted_as_that(tmp_path, capsys):
    text = D + F + F.replace(" F ", " G ").replace("0|32", "32|32").replace("[0|0]", "[-5|5]")
    codec = codec_of(tmp_path, text + "SIG_VALTYPE_ 256 F : 1;\nSIG_VALTYPE_ 256 G : 1;\n")
    log, out = tmp_path / "a.log", tmp_path / "a.csv"
    values = [(1.0, float("nan")), (float("inf"), float("-inf")), (1.0, 9.0)]
    frames = [struct.pack("<ff", *pair) for pair in values]
    log.write_text("".join(f"({k}.000000) can0 100#{d.hex()}\n" for k, d in enumerate(frames)))
    readings = codec.decode(codec.messages[0], frames[0])
    assert (readings["F"].validity, readings["G"].validity) == (VALID, NOT_A_NUMBER)
    assert main(["convert", str(log), str(out), "--dbc", str(tmp_path / "a.dbc")]) == 0
    note = capsys.readouterr().out
    assert "values: valid 2, range 1, not_a_number 3\n" in note
    assert "out of range, kept and marked: D.G 1\n" in note
    rows = [line.split(",")[3:] for line in out.read_text().splitlines()]
    assert rows[1:] == [["1", "", ""], ["", "", ""], ["1", "9", "G"]]


FOREIGN = Path(__file__).parents[1] / "data" / "dbc"
GOOD = 'BO_ 1 M: 8 A\n SG_ x : 0|8@1+ (1,0) [0|200] "" A\n SG_ y : 8|8@1- (1,0) [-5|5] "" A\n'


@pytest.mark.parametrize(
    ("entry", "line", "why"),
    [
        ("BO_ 2 N: 200 A\n SG_ z : 1584|16@1+ (1,0) [0|1] \"\" A\n", 7, "200 bytes; CAN FD has 64"),
        ("BO_ 2 N 8 A\n", 7, "is not a message"),
    ],
)  # fmt: skip
def test_one_entry_costs_itself(tmp_path, entry, line, why):
    codec = codec_of(tmp_path, entry + GOOD)
    assert signals(codec) == ["M.x", "M.y"]
    (told,) = codec.left_out
    assert told.startswith(f"line {line}: ")
    assert why in told


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("0|8@1+ (1,0) [0|1 \"\" A", "is not a signal"),
        ("0|80@1+ (1,0) [0|1] \"\" A", "80 bits; 1 to 64 are possible"),
        ("600|8@1+ (1,0) [0|1] \"\" A", "starts at bit 600 of 512"),
        ("60|8@1+ (1,0) [0|1] \"\" A", "does not fit in 8 bytes"),
        ("0|8@1+ (0,0) [0|1] \"\" A", "cannot be inverted"),
        ("0|8@1+ (1e999,0) [0|1] \"\" A", "a number too large for a double"),
    ],
)  # fmt: skip
def test_one_signal_costs_itself(tmp_path, text, why):
    codec = codec_of(tmp_path, GOOD + f" SG_ z : {text}\n" + GOOD.replace("1 M", "2 N"))
    assert signals(codec) == ["M.x", "M.y", "N.x", "N.y"]
    (told,) = codec.left_out
    assert told.startswith("line 10: ")
    assert why in told


def test_a_list_of_nodes_is_not_needed(tmp_path):
    codec = codec_of(tmp_path, GOOD, HEAD.replace("BU_: A\n", "\n"))
    assert signals(codec) == ["M.x", "M.y"]
    assert codec.left_out == ()
    with pytest.raises(DbcMismatch, match="no such file"):
        bind_usable(tmp_path / "none.dbc")


@pytest.mark.parametrize("bounds", ["0|0", "0.0|0.0", "5|5", "300|400", "7|3"])
def test_a_range_that_cannot_be_is_none(tmp_path, bounds):
    codec = codec_of(tmp_path, GOOD.replace("0|200", bounds))
    (spec,) = codec.messages
    assert (spec.signals[0].raw_min, spec.signals[0].raw_max) == (0, 255)
    assert len(codec.left_out) == (bounds in ("300|400", "7|3"))


@pytest.mark.parametrize(
    ("labels", "raw", "code"),
    [
        ('255 "SNA"', 255, NOT_AVAILABLE), ('254 "not available" 255 "error"', 254, NOT_AVAILABLE),
        ('0 "EU" 4 "NA"', 4, VALID), ('0 "off" 1 "not_available" 2 "on"', 1, VALID),
        ('0 "off" 255 "SNA" 1 "on"', 255, NOT_AVAILABLE), ('0 "off" 9 "SNA" 1 "on"', 9, VALID),
        ('0 "off" 220 "SNA" 1 "on"', 220, NOT_AVAILABLE), ('0 "off" 220 "NA" 1 "on"', 220, RANGE),
    ],
)  # fmt: skip
def test_what_a_label_of_no_data_means(tmp_path, labels, raw, code):
    codec = codec_of(tmp_path, GOOD + f"VAL_ 1 x {labels} ;\n")
    (spec,) = codec.messages
    assert codec.decode(spec, bytes([raw, *bytes(7)]))["x"].validity == code


def test_an_unsigned_code_of_a_signed_signal(tmp_path):
    codec = codec_of(tmp_path, GOOD + 'VAL_ 1 y 255 "Not available" 254 "Error" ;\n')
    (spec,) = codec.messages
    assert codec.decode(spec, b"\0\xff" + bytes(6))["y"].validity == NOT_AVAILABLE
    assert codec.left_out == ()


def test_names_and_identifiers_that_are_used_twice(tmp_path):
    text = GOOD + GOOD.replace("BO_ 1", "BO_ 2") + GOOD.replace("BO_ 1 M", "BO_ 2 N")
    codec = codec_of(tmp_path, text)
    assert [(m.name, m.can_id) for m in codec.messages] == [("M", 1), ("N", 2)]
    codec = codec_of(tmp_path, GOOD + GOOD.replace("BO_ 1", "BO_ 2"))
    assert [(m.name, m.can_id) for m in codec.messages] == [("M", 1), ("M_2", 2)]
    assert "another message has this name" in codec.left_out[0]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252"])
def test_units_in_any_encoding(tmp_path, encoding):
    codec = codec_of(tmp_path, GOOD.replace('""', '"\xb0C"', 1), encoding=encoding)
    assert codec.messages[0].signals[0].unit == "\xb0C"


@pytest.mark.parametrize("path", sorted(FOREIGN.glob("*.dbc")), ids=lambda path: path.stem)
def test_values_are_cantools_on_every_file_that_both_load(path):
    logging.getLogger("cantools").setLevel(logging.ERROR)
    codec = bind_usable(path)
    try:
        database = cantools.database.load_string(decoded(path.read_bytes()), "dbc", strict=False)
    except cantools.database.Error:
        assert codec.messages, "cantools refuses it, and more than nothing can be used"
        return
    rng = random.Random(7)
    for spec in codec.messages:
        message = database.get_message_by_name(spec.name)
        for _ in range(20):
            data = rng.randbytes(spec.length)
            try:
                wanted = message.decode(data, decode_choices=False, allow_truncated=True)
            except cantools.database.DecodeError:  # a selector that selects nothing
                continue
            for name, found in codec.decode(spec, data).items():
                assert (found.validity == ABSENT) == (name not in wanted)
                if name in wanted:
                    same = math.isclose(found.value, wanted[name], rel_tol=1e-12, abs_tol=1e-9)
                    assert same or math.isnan(wanted[name])
