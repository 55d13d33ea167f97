"""DBCs of others: one entry that is wrong costs that entry, and is listed with its line."""

from __future__ import annotations

import logging
import math
import random
from pathlib import Path

import cantools
import pytest

from dbc.codec import Codec, bind_usable
from dbc.spec import ABSENT, NOT_AVAILABLE, RANGE, VALID, DbcMismatch
from dbc.text import decoded

FOREIGN = Path(__file__).parents[1] / "data" / "dbc"
HEAD = 'VERSION ""\nNS_ :\n\tCM_\n\tBA_DEF_\nBS_:\nBU_: A\n'
GOOD = 'BO_ 1 M: 8 A\n SG_ x : 0|8@1+ (1,0) [0|200] "" A\n SG_ y : 8|8@1- (1,0) [-5|5] "" A\n'


def codec_of(folder: Path, text: str, encoding: str = "utf-8") -> Codec:
    path = folder / "a.dbc"
    path.write_bytes(text.encode(encoding))
    return bind_usable(path)


def signals(codec: Codec) -> list[str]:
    return [f"{m.name}.{s.name}" for m in codec.messages for s in m.signals]


@pytest.mark.parametrize(
    ("entry", "line", "why"),
    [
        ("BO_ 2 N: 200 A\n SG_ z : 1584|16@1+ (1,0) [0|1] \"\" A\n", 7, "200 bytes; CAN FD has 64"),
        ("BO_ 5000 N: 8 A\n", 7, "no frame has the identifier 5000"),
        ("BO_ 2 N 8 A\n", 7, "is no message"),
        ("VAL_ 1 gone 0 \"a\" ;\n", 7, "of a signal that the file does not have"),
        ("VAL_ 9 x 0 \"a\" ;\n", 7, "of a signal that the file does not have"),
        ("what : is this\n", 7, "no entry of a DBC"),
        ("BA_ \"Unknown\" 1e4;;\n", 7, "no attribute 'Unknown' is defined"),
    ],
)  # fmt: skip
def test_one_entry_costs_itself(tmp_path: Path, entry: str, line: int, why: str) -> None:
    codec = codec_of(tmp_path, HEAD + entry + GOOD)
    assert signals(codec) == ["M.x", "M.y"]
    (told,) = codec.left_out
    assert told.startswith(f"line {line}: ")
    assert why in told


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("0|8@1+ (1,0) [0|1 \"\" A", "is no signal"),
        ("0|80@1+ (1,0) [0|1] \"\" A", "80 bits; 1 to 64 are possible"),
        ("600|8@1+ (1,0) [0|1] \"\" A", "starts at bit 600 of 512"),
        ("60|8@1+ (1,0) [0|1] \"\" A", "does not fit in 8 bytes"),
        ("0|8@1+ (0,0) [0|1] \"\" A", "cannot be inverted"),
        ("0|8@1+ (1e999,0) [0|1] \"\" A", "a number that no double has"),
    ],
)  # fmt: skip
def test_one_signal_costs_itself(tmp_path: Path, text: str, why: str) -> None:
    codec = codec_of(tmp_path, HEAD + GOOD + f" SG_ z : {text}\n" + GOOD.replace("1 M", "2 N"))
    assert signals(codec) == ["M.x", "M.y", "N.x", "N.y"]
    (told,) = codec.left_out
    assert told.startswith("line 10: ")
    assert why in told


def test_a_list_of_nodes_is_not_needed(tmp_path: Path) -> None:
    codec = codec_of(tmp_path, HEAD.replace("BU_: A\n", "\n") + GOOD)
    assert signals(codec) == ["M.x", "M.y"]
    assert codec.left_out == ()
    with pytest.raises(DbcMismatch, match="no such file"):
        bind_usable(tmp_path / "none.dbc")


@pytest.mark.parametrize("bounds", ["0|0", "0.0|0.0", "5|5", "300|400", "7|3"])
def test_a_range_that_cannot_be_is_none(tmp_path: Path, bounds: str) -> None:
    codec = codec_of(tmp_path, HEAD + GOOD.replace("0|200", bounds))
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
def test_what_a_label_of_no_data_means(tmp_path: Path, labels: str, raw: int, code: int) -> None:
    codec = codec_of(tmp_path, HEAD + GOOD + f"VAL_ 1 x {labels} ;\n")
    (spec,) = codec.messages
    assert codec.decode(spec, bytes([raw, *bytes(7)]))["x"].validity == code


def test_an_unsigned_code_of_a_signed_signal(tmp_path: Path) -> None:
    codec = codec_of(tmp_path, HEAD + GOOD + 'VAL_ 1 y 255 "Not available" 254 "Error" ;\n')
    (spec,) = codec.messages
    assert codec.decode(spec, b"\0\xff" + bytes(6))["y"].validity == NOT_AVAILABLE
    assert codec.left_out == ()


def test_names_and_identifiers_that_are_used_twice(tmp_path: Path) -> None:
    text = HEAD + GOOD + GOOD.replace("BO_ 1", "BO_ 2") + GOOD.replace("BO_ 1 M", "BO_ 2 N")
    codec = codec_of(tmp_path, text)
    assert [(m.name, m.can_id) for m in codec.messages] == [("M", 1), ("N", 2)]
    codec = codec_of(tmp_path, HEAD + GOOD + GOOD.replace("BO_ 1", "BO_ 2"))
    assert [(m.name, m.can_id) for m in codec.messages] == [("M", 1), ("M_2", 2)]
    assert "another message has this name" in codec.left_out[0]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252"])
def test_units_in_any_encoding(tmp_path: Path, encoding: str) -> None:
    codec = codec_of(tmp_path, HEAD + GOOD.replace('""', '"\xb0C"', 1), encoding)
    assert codec.messages[0].signals[0].unit == "\xb0C"


@pytest.mark.parametrize("path", sorted(FOREIGN.glob("*.dbc")), ids=lambda path: path.stem)
def test_values_are_cantools_on_every_file_that_both_load(path: Path) -> None:
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
