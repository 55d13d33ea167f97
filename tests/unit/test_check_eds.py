"""`check --eds`: heartbeat and PDOs of real files, of a DCF, and of files that are none."""

import gzip
from pathlib import Path

import pytest
from canopen import import_od

from gateway.cli import main
from gateway.io.device_file import Mapped, device_of
from gateway.io.eds_text import EdsText, number_of
from gateway.settings.config import ConfigError

DATA = Path(__file__).parents[1] / "data" / "eds"
TRAIN = str(Path(__file__).parents[2] / "examples" / "train.toml")


def record(section, name, kind, access, default=None):
    """A variable, or an entry of an array, of one of CANopen's kinds of numbers."""
    lines = [f"[{section}]", f"ParameterName={name}", "ObjectType=0x7", f"DataType=0x{kind:04X}"]
    lines += [f"AccessType={access}", *([] if default is None else [f"DefaultValue={default}"])]
    return lines


def array(section, name, *entries, count, access="ro"):
    """An array or a record: the number of its entries, and those that the file has."""
    head = [f"[{section}]", f"ParameterName={name}", "ObjectType=0x9", f"SubNumber={count}"]
    number = record(f"{section}sub0", "Entries", UNSIGNED8, access, count - 1)
    return [*head, *number, *(line for entry in entries for line in entry)]


def listed(kind, *indices):
    """Which objects of a kind there are."""
    names = [f"{k}=0x{index}" for k, index in enumerate(indices, start=1)]
    return [f"[{kind}Objects]", f"SupportedObjects={len(indices)}", *names]


UNSIGNED8, UNSIGNED16, UNSIGNED32, SIGNED32 = 5, 6, 7, 4
DCF = "\n".join([
    "[FileInfo]", "FileName=d.dcf",
    "[DeviceInfo]", "VendorName=", "VendorNumber=", "ProductName=Drive 5",
    "[DeviceComissioning]", "NodeID=0x05", "NodeName=",
    *listed("Mandatory", "1000"), *record("1000", "Device type", UNSIGNED32, "ro", 0),
    *listed("Optional", "1017", "1800", "1A00", "1801"),
    *record("1017", "Producer heartbeat time", UNSIGNED16, "rw", 0), "ParameterValue={heartbeat}",
    *array("1800", "TPDO 1", record("1800sub1", "COB-ID", UNSIGNED32, "rw", "$NODEID+0x180"),
           count=2),
    *array("1801", "TPDO 2, not in use",
           record("1801sub1", "COB-ID", UNSIGNED32, "rw", "0x80000285"), count=2),
    *array("1A00", "Mapping", record("1A00sub1", "First", UNSIGNED32, "rw", "0x60410010"),
           record("1A00sub2", "Second", UNSIGNED32, "rw", "0x20000220"), count=3, access="rw"),
    *listed("Manufacturer", "2000"),
    *array("2000", "Motor", record("2000sub2", "Temperature", SIGNED32, "ro"), count=3),
    "",
])  # fmt: skip


@pytest.fixture
def dcf(tmp_path):
    def write(heartbeat=250, text=DCF):
        path = tmp_path / "d.dcf"
        path.write_text(text.replace("{heartbeat}", str(heartbeat)))
        return path

    return write


def check(capsys, path, train=TRAIN):
    code = main(["check", train, "--no-timing", "--eds", str(path)])
    said = capsys.readouterr()
    return code, said.out, said.err


def test_a_real_cia_402_drive():
    device = device_of(DATA / "canopen_sample.eds")
    assert device.heartbeat_ms == 0
    assert [pdo.can_id for pdo in device.pdos] == [0x190, 0x290, 0x390, 0x490]
    assert [(o.start, o.length, o.object_index) for o in device.pdos[3].objects] == [
        (0, 16, 0x6041), (16, 32, 0x606C),
    ]  # fmt: skip


def test_a_maker_without_a_name_or_number(capsys):
    code, out, _ = check(capsys, DATA / "canopennode_ds301.eds")
    assert code == 0
    assert "canopennode_ds301.eds: New Product, node 1, because the file names none" in out


def test_what_a_dcf_has_configured_counts(dcf):
    device = device_of(dcf())
    assert (device.name, device.node, device.heartbeat_ms) == ("Drive 5", 5, 250)
    [pdo] = device.pdos
    assert (pdo.number, pdo.can_id) == (1, 0x185)
    assert pdo.objects == (
        Mapped(0, 16, 0x6041, 0, "not in the file"),
        Mapped(16, 32, 0x2000, 2, "Motor: Temperature"),
    )


