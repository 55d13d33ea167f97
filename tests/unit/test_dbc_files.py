"""The shipped DBC files against the contract's table, typed here once more."""

from __future__ import annotations

import re
import subprocess
import sys
from enum import IntEnum
from pathlib import Path

import pytest

from dbc import generate as build
from dbc import load as binding
from dbc.codec import Codec, bind
from dbc.dataids import p02_data_ids
from dbc.e2e import Profile
from dbc.load import load
from gateway.core import codes

FOLDER = Path(build.__file__).parent
FILES = ("traction.dbc", "traction_fd.dbc")

# name start|length[s] scale[,offset] [unit], and the raw range; "-" where there is no code.
TABLE = {
    "Drive{n}_PhaseCurrents": (
        0x180,
        2,
        "Quality 12|4 1; Ia 16|16s 0.02 A; Ib 32|16s 0.02 A; Ic 48|16s 0.02 A",
    ),
    "Drive{n}_StatorVoltages": (
        0x280,
        2,
        "Quality 12|4 1; Ualpha 16|16s 0.1 V; Ubeta 32|16s 0.1 V; Udc 48|16 0.1 V",
    ),
    "Drive{n}_Motion": (
        0x380,
        10,
        "Quality 12|4 1; Speed 16|16s 0.5 rpm; ElectricalAngle 32|16 0.01 deg; "
        "Torque 48|16s 0.1 Nm",
    ),
    "Drive{n}_Status": (
        0x1C0,
        100,
        "Quality 12|4 1; Irms 16|16 0.02 A; TorqueCommand 32|16s 0.1 Nm; State 48|4 1; "
        "FaultCode 52|12 1",
    ),
    "Drive{n}_Temperatures": (
        0x480,
        100,
        "Quality 12|4 1; Tstator 16|12 0.1,-60 degC; Tde 28|12 0.1,-60 degC; "
        "Tnde 40|12 0.1,-60 degC; Tambient 52|12 0.1,-60 degC",
    ),
    "Gateway_Adhesion": (
        0x1A0,
        10,
        "Reason 12|4 1; "
        + "; ".join(f"Adhesion{n} {14 + 2 * n}|2 1" for n in range(1, 17))
        + "; Detector 48|3 1; CommonMode 52|2 1; Age 56|8 1 ms",
    ),
    "Gateway_Faults": (
        0x2A0,
        100,
        "Reason 12|4 1; "
        + "; ".join(f"Thermal{n} {14 + 2 * n}|2 1" for n in range(1, 17))
        + "; SensorFault 48|2 1; CommFault 50|2 1; EstimatorFault 52|2 1; Overrun 54|2 1; "
        "Age 56|8 10 ms",
    ),
    "Drive{n}_Estimate": (
        0x500,
        20,
        "Health 12|4 1; Speed 16|16s 0.5 rpm; LoadTorque 32|16s 0.1 Nm; "
        "LossProbability 48|8 0.5 %; Nis 56|8 0.1",
    ),
    "Drive{n}_Thermal": (
        0x400,
        500,
        "FaultClass 12|4 1; Tmixed 16|12 0.1,-60 degC; Maisd 28|12 0.01 K; FaultSensor 40|4 1; "
        "Jumps 44|4 1; DegradationRate 48|16s 0.0001 K/h",
    ),
    "Gateway_Info": (
        0x3A0,
        1000,
        "ConfigHash 16|24 1; LatencyP99 40|12 10 us; LatenessP99 52|12 10 us",
    ),
    "Gateway_Auth": (0x320, 0, "Freshness 16|16 1; Mac 32|32 1"),
    "Gateway_Status": (
        0x4A0,
        100,
        "State 12|4 1; DeadlineMisses 16|12 1; RejectedFrames 28|12 1; LostFrames 40|12 1; "
        "BusLoad 52|7 1 %",
    ),
}
SAMPLES = (
    0x180,
    1,
    "Quality 24|8 1; SampleIndex 32|16 1; Udc 48|16 0.1 V; "
    + "; ".join(
        f"{name}_{k} {64 + 56 * k + 14 * j}|14s {scale} {unit}"
        for k in range(8)
        for j, (name, scale, unit) in enumerate(
            (
                ("Ia", 0.05, "A"),
                ("Ib", 0.05, "A"),
                ("Ualpha", 0.25, "V"),
                ("Ubeta", 0.25, "V"),
            )
        )
    ),
)
ENUMS = {
    "Quality": {0: "Initialising", 1: "Valid", 2: "Degraded", 15: "NotAvailable"},
    "Health": {
        0: "Unknown",
        1: "Converging",
        2: "Tracking",
        3: "Predicting",
        4: "Diverged",
        5: "InputInvalid",
        15: "NotAvailable",
    },
    "Reason": {
        0: "None",
        1: "Starting",
        2: "Stale",
        3: "Corrupted",
        4: "Sequence",
        5: "Range",
        6: "NotAvailable",
        7: "Diverged",
        8: "TooFewDrives",
        9: "Overrun",
        10: "Intruder",
        11: "Config",
        15: "SNA",
    },
    "Detector": {
        1: "VariationalBayes",
        2: "VariationalMessagePassing",
        3: "KMeans",
        4: "Median",
        5: "Switching",
    },
    "FaultClass": {
        0: "Unknown",
        1: "None",
        2: "Overheating",
        3: "CoolingLoss",
        4: "Bearing",
        5: "SensorBias",
        6: "SensorStuck",
        7: "SensorLost",
        8: "WindingResistance",
        15: "NotAvailable",
    },
    "FaultSensor": {
        0: "None",
        1: "Stator",
        2: "DriveEnd",
        3: "NonDriveEnd",
        4: "Ambient",
        5: "Current",
        15: "NotAvailable",
    },
    "Adhesion7": {0: "Unknown", 1: "Adhering", 2: "AdhesionLost", 3: "Invalid"},
    "Thermal16": {0: "Unknown", 1: "NoFault", 2: "Fault", 3: "Invalid"},
    "SensorFault": {0: "Unknown", 1: "NoFault", 2: "Fault", 3: "Invalid"},
    "CommFault": {0: "Unknown", 1: "NoFault", 2: "Fault", 3: "Invalid"},
    "EstimatorFault": {0: "Unknown", 1: "NoFault", 2: "Fault", 3: "Invalid"},
    "Overrun": {0: "Unknown", 1: "NoFault", 2: "Fault", 3: "Invalid"},
    "CommonMode": {0: "Unknown", 1: "NotDetected", 2: "AllDrives", 3: "Invalid"},
}
# (raw lowest, raw highest, not-available code or None)
RANGES = {
    "Ia": (-32766, 32766, 0x7FFF),
    "Ualpha": (-32766, 32766, 0x7FFF),
    "Udc": (0, 65534, 0xFFFF),
    "Speed": (-32000, 32000, 0x7FFF),
    "ElectricalAngle": (0, 35999, 0xFFFF),
    "Torque": (-32766, 32766, 0x7FFF),
    "Irms": (0, 65534, 0xFFFF),
    "FaultCode": (0, 0xFFE, 0xFFF),
    "Tstator": (0, 3600, 0xFFF),
    "Tmixed": (0, 3600, 0xFFF),
    "Maisd": (0, 0xFFE, 0xFFF),
    "Ia_0": (-8190, 8190, 0x1FFF),
    "Ubeta_7": (-8190, 8190, 0x1FFF),
    "SampleIndex": (0, 65528, None),
    "Nis": (0, 254, 0xFF),
    "LossProbability": (0, 200, 0xFF),
    "Jumps": (0, 14, 15),
    "DeadlineMisses": (0, 0xFFE, 0xFFF),
    "BusLoad": (0, 100, 0x7F),
    "Age": (0, 254, 0xFF),
    "Quality": (0, 2, 15),
    "Detector": (1, 5, None),
    "Adhesion1": (0, 2, None),
    "DegradationRate": (-32766, 32766, 0x7FFF),
    "ConfigHash": (0, 0xFFFFFF, None),
    "Freshness": (0, 0xFFFF, None),
    "Mac": (0, 0xFFFFFFFF, None),
}
STARTS = {
    "Quality": 0,
    "Health": 0,
    "Reason": 1,
    "FaultClass": 0,
    "DeadlineMisses": 0,
    "Ia": 0x7FFF,
}


