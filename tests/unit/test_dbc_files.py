"""The shipped DBC files: what is generated, and what the contract and the core say."""

from pathlib import Path

import cantools
import pytest

from dbc import generate as build
from dbc import load as binding
from dbc.codec import bind
from dbc.e2e import p02_data_ids
from dbc.load import load
from tests.programs import loaded

FOLDER = Path(build.__file__).parent
FILES = ("traction.dbc", "traction_fd.dbc")


@pytest.fixture(scope="module", params=FILES)
def codec(request):
    return bind(FOLDER / request.param, range(1, 17))


@pytest.mark.parametrize("name", FILES)
def test_committed_is_generated(name):
    text = (FOLDER / name).read_text(encoding="ascii")
    assert text == build.render(build.FILES[name])


@pytest.mark.parametrize("name", FILES)
def test_attributes_comments_nodes(name):
    database = load(FOLDER / name)
    assert [node.name for node in database.nodes] == [
        "Gateway",
        *(f"Drive{n}" for n in range(1, 17)),
    ]
    for message in database.messages:
        attributes = message.dbc.attributes
        fd = message.name.endswith("Samples")
        assert attributes["E2EProfile"].value == (2 if fd else 1)
        assert attributes["E2EDataId"].value == message.frame_id
        assert attributes["VFrameFormat"].value == (14 if fd else 0)
        assert attributes["CANFD_BRS"].value == int(fd)
        sender = message.name.split("_")[0]
        own = ("_Estimate", "_Thermal", "_Adhesion")
        produced = sender == "Gateway" or message.name.endswith(own)
        assert message.senders == ["Gateway" if produced else sender]
        assert message.comment
        for signal in message.signals:
            assert signal.comment
            assert signal.unit is None or signal.unit.isascii()
            assert signal.raw_initial is not None
            assert signal.minimum is not None
            if message.name == "Gateway_Info":
                assert signal.receivers == []
            elif produced and sender != "Gateway":
                assert signal.receivers == [sender]
            else:
                assert "Gateway" in signal.receivers or "Drive16" in signal.receivers


def test_definitions_have_defaults_and_the_contracts_types():
    database = load(FOLDER / "traction_fd.dbc")
    definitions = database.dbc.attribute_definitions
    assert set(definitions) >= {
        "GenMsgCycleTime",
        "GenSigStartValue",
        "VFrameFormat",
        "CANFD_BRS",
        "BusType",
    }
    assert definitions["E2EProfile"].choices == ["None", "P02", "P05"]
    assert definitions["E2EProfile"].default_value == "None"
    assert definitions["E2EDataId"].type_name == "INT"
    assert definitions["E2EDataIdList"].type_name == "STRING"
    assert all(d.default_value is not None for d in definitions.values())
    assert database.dbc.attributes["BusType"].value == "CAN FD"


def test_data_ids_are_distinct_and_as_the_rule_says(codec):
    lists = [m.data_ids for m in codec.messages]
    assert len(set(lists)) == len(lists)
    can_id = 0x1A0
    base = (can_id ^ ((can_id >> 6) * 16)) & 0xFF
    assert p02_data_ids(can_id) == bytes(base ^ (2 * i) ^ (4 * i) for i in range(16))


def test_kinds_and_nodes(codec):
    spec = codec.by_name["Drive12_Motion"]
    assert (spec.kind, spec.node, spec.is_gateway) == ("Motion", 12, False)
    assert codec.by_id[0x50C] is codec.by_name["Drive12_Estimate"]
    assert codec.by_name["Drive12_Estimate"].is_gateway
    assert codec.by_name["Gateway_Status"].is_gateway
    assert not codec.by_name["Drive1_Status"].is_gateway
    ids = [m.can_id for m in codec.messages]
    assert len(set(ids)) == len(ids)
    reserved = {0x000, 0x080, *range(0x081, 0x100), *range(0x580, 0x680), *range(0x700, 0x780)}
    assert not reserved & set(ids), "CANopen keeps these"


@pytest.mark.parametrize("name", FILES)
def test_specs_of_the_table_are_what_cantools_reads(name):
    specs, problems = binding.read(FOLDER / name)
    assert problems == []
    assert repr(build.recall((FOLDER / name).read_bytes())) == repr(specs)


@pytest.mark.parametrize("name", FILES)
def test_tools_get_what_is_in_it_as_kcd_and_their_rules_are_kept(name):
    database = load(FOLDER / name)
    again = cantools.database.load_string(database.as_kcd_string(), "kcd")
    for message in database.messages:
        kept = again.get_message_by_name(message.name)
        assert (kept.frame_id, kept.length) == (message.frame_id, message.length)
        assert message.length in (*range(9), 64)
        for mine, theirs in zip(message.signals, kept.signals, strict=True):
            for key in ("name", "start", "length", "is_signed", "scale", "offset", "unit"):
                assert getattr(mine, key) == getattr(theirs, key)
            assert (mine.choices or {}) == (theirs.choices or {})
            # Longer names and labels without a raw value: refused by editors of DBC files.
            low = -(1 << mine.length - 1) if mine.is_signed else 0
            assert all(low <= raw < low + (1 << mine.length) for raw in mine.choices or ())
            assert low <= (mine.raw_initial or 0) < low + (1 << mine.length)
            assert max(len(mine.name), len(message.name)) <= 32


def test_a_changed_file_is_read_anew(tmp_path):
    content = (FOLDER / "traction.dbc").read_bytes()
    changed = content.replace(b"SG_ Ia : 16|16@1- (0.02,0)", b"SG_ Ia : 16|16@1- (0.04,0)")
    assert changed != content
    assert build.recall(changed) is None
    path = tmp_path / "traction.dbc"
    path.write_bytes(changed)
    (signal,) = (
        s for s in bind(path, (1,)).by_name["Drive1_PhaseCurrents"].signals if s.name == "Ia"
    )
    assert signal.scale == 0.04


def test_a_copy_elsewhere_is_known_by_its_content(tmp_path):
    copy = tmp_path / "other.dbc"
    copy.write_bytes((FOLDER / "traction.dbc").read_bytes())
    text = "from pathlib import Path; from dbc.codec import bind; bind(Path(sys.argv[1]), (1, 2))"
    assert not loaded(["cantools"], text, copy)


def test_the_check_of_what_is_generated_can_fail(tmp_path, monkeypatch, capsys):
    assert build.main(["--check"]) == 0
    monkeypatch.setattr(build, "HERE", tmp_path)
    assert build.main(["--check"]) == 1
    assert "traction.dbc is not what" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
    assert build.main() == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == list(FILES)
    assert build.main(["--check"]) == 0