def test_check_says_what_of_it_matters(dcf, capsys, tmp_path):
    code, out, _ = check(capsys, dcf())
    assert code == 0
    assert "device         d.dcf: Drive 5, node 5" in out
    assert "  heartbeat    250 ms (1017h)\n" in out
    assert "  TPDO1        0x185, objects: 2\n" in out
    assert "    16|32      2000h.2 Motor: Temperature\n" in out
    assert "TPDO2" not in out
    assert "off (1017h is 0)" in check(capsys, dcf(0))[1]
    other = tmp_path / "other.toml"
    other.write_text("[canopen]\nheartbeat_ms = 100\n")
    assert "250 ms (1017h), but [canopen] heartbeat_ms = 100" in check(capsys, dcf(), str(other))[1]
    without = DCF[: DCF.index("[1017]")] + DCF[DCF.index("[1800]") :]
    assert "1017h is missing" in check(capsys, dcf(text=without))[1]


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (lambda _: "", 2), (lambda _: "no file of this kind", 2), (lambda _: "[a]\nb=1\n", 2),
        (lambda text: text[: len(text) // 2], 0), (lambda text: text * 2, 0),
        (lambda text: text.replace("0x60410010", "twelve"), 0),
        (lambda text: text.replace("DataType=0x0007", "DataType="), 0),
        (lambda text: text.replace("NodeID=0x05", "NodeID=999999999999"), 0),
        (lambda text: text.replace("DefaultValue=2\n", "DefaultValue=99999999999999999\n"), 0),
        (lambda text: text.replace("DefaultValue=2\n", "DefaultValue=254\n"), 0),
        (lambda text: "\n" * 200_000 + text, 0),
    ],
)  # fmt: skip
@pytest.mark.parametrize("suffix", ["dcf", "txt"])
def test_a_damaged_file_is_read_or_refused_in_words(damage, expected, suffix, dcf, capsys):
    path = dcf(text=damage(DCF))
    code, out, err = check(capsys, path.rename(path.with_suffix(f".{suffix}")))
    assert code == expected, err
    assert "Traceback" not in out + err
    assert (f"d.{suffix}" in err) == (code == 2)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        device_of(tmp_path / "none.eds")


def test_what_is_read_is_what_canopen_reads(tmp_path):
    paths = sorted(DATA.glob("*.eds"))
    assert len(paths) >= 2
    for path in paths:
        eds = EdsText(path.read_text())
        # canopen takes no empty number, which makers leave in [DeviceInfo].
        lines = path.read_text().splitlines(keepends=True)
        (tmp_path / path.name).write_text("".join(k for k in lines if not k.rstrip().endswith("=")))
        objects = import_od(str(tmp_path / path.name), 1)
        for index in (0x1017, *(k for k in objects if 0x1800 <= k < 0x1C00)):
            parts = objects[index] if index != 0x1017 else {None: objects[index]}
            for subindex in parts:
                wanted = parts[subindex].default
                found = eds.configured(index, subindex)
                assert (number_of(found.text, 1) if found else None) == wanted


def test_a_compressed_file(dcf, capsys):
    path = dcf()
    path.write_bytes(gzip.compress(path.read_bytes()))
    whole = device_of(path)
    assert (whole.heartbeat_ms, whole.faults) == (250, ())
    path.write_bytes(path.read_bytes()[:-200])
    assert "the compressed file ends in the middle" in device_of(path).faults
    path.write_bytes(b"\x1f\x8b\x08 and nothing of it")
    assert check(capsys, path)[0] == 2


@pytest.mark.parametrize(
    "text",
    ["$NODEID+0x180", "0x180+$NodeId", "$NODEID+180h", "($NODEID+0x180)", "$NODEID + 384",
     "0600+$NODEID", "0x40000180 + $NODEID"],
)  # fmt: skip
def test_an_identifier_in_every_form(text, dcf):
    [pdo] = device_of(dcf(text=DCF.replace("$NODEID+0x180", text))).pdos
    assert pdo.can_id == 0x185


@pytest.mark.parametrize("text", ["", "$NODEID+", "eleven", "0x", "-1", "0x123456789"])
def test_an_identifier_that_is_none_is_said(text, dcf, capsys):
    path = dcf(text=DCF.replace("$NODEID+0x180", text))
    assert device_of(path).pdos == ()
    note = f"TPDO1 is left out: [1800sub1] DefaultValue = {text!r} is not an identifier"
    assert note in check(capsys, path)[1]


@pytest.mark.parametrize(
    ("text", "note"),
    [("", "1017h is empty, which"), ("1000.0", "1017h is '1000.0', which"),
     ("-1", "1017h is '-1', which"), ("70000", "1017h is '70000', which")],
)  # fmt: skip
def test_a_heartbeat_that_is_no_time_is_said(text, note, dcf, capsys):
    path = dcf(heartbeat=text, text=DCF.replace("rw\nDefaultValue=0\n", "rw\n"))
    assert device_of(path).heartbeat_ms is None
    out = check(capsys, path)[1]
    assert f"{note} is not a number of ms from 0 to 65535" in out
    assert "missing" not in out


@pytest.mark.parametrize(
    ("old", "new", "note"),
    [
        ("[2000]\n", "[1017]\nDefaultValue=9\n[2000]\n", "section [1017] is there twice"),
        ("Name=Drive 5\n", "Name=Drive 5\nProductName=6\n", "[DeviceInfo] ProductName is there"),
        ("DefaultValue=0x20000220", "DefaultValue=twelve", "[1A00sub2] DefaultValue = 'twelve'"),
        ("4=0x1801\n", "4=0x1801\n5=0x1402\n", "listed, but not in the file: 1402h"),
        ("NodeName=\n", "what is this\n", "'what is this' is neither key nor section"),
    ],
)  # fmt: skip
def test_one_fault_costs_itself(old, new, note, dcf):
    device = device_of(dcf(text=DCF.replace(old, new)))
    assert (device.name, device.node, device.heartbeat_ms) == ("Drive 5", 5, 250)
    assert device.pdos[0].objects[0].object_index == 0x6041
    assert len(device.faults) == 1
    assert note in device.faults[0]
