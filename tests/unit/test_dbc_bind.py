"""bind: one error that lists everything; what a user's own DBC may leave out."""

import re
from pathlib import Path

import pytest

from dbc import generate as build
from dbc.codec import bind
from dbc.contract import ANY, CLASSIC, FD
from dbc.e2e import p02_data_ids
from dbc.load import load
from dbc.spec import DbcMismatch, Profile
from tests.dbc_text import message, signal, without, write

FOLDER = Path(build.__file__).parent
FOREIGN = Path(__file__).parents[1] / "data" / "dbc"
TEXT = (FOLDER / "traction.dbc").read_text()


def problems_of(path, nodes=(1, 2), contract=None):
    with pytest.raises(DbcMismatch) as caught:
        bind(path, nodes, contract)
    assert str(path) in str(caught.value)
    assert all(line in str(caught.value) for line in caught.value.problems)
    return caught.value.problems


def changed(tmp_path, *changes):
    text = TEXT
    for pattern, replacement in changes:
        text, count = re.subn(pattern, replacement, text, flags=re.MULTILINE)
        assert count, f"nothing to change for {pattern}"
    path = tmp_path / "changed.dbc"
    path.write_text(text)
    return path


def test_the_contract_is_chosen_by_the_file():
    assert not bind(FOLDER / "traction.dbc", (1,)).fd
    assert bind(FOLDER / "traction_fd.dbc", (1,)).fd
    assert "Drive1_Samples: message missing" in problems_of(FOLDER / "traction.dbc", (1,), FD)
    missing = problems_of(FOLDER / "traction_fd.dbc", (1, 2), CLASSIC)
    assert missing == (
        "Drive1_PhaseCurrents: message missing",
        "Drive2_PhaseCurrents: message missing",
        "Drive1_StatorVoltages: message missing",
        "Drive2_StatorVoltages: message missing",
    )


def test_every_mismatch_in_one_error(tmp_path):
    path = changed(
        tmp_path,
        (r'(SG_ Torque .*) "Nm" Gateway\n\nBO_ 898', r'\1 "kNm" Gateway\n\nBO_ 898'),
        (r'BA_ "GenMsgCycleTime" BO_ 642 2;', r'BA_ "GenMsgCycleTime" BO_ 642 0;'),
        (r'BA_ "VFrameFormat" BO_ 1152 0;|BA_ "VFrameFormat" BO_ 1153 0;', "#"),
        (r"#", 'BA_ "VFrameFormat" BO_ 1153 14;'),
        (r'VAL_ 1184 State 1 "Starting" 2 "Running"', 'VAL_ 1184 State 1 "Running" 2 "Starting"'),
        (r'BA_ "E2EDataIdList" BO_ 416 "..', 'BA_ "E2EDataIdList" BO_ 416 "Z'),
        (r"\[-655.32\|655.32\] \"A\" Gateway\n\nBO_ 386", '[700|-655.32] "A" Gateway\n\nBO_ 386'),
        (r"VAL_ 386 Ia 32767", "VAL_ 386 Ia 32766"),
        (r'BA_ "GenSigStartValue" SG_ 386 Ib 32767', 'BA_ "GenSigStartValue" SG_ 386 Ib 40000'),
    )
    path.write_text(without(path.read_text(), "Gateway_Info"))
    assert sorted(problems_of(path)) == sorted([
        "Drive1_Motion.Torque: unit 'kNm', expected 'Nm'",
        "Drive1_PhaseCurrents.Ic: range 700..-655.32 is empty",
        "Drive1_Temperatures: is CAN FD, expected classic CAN (VFrameFormat)",
        "Drive2_PhaseCurrents.Ia: not-available code 32766 lies inside the range",
        "Drive2_PhaseCurrents.Ib: start value 40000 does not fit in 16 bits",
        "Drive2_StatorVoltages: no cycle time (GenMsgCycleTime)",
        "Gateway_Adhesion: E2EDataIdList 'ZC6CCCAD8DED4D2F0F6FCFAE8EEE4E2' is not 32 hex digits",
        "Gateway_Info: message missing",
        "Gateway_Status.State: 1 means 'Running', expected 'Starting'",
        "Gateway_Status.State: 2 means 'Starting', expected 'Running'",
    ])  # fmt: skip


