"""MCAP, read with the library's own reader: frames, signals, flags and events, in order."""

import csv
import json

import pytest
from mcap.reader import make_reader

from dbc.candump.writer import Writer
from dbc.codec import bind
from dbc.contract import ANY
from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, TX, Frame
from dbc.frames import block_of
from gateway.cli import main
from gateway.logfiles.mcap import McapFile
from gateway.logfiles.signals import Decoder

FLAGS = {"extended": EXTENDED, "remote": REMOTE, "error": ERROR, "fd": FD, "brs": BRS, "esi": ESI,
         "tx": TX}  # fmt: skip
DBC = """
BU_: A
BO_ 256 Odd: 8 A
 SG_ labels : 0|8@1+ (1,0) [0|10] "" A
 SG_ Wide : 8|56@1+ (1,0) [0|0] "" A
BO_ 257 Named: 2 A
 SG_ State : 0|8@1+ (1,0) [0|3] "" A
 SG_ Speed : 8|8@1+ (0.1,0) [0|20] "rpm" A
CM_ SG_ 257 Speed "of the shaft";
VAL_ 257 State 0 "Off" 1 "On" ;
"""


def messages(path):
    """(topic, time, content) in the order of the file, and the properties of each topic."""
    with path.open("rb") as file:
        found = list(make_reader(file).iter_messages(log_time_order=False))
    properties = {c.topic: json.loads(schema.data)["properties"] for schema, c, _ in found}
    return [(c.topic, m.log_time, json.loads(m.data)) for _, c, m in found], properties


def frame_of(t_ns, content):
    data = bytes.fromhex(content["data"])
    flags = sum(flag for name, flag in FLAGS.items() if content[name])
    assert int(content["id_hex"], 16) == content["id"]
    dlc = content.get("dlc", -1)
    return Frame(t_ns, content["id"], data, flags, content["channel"], dlc)


def test_every_frame_comes_back_in_the_order_of_times(tmp_path):
    kinds = [
        Frame(3, 0x181, bytes(range(8)), TX, "can1"), Frame(1, 0x1FFF_FFFF, b"\1", EXTENDED, "a/b"),
        Frame(2**62, 0x183, bytes(64), FD | BRS | ESI, "can0"), Frame(9, 4, b"", ERROR, "can0"),
        Frame(5, 0x182, b"", REMOTE, "can0", 4), Frame(6, 0x187, bytes(8), 0, 'x"\x9b', 15),
    ]  # fmt: skip
    with McapFile(tmp_path / "x.mcap") as file:
        file.add(block_of([Frame(-1, 0x181, b"", 0, "can0")]))
        file.add(block_of(kinds))
        file.put([(-1, 1, "{}")])  # a tick's
    rows, _ = messages(tmp_path / "x.mcap")
    assert {topic for topic, *_ in rows} == {"/can/frames"}
    assert [frame_of(t_ns, row) for _, t_ns, row in rows] == sorted(kinds)
    assert (file.written, file.left_out) == (len(kinds), {"before_1970": 2})


def test_numbers_names_and_marks_of_signals(tmp_path):
    (tmp_path / "x.dbc").write_text(DBC)
    decoder = Decoder(bind(tmp_path / "x.dbc", (), ANY))
    rows = [(256, b"\7" + b"\xff" * 7), (257, bytes([1, 100])), (257, bytes([7, 0])), (9, b"")]
    with McapFile(tmp_path / "x.mcap", decoder, {"Named.Speed": "of the shaft"}) as file:
        file.add(block_of([Frame(k, a, data, 0, "7") for k, (a, data) in enumerate(rows)]))
    found, properties = messages(tmp_path / "x.mcap")
    assert [row for row in found if row[0] != "/can/frames"] == [
        ("/can7/Odd", 0, {"labels": 7, "Wide": 2**56 - 1}),
        ("/can7/Named", 1, {"State": 1, "Speed": 10, "labels": {"State": "On"}}),
        ("/can7/Named", 2, {"State": 7, "Speed": 0, "out_of_range": "State"}),
    ]
    assert properties["/can7/Named"]["Speed"]["description"] == "rpm; of the shaft"
    assert file.reduced == {"signals": 1}
    for topic, _, content in found:
        assert content.keys() <= properties[topic].keys()