@pytest.fixture(scope="module", params=FILES)
def codec(request: pytest.FixtureRequest) -> Codec:
    return bind(FOLDER / request.param, range(1, 17))


def expected_messages(fd: bool) -> dict[str, tuple[int, int, str]]:
    table = dict(TABLE)
    if fd:
        del table["Drive{n}_PhaseCurrents"], table["Drive{n}_StatorVoltages"]
        table["Drive{n}_Samples"] = SAMPLES
    found = {}
    for name, (can_id, cycle, signals) in table.items():
        if "{n}" in name:
            for n in range(1, 17):
                found[name.format(n=n)] = (can_id + n, cycle, signals)
        else:
            found[name] = (can_id, cycle, signals)
    return found


@pytest.mark.parametrize("name", FILES)
def test_committed_is_generated(name: str) -> None:
    text = (FOLDER / name).read_text(encoding="ascii")
    assert text == build.render(build.FILES[name])


def test_every_message_and_signal_of_the_contract(codec: Codec) -> None:
    wanted = expected_messages(codec.fd)
    assert set(codec.by_name) == set(wanted)
    for name, (can_id, cycle_ms, signals) in wanted.items():
        spec = codec.by_name[name]
        fd = name.endswith("Samples")
        assert (spec.can_id, spec.cycle_ns) == (can_id, cycle_ms * 1_000_000)
        assert (spec.is_fd, spec.brs, spec.length) == (fd, fd, 64 if fd else 8)
        assert not spec.is_extended
        assert spec.profile is (Profile.P05 if fd else Profile.P02)
        assert spec.data_ids == (can_id.to_bytes(2, "big") if fd else p02_data_ids(can_id))
        header = "Crc 0|16 1; Counter 16|8 1; " if fd else "Crc 0|8 1; Counter 8|4 1; "
        rows = [row.split() for row in (header + signals).split("; ")]
        assert [s.name for s in spec.signals] == [row[0] for row in rows]
        for s, row in zip(spec.signals, rows, strict=True):
            start, length, sign = re.fullmatch(r"(\d+)\|(\d+)(s?)", row[1]).groups()
            scale, _, offset = row[2].partition(",")
            assert (s.start, s.length, s.is_signed) == (int(start), int(length), bool(sign)), s
            assert (s.scale, s.offset) == (float(scale), float(offset or 0)), s
            assert s.unit == (row[3] if len(row) > 3 else ""), s
            assert not s.is_big_endian