def test_drives_that_are_not_asked_for_may_be_missing(tmp_path):
    path = tmp_path / "one.dbc"
    text = TEXT
    for kind in ("PhaseCurrents", "StatorVoltages", "Motion", "Status", "Temperatures"):
        text = without(text, f"Drive2_{kind}")
    path.write_text(text)
    assert "Drive2_Motion" not in bind(path, (1, 3)).by_name
    assert len(problems_of(path, (1, 2, 3))) == 5


def test_missing_signal_and_widths(tmp_path):
    path = changed(
        tmp_path,
        (r"^ SG_ Ualpha .*\n((?: SG_.*\n)+\nBO_ 642)", r"\1"),
        (r"^.* 641 Ualpha .*\n", ""),
        (r"SG_ ConfigHash : 16\|24", "SG_ ConfigHash : 16|16"),
        (r"SG_ Adhesion16 : 46\|2", "SG_ Adhesion16 : 46|1"),
        (r"BO_ 1281 Drive1_Estimate: 8", "BO_ 1281 Drive1_Estimate: 12"),
    )
    assert sorted(problems_of(path, (1,))) == [
        "Drive1_Estimate: 12 bytes, expected 8",
        "Drive1_StatorVoltages.Ualpha: signal missing",
        "Gateway_Adhesion.Adhesion16: 1 bits, expected 2",
        "Gateway_Adhesion.Adhesion16: 2 (AdhesionLost) is outside the range 0..1",
        "Gateway_Info.ConfigHash: 16 bits, expected 24",
    ]


@pytest.mark.parametrize(("parts", "problems"), [
    pytest.param(
        [message(5, "A", 8, signal("X", 0, 8), signal("X", 8, 8)), message(5, "B", 8),
         message(0x80000005, "C", 8), message(6, "A", 8)],
        ["A: defined 2 times", "id 0x005: shared by A, B", "A.X: defined 2 times"],
        id="duplicates that cantools lets pass",
    ),
    pytest.param(
        [message(5, "A", 2, signal("X", 0, 9), signal("Y", 8, 8), signal("Z", 12, 8)),
         message(6, "B", 1, signal("M M", 0, 2), signal("P m0", 2, 3), signal("Q m1", 3, 3)),
         message(7, "C", 8, signal("R", 7, 12, order=0), signal("S", 12, 2))],
        ["A.Z: does not fit in 2 bytes (line 10)", "A: X and Y overlap (line 7)",
         "A: Y and Z overlap (line 7)", "C: R and S overlap (line 17)"],
        id="all overlaps and misfits, not only the first",
    ),
    pytest.param(
        [message(5, "A", 10**12, signal("X", 0, 10**12), signal("Y", 10**12, 8)),
         message(6, "B", 65), "SG_MUL_VAL_ 5 X Y 0-4294967295;", 'BA_DEF_ "Hash" STRING;',
         'BA_ "Hash" "1e4000";', 'BA_DEF_ "N" INT 0 1E999999999;'],
        ["line 7: A: 1000000000000 bytes; CAN FD has 64",
         "line 8: X: 1000000000000 bits; 1 to 64 are possible",
         "line 9: Y: starts at bit 1000000000000 of 512", "line 11: B: 65 bytes; CAN FD has 64",
         "line 13: multiplexer values above 65535", "line 16: a number with more than 300 digits"],
        id="numbers that no frame has, before cantools looks for memory for them",
    ),
    pytest.param(
        [message(5, "A", 1), message(6, "B", 8, signal("Crc", 16, 8), signal("Data", 4, 12)),
         message(7, "C", 8), message(0x90000000, "D", 8), message(8, "E", 8),
         'BA_DEF_ BO_ "E2EProfile" ENUM "None","P02","P05","P11";',
         'BA_DEF_ BO_ "E2EDataId" INT 0 4294967295;', 'BA_DEF_DEF_ "E2EProfile" "P02";',
         'BA_DEF_DEF_ "E2EDataId" 0;', 'BA_ "E2EProfile" BO_ 7 3;',
         'BA_ "E2EProfile" BO_ 2415919104 2;', 'BA_ "E2EProfile" BO_ 8 0;'],
        ["A: 1 bytes have no room for the P02 header", "B.Data: lies in the P02 header",
         "B.Crc: P02 has it at 0|8@1+", "C: E2EProfile 'P11'; known: None, P02, P05",
         "D: E2EDataId 268435456 does not fit in 16 bits"],
        id="protection attributes",
    ),
    pytest.param(
        [message(5, "A", 8), message(6, "B", 8), 'BA_DEF_ BO_ "GenMsgCycleTime" STRING;',
         'BA_DEF_DEF_ "GenMsgCycleTime" "soon";', 'BA_ "GenMsgCycleTime" BO_ 5 "";'],
        ["B: GenMsgCycleTime 'soon' is not a time in ms"],
        id="a cycle time that is no time",
    ),
    pytest.param(
        [message(5, "A", 8, signal("X", 0, 16, "-"), signal("Z", 32, 8, rest='(0,0) [0|0] ""')),
         "SIG_VALTYPE_ 5 X : 1;"],
        ["A.X: a float of 16 bits is not supported", "A.Z: scale 0, offset 0 cannot be inverted"],
        id="half floats and a scale of zero",
    ),
])  # fmt: skip
def test_what_a_file_must_not_have_is_listed(tmp_path, parts, problems):
    path = write(tmp_path / "a.dbc", *parts)
    assert list(problems_of(path, (), ANY)) == problems