@pytest.fixture(scope="module")
def replayed(tmp_path_factory):
    """A log whose clock was set back by an hour, replayed; the folder of results."""
    folder = tmp_path_factory.mktemp("mcap")
    assert main(["sim", "wet_one", "-o", str(folder / "a.log"), "--duration", "4"]) == 0
    lines = (folder / "a.log").read_text().splitlines(keepends=True)
    later = [f"({float(line[1:18]) + 3600:.6f}{line[line.index(')') :]}" for line in lines[:-2000]]
    (folder / "b.log").write_text("".join(later + lines[-2000:]))
    for name in ("one", "two"):
        words = ["--results", str(folder / name), "--mcap"]
        assert main(["replay", str(folder / "b.log"), *words]) == 0
    return folder


def test_the_same_log_gives_the_same_bytes(replayed):
    assert (replayed / "one/replay.mcap").read_bytes() == (
        replayed / "two/replay.mcap"
    ).read_bytes()


def test_a_replay_has_frames_flags_and_events_in_order(replayed):
    rows, properties = messages(replayed / "one" / "replay.mcap")
    times = [t_ns for _, t_ns, _ in rows]
    assert times == sorted(times)
    assert sum(topic == "/can/frames" for topic, *_ in rows) == len(
        (replayed / "b.log").read_text().splitlines()
    )
    for table, topic in (("flags", "/flags"), ("estimates", "/estimates")):
        with (replayed / "one" / f"{table}.csv").open() as file:
            wanted = list(csv.DictReader(file))
        found = [(f"{t_ns // 10**9}.{t_ns % 10**9:09d}", name[len(topic) + 6 :], row)
                 for name, t_ns, row in rows if name.startswith(f"{topic}/drive")]  # fmt: skip
        assert [row[:2] for row in found] == [(row["t_s"], row["drive"]) for row in wanted]
        for (_, _, row), cells in zip(found, wanted, strict=True):
            for name, cell in list(cells.items())[2:]:
                value = row.get(f"{name}_name", row.get(name))
                same = value == cell if isinstance(value, str) else cell == "" and value is None
                assert same or float(cell) == pytest.approx(value, abs=1e-2), name
    events = [row for topic, _, row in rows if topic == "/events"]
    lost = [row for row in events if row["message"] == "drive 2: adhesion AdhesionLost"]
    assert lost
    assert {row["level"] for row in lost} == {4}
    assert {len(row) for row in events} == {len(properties["/events"])}


KINDS = {"number": (int, float), "integer": int, "string": str, "boolean": bool, "object": dict}


def test_values_are_of_the_types_in_the_schema(replayed):
    rows, properties = messages(replayed / "one" / "replay.mcap")
    assert {topic.split("/")[1] for topic in properties} == {
        "can", "events", "estimates", "flags", "vcan0"
    }  # fmt: skip
    for topic, _, content in rows:
        for name, value in content.items():
            kind = properties[topic][name]["type"]
            assert isinstance(value, KINDS[kind]), (topic, name)
            assert isinstance(value, bool) == (kind == "boolean"), (topic, name)


def test_the_layout_names_what_is_there(replayed):
    _, properties = messages(replayed / "one" / "replay.mcap")
    layout = json.loads((replayed / "one" / "foxglove.json").read_text())
    panels = layout["configById"].values()
    paths = [path["value"] for panel in panels for path in panel.get("paths", [])]
    assert len(paths) == 5 * 3
    for topic, _, field in (path.partition(".") for path in paths):
        assert field in properties[topic]
    assert {p.get("topicPath", p.get("topicToRender")) for p in panels} - {None} < set(properties)


def test_mcap_without_results_is_refused(tmp_path, refused):
    with Writer(tmp_path / "x.log") as writer:
        writer.write(Frame(10**9, 0x181, b"", 0, "can0"))
    assert "--mcap: is for the report; add --results DIR" in refused(
        "replay", tmp_path / "x.log", "--mcap"
    )