def test_labels_ranges_and_start_values(codec: Codec) -> None:
    seen = set()
    for spec in codec.messages:
        for s in spec.signals:
            if s.name == "State":
                continue
            if s.name in ENUMS:
                assert dict(s.labels) == ENUMS[s.name]
                seen.add(s.name)
            elif s.not_available is not None:
                assert dict(s.labels) == {s.not_available: "NotAvailable"}
            if s.name in RANGES:
                assert (s.raw_min, s.raw_max, s.not_available) == RANGES[s.name], s
                seen.add(s.name)
            if s.name in STARTS:
                assert s.start_raw == STARTS[s.name]
            elif s.unit and s.name != "Crc":
                assert s.start_raw == s.not_available, f"{s.name} is measured"
            elif re.fullmatch(r"Adhesion\d+|Thermal\d+|.*Fault|Overrun|CommonMode", s.name):
                assert s.start_raw == 0
    absent = {"Ia", "Ualpha"} if codec.fd else {"Ia_0", "Ubeta_7", "SampleIndex"}
    assert seen == (set(ENUMS) | set(RANGES)) - absent


def test_states_of_gateway_and_drive(codec: Codec) -> None:
    gateway = {s.name: s for s in codec.by_name["Gateway_Status"].signals}["State"]
    drive = {s.name: s for s in codec.by_name["Drive5_Status"].signals}["State"]
    assert dict(gateway.labels) == {
        1: "Starting",
        2: "Running",
        3: "Degraded",
        4: "Silent",
        15: "NotAvailable",
    }
    assert dict(drive.labels) == {
        0: "Off",
        1: "Ready",
        2: "Operation",
        3: "Fault",
        15: "NotAvailable",
    }
    assert (gateway.start_raw, drive.start_raw) == (1, 0)


@pytest.mark.parametrize("name", FILES)
def test_attributes_comments_nodes(name: str) -> None:
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
        produced = sender == "Gateway" or message.name.endswith(("_Estimate", "_Thermal"))
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


def test_definitions_have_defaults_and_the_contracts_types() -> None:
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


@pytest.mark.parametrize(
    ("message", "signal", "enumeration"),
    [
        ("Gateway_Adhesion", "Reason", codes.Reason),
        ("Gateway_Faults", "Reason", codes.Reason),
        ("Drive1_Estimate", "Health", codes.Health),
        ("Drive1_Thermal", "FaultClass", codes.FaultClass),
        ("Drive1_Thermal", "FaultSensor", codes.FaultSensor),
        ("Gateway_Status", "State", codes.GatewayState),
    ],
)
def test_the_numbers_of_the_core_have_the_names_of_the_dbc(
    codec: Codec, message: str, signal: str, enumeration: type[IntEnum]
) -> None:
    (spec,) = (s for s in codec.by_name[message].signals if s.name == signal)
    labels = {raw: label for raw, label in spec.labels.items() if raw != spec.not_available}
    assert labels == {e.value: e.name.title().replace("_", "") for e in enumeration}


def test_data_ids_are_distinct_and_as_the_rule_says(codec: Codec) -> None:
    lists = [m.data_ids for m in codec.messages]
    assert len(set(lists)) == len(lists)
    can_id = 0x1A0
    base = (can_id ^ ((can_id >> 6) * 16)) & 0xFF
    assert p02_data_ids(can_id) == bytes(base ^ (2 * i) ^ (4 * i) for i in range(16))


def test_kinds_and_nodes(codec: Codec) -> None:
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
def test_specs_of_the_table_are_what_cantools_reads(name: str) -> None:
    specs, problems = binding.read(FOLDER / name)
    assert problems == []
    assert repr(build.recall((FOLDER / name).read_bytes())) == repr(specs)


def test_a_changed_file_is_read_anew(tmp_path: Path) -> None:
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


def test_a_copy_elsewhere_is_known_by_its_content(tmp_path: Path) -> None:
    copy = tmp_path / "other.dbc"
    copy.write_bytes((FOLDER / "traction.dbc").read_bytes())
    script = (
        "import sys; from pathlib import Path; from dbc.codec import bind; "
        f"bind(Path({str(copy)!r}), (1, 2)); print('cantools' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout == "False\n"


def test_the_check_of_what_is_generated_can_fail(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert build.main(["--check"]) == 0
    monkeypatch.setattr(build, "HERE", tmp_path)
    assert build.main(["--check"]) == 1
    assert "traction.dbc is not what" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
    assert build.main() == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == list(FILES)
    assert build.main(["--check"]) == 0