def test_data_ids_by_rule_by_id_and_by_list(tmp_path):
    listed = bytes(range(16))
    path = write(
        tmp_path / "ids.dbc",
        message(0x123, "Rule", 8),
        message(0x124, "Id", 8),
        message(0x125, "List", 8),
        message(0x126, "P5", 8),
        message(0x127, "P5Id", 8),
        'BA_DEF_ BO_ "E2EProfile" ENUM "None","P02","P05";',
        'BA_DEF_ BO_ "E2EDataId" INT 0 65535;',
        'BA_DEF_ BO_ "E2EDataIdList" STRING;',
        'BA_DEF_DEF_ "E2EProfile" "P02";',
        'BA_DEF_DEF_ "E2EDataId" 0;',
        'BA_DEF_DEF_ "E2EDataIdList" "";',
        f'BA_ "E2EDataId" BO_ {0x124} 777;',
        f'BA_ "E2EDataIdList" BO_ {0x125} "{listed.hex()}";',
        f'BA_ "E2EProfile" BO_ {0x126} 2;',
        f'BA_ "E2EProfile" BO_ {0x127} 2;',
        f'BA_ "E2EDataId" BO_ {0x127} 4660;',
    )
    ids = {m.name: m.data_ids for m in bind(path, (), ANY).messages}
    assert ids == {
        "Rule": p02_data_ids(0x123),
        "Id": p02_data_ids(777),
        "List": listed,
        "P5": b"\x01\x26",
        "P5Id": b"\x12\x34",
    }


def test_own_dbc_without_protection_and_codes(tmp_path):
    """A user's DBC may declare no E2E at all, no codes and its own scaling."""
    lines = [
        line
        for line in TEXT.splitlines()
        if not re.match(r"VAL_|.*E2E| SG_ (Crc|Counter)|.* (Crc|Counter) ", line)
    ]
    path = tmp_path / "own.dbc"
    path.write_text("\n".join(lines).replace("(0.02,0)", "(0.05,0)") + "\n")
    codec = bind(path, (1, 2))
    spec = codec.by_name["Drive1_PhaseCurrents"]
    assert spec.profile is Profile.NONE
    assert spec.data_ids == b""
    assert spec.signals[1].not_available is None
    assert spec.signals[1].scale == 0.05
    absent = codec.decode(spec, bytes(codec.encode(spec, {"Ia": None})))["Ia"]
    assert absent.raw == spec.signals[1].start_raw == 0x7FFF
    assert absent.validity.name != "VALID"


def test_slower_copy_changes_the_periods(tmp_path):
    path = changed(tmp_path, (r'("GenMsgCycleTime" BO_ \d+) 2;', r"\1 20;"))
    assert bind(path, (1,)).by_name["Drive1_PhaseCurrents"].cycle_ns == 20_000_000


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("cantools_bad_message_length.dbc", "Message1.Signal1: does not fit in 1 bytes"),
        ("kona_pcan_head.dbc", "Invalid syntax at line 6"),
        ("opendbc_tesla_excerpt.dbc", "UI_mapSpeedLimit"),
    ],
)
def test_real_files_that_are_refused(name, text):
    (problem,) = problems_of(FOREIGN / name, (), ANY)
    assert text in problem
    assert "\n" not in problem


@pytest.mark.parametrize(
    ("name", "line", "cure", "broken", "mended"),
    [
        ("kona_pcan_head.dbc", 6, 'add a line "BU_: XXX"', r"^BO_ 127 ", "BU_: XXX\nBO_ 127 "),
        ("opendbc_tesla_excerpt.dbc", 49, "delete the line", r"^VAL_ 568 UI_map.*\n", ""),
    ],
)
def test_the_cure_of_a_refused_file_cures_it(tmp_path, name, line, cure, broken, mended):
    (problem,) = problems_of(FOREIGN / name, (), ANY)
    assert problem.startswith(f"line {line}: ")
    assert cure in problem
    text = (FOREIGN / name).read_text(encoding="cp1252")
    path = tmp_path / "mended.dbc"
    path.write_text(re.sub(broken, mended, text, count=1, flags=re.MULTILINE), encoding="cp1252")
    assert load(path).messages


def test_any_other_syntax_error_has_its_line_and_no_invented_cure(tmp_path):
    path = tmp_path / "bracket.dbc"
    path.write_text('VERSION ""\nBU_: A\nBO_ 1 M: 8 A\n SG_ x : 0|8@1+ (1,0) [0|1 "" A\n')
    (problem,) = problems_of(path, (), ANY)
    assert "line 4" in problem
    assert "correct this line" in problem
    assert "BU_" not in problem


def test_every_unused_value_table_has_its_line(tmp_path):
    path = tmp_path / "tables.dbc"
    head = 'VERSION ""\nBU_: A\nBO_ 1 M: 8 A\n SG_ x : 0|8@1+ (1,0) [0|1] "" A\n'
    path.write_text(head + 'VAL_ 1 y 0 "a" ;\nVAL_ 2 x 0 "a" ;\n')
    first, second = problems_of(path, (), ANY)
    assert first.startswith("line 5: VAL_ 1 y: ")
    assert second.startswith("line 6: VAL_ 2 x: ")
    path.write_text(head + 'VAL_ 1 y 0 "a" ;\nVAL_\n2 x 0 "a" ;\n')
    first, second = problems_of(path, (), ANY)
    assert first.startswith("line 5: VAL_ 1 y: ")
    assert second.startswith("VAL_ 2 x: ")


def test_files_that_are_no_dbc(tmp_path):
    assert problems_of(tmp_path / "none.dbc") == ("no such file",)
    (problem,) = problems_of(tmp_path)
    assert problem.startswith("cannot be read")
    garbage = tmp_path / "garbage.dbc"
    garbage.write_bytes(bytes(range(256)))
    (problem,) = problems_of(garbage)
    assert "line 1" in problem
    empty = tmp_path / "empty.dbc"
    empty.write_text("")
    assert problems_of(empty, (1,))[0].startswith("Invalid syntax at line 1")
    bare = write(tmp_path / "bare.dbc")
    assert "Drive1_Motion: message missing" in problems_of(bare, (1,))


def test_foreign_file_without_messages_binds_to_nothing():
    codec = bind(FOREIGN / "cantools_cp1252.dbc", (), ANY)
    assert codec.messages == ()
    assert codec.width == 0
