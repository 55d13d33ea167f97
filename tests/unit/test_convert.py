"""`convert`: everything is read, every format gives back what it has room for."""

import csv
import gc
import gzip
import json
import time
from datetime import UTC, datetime
from pathlib import Path

import can
import numpy as np
import pyarrow.parquet as pq
import pytest
from asammdf import MDF

from dbc.candump.reader import Reader
from dbc.candump.writer import Writer
from dbc.codec import bind
from dbc.contract import ANY
from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, Frame
from dbc.frames import block_of
from dbc.load import load
from dbc.spec import Validity
from gateway import cli
from gateway.io import extras
from gateway.io.log_file import open_log
from gateway.logfiles.frames import ParquetFrames, ParquetReader
from gateway.logfiles.signals import Decoder

DBC = Path(__file__).parents[2] / "dbc" / "traction.dbc"
T0 = 1_700_000_000_123_456_000
MESSAGES = [
    can.Message(1_700_000_000.25, 0x181, is_extended_id=False, data=bytes(range(8)), channel=0),
    can.Message(1_700_000_000.50, 0x18FEF100, is_extended_id=True, data=b"\1\2", channel=0),
    can.Message(1_700_000_000.75, 0x182, is_extended_id=False, data=b"", channel=0),
]
KINDS = [
    Frame(T0, 0x181, bytes(range(8)), 0, "can0"),
    Frame(T0 + 1_000_000, 0x18FEF100, b"\1\2", EXTENDED, "can1"),
    Frame(T0 + 2_345_000, 0x182, b"", REMOTE, "can0", 4),
    Frame(T0 + 2_345_000, 0x183, bytes(range(64)), FD | BRS | ESI, "can0"),
    Frame(T0 + 5_001_000, 0x184, b"\5" * 12, FD, "can1"),
    Frame(T0 + 9_000_000, 0x4, bytes(8), ERROR, "can0"),
    Frame(T0 + 9_999_000, 0x7FF, b"", 0, "can0"),
]


def run(*words):
    return cli.main(["convert", *map(str, words)])


def log_of(path, frames):
    with Writer(path) as writer:
        for frame in frames:
            writer.write(frame)
    return path


def parquet_of(path, frames):
    """In two blocks."""
    sink = ParquetFrames(path)
    sink.add(block_of(frames[:3]))
    sink.add(block_of(frames[3:]))
    sink.close()
    return path


READ = [".asc", ".blf", ".csv", ".db", ".log", ".mf4", ".trc"]


@pytest.mark.parametrize(
    ("suffix", "zipped"), [(s, z) for s in READ for z in (False, True) if (s, z) != (".db", True)]
)
def test_all_that_python_can_reads(tmp_path, suffix, zipped):
    source = tmp_path / f"IN{suffix.upper()}"
    with can.Logger(source) as logger:
        for message in MESSAGES:
            logger(message)
    if zipped:
        plain, source = source, source.with_name(source.name + ".gz")
        with gzip.open(source, "wb") as target:
            target.write(plain.read_bytes())
    out = tmp_path / "out.log"
    assert run(source, out) == 0
    frames = list(Reader(out))
    assert [(f.can_id, f.data, f.flags) for f in frames] == [
        (m.arbitration_id, bytes(m.data), EXTENDED if m.is_extended_id else 0) for m in MESSAGES
    ]
    steps = np.diff([f.t_ns for f in frames])
    assert np.abs(steps - 250_000_000).max() <= 1_000_000


# Ending -> flags of frames it has no room for, largest error of time in ns, whether the first
# time is kept, and whether channels are. The table in docs/files.md.
ROOM = {
    ".log": (0, 0, True, True), ".log.gz": (0, 0, True, True), ".parquet": (0, 0, True, True),
    ".mf4": (0, 0, True, True), ".blf": (0, 0, True, True), ".asc": (0, 500, False, True),
    ".trc": (0, 500, True, True), ".csv": (FD, 0, True, False),
}  # fmt: skip


@pytest.mark.parametrize("kind", ROOM)
def test_frames_there_and_back(tmp_path, kind, capsys):
    no_room, error_ns, absolute, channels = ROOM[kind]
    source = log_of(tmp_path / "in.log", KINDS)
    there, back = tmp_path / f"there{kind}", tmp_path / "back.log"
    assert run(source, there, "--frames") == 0
    kept = [f for f in KINDS if not f.flags & no_room]
    if kind == ".mf4":
        # Of one time: data, error and remote frames are in groups of their own.
        kept.sort(key=lambda f: (f.t_ns, f.flags & ERROR, f.flags & REMOTE))
    said = capsys.readouterr().out
    assert f"frames: read {len(KINDS)}, written {len(kept)}\n" in said
    assert ("not written" in said) == (len(kept) < len(KINDS))
    assert run(there, back) == 0
    frames = list(Reader(back))
    data = [f.data if not f.flags & ERROR else b"" for f in frames]
    assert data == [f.data if not f.flags & ERROR else b"" for f in kept]
    # ASC and TRC say of an error frame only that there was one.
    some = kind in (".asc", ".trc")
    ids = [0x4 if some and f.flags & ERROR else f.can_id for f in frames]
    assert ids == [f.can_id for f in kept]
    assert [f.flags & ~EXTENDED if f.flags & ERROR else f.flags for f in frames] == [
        f.flags for f in kept
    ]
    assert [f.dlc for f in frames] == [f.dlc for f in kept]
    if channels:
        assert [f.channel for f in frames] == [f.channel for f in kept]
    start = 0 if absolute else kept[0].t_ns
    errors = [f.t_ns - (g.t_ns - start) for f, g in zip(frames, kept, strict=True)]
    assert np.abs(errors).max() <= error_ns


def test_parquet_frames_are_exact_to_the_nanosecond(tmp_path):
    frames = [f._replace(t_ns=f.t_ns + k) for k, f in enumerate(KINDS)]
    frames.append(Frame(-7, 0x1FFF_FFFF, b"\xff", EXTENDED, "a name"))
    frames.append(Frame(2**62, 1, b"\1" * 8, 0, "", 15))
    assert list(ParquetReader(parquet_of(tmp_path / "x.parquet", frames)).frames()) == frames


# ---- signals -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def expected():
    """Frames with random bits, and what cantools says of each signal that is valid."""
    rng = np.random.default_rng(5)
    codec, database = bind(DBC, (), ANY), load(DBC)
    names = ["Drive1_Motion", "Drive2_Motion", "Drive1_Status", "Gateway_Adhesion"]
    frames, values = [], {}
    for k in range(400):
        spec = codec.by_name[names[k % len(names)]]
        data = rng.bytes(8)
        t_ns = T0 + k * 1_234_567
        frames.append(Frame(t_ns, spec.can_id, data, 0, "can0"))
        read = database.decode_message(spec.can_id, data, decode_choices=False)
        sure = codec.decode(spec, data)
        for name, value in read.items():
            if sure[name].validity in (Validity.VALID, Validity.RANGE, Validity.SATURATED):
                values.setdefault(f"{spec.name}.{name}", []).append((t_ns, float(value)))
    assert sum(map(len, values.values())) > 1000
    return frames, values


@pytest.fixture
def source(tmp_path, expected):
    # Nanoseconds, which candump has not: Parquet of frames.
    return parquet_of(tmp_path / "frames.parquet", expected[0])


def check(found, wanted):
    assert sorted(found) == sorted(wanted)
    for name, pairs in wanted.items():
        assert [t for t, _ in found[name]] == [t for t, _ in pairs], name
        assert np.allclose(
            [v for _, v in found[name]], [v for _, v in pairs], rtol=1e-12, atol=1e-9
        ), name


def test_signals_in_parquet(tmp_path, source, expected):
    out = tmp_path / "out.parquet"
    assert run(source, out) == 0
    table = pq.read_table(out)
    assert table.column_names[:3] == ["time", "channel", "message"]
    times = table["time"].cast("int64").to_pylist()
    assert table["message"].to_pylist()[:2] == ["Drive1_Motion", "Drive2_Motion"]
    assert set(table["channel"].to_pylist()) == {"can0"}
    found = {}
    assert table.column_names[-1] == "out_of_range"
    for name in table.column_names[3:-1]:
        pairs = zip(times, table[name].to_pylist(), strict=True)
        found[name] = [(t, v) for t, v in pairs if v is not None]
    check(found, expected[1])
    field = table.schema.field("Drive1_Motion.Speed")
    assert field.metadata[b"unit"] == b"rpm"
    assert field.metadata[b"comment"] == b"Mechanical speed of the shaft."
    assert b'"3": "Fault"' in table.schema.field("Drive1_Status.State").metadata[b"labels"]


@pytest.mark.parametrize("ending", [".csv", ".csv.gz"])
def test_signals_in_csv(tmp_path, source, expected, ending):
    out = tmp_path / f"out{ending}"
    assert run(source, out) == 0
    data = out.read_bytes()
    text = (gzip.decompress(data) if ending.endswith("gz") else data).decode()
    rows = list(csv.DictReader(text.splitlines()))
    assert "Drive1_Motion.Speed [rpm]" in rows[0]
    found = {}
    for row in rows:
        t_ns = int(row.pop("t_s").replace(".", ""))
        assert row.pop("channel") == "can0"
        message = row.pop("message")
        row.pop("out_of_range")
        for name, text in row.items():
            if text:
                assert name.startswith(f"{message}.")
                found.setdefault(name.split(" ")[0], []).append((t_ns, float(text)))
    check(found, expected[1])


def test_signals_in_mcap(tmp_path, source, expected):
    from mcap.reader import make_reader

    out = tmp_path / "out.mcap"
    assert run(source, out) == 0
    found = {}
    with out.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            _, bus, name = channel.topic.split("/")
            for key, value in json.loads(message.data).items():
                if bus == "can0" and key not in ("labels", "out_of_range"):
                    found.setdefault(f"{name}.{key}", []).append((message.log_time, value))
    check(found, expected[1])


def test_signals_in_mf4(tmp_path, source, expected):
    out = tmp_path / "out.mf4"
    assert run(source, out) == 0
    found = {}
    with MDF(out) as mdf:
        assert mdf.header.start_time == datetime.fromtimestamp(T0 // 10**9, UTC)
        base = T0 // 10**9 * 10**9
        for name in mdf.channels_db:
            if name == "time" or name.startswith("can0."):  # asammdf's other names
                continue
            signal = mdf.get(name, raw=True)
            times = base + np.round(signal.timestamps * 1e9).astype(np.int64)
            found[name] = list(zip(times.tolist(), signal.samples.tolist(), strict=True))
        speed, state = mdf.get("Drive1_Motion.Speed"), mdf.get("Drive1_Status.State")
        assert (speed.unit, speed.comment) == ("rpm", "Mechanical speed of the shaft.")
        assert speed.source.name == "can0"
        assert b"Operation" in set(state.samples.tolist())
        assert mdf.get("Drive1_Status.FaultCode").samples.dtype == np.float64
        groups = [g.channel_group.acq_name for g in mdf.groups]
    assert sorted(groups) == sorted({name.split(".")[0] for name in expected[1]})
    check(found, expected[1])


def test_decoder_takes_what_the_codec_takes():
    codec = bind(DBC, (), ANY)
    one = codec.by_name["Drive1_Motion"].can_id
    frames = [
        Frame(0, one, bytes(8)), Frame(0, one, bytes(7)), Frame(0, one, bytes(8), FD),
        Frame(0, one, b"", REMOTE), Frame(0, one, bytes(8), ERROR),
        Frame(0, one, bytes(8), EXTENDED), Frame(0, 0x7FF, bytes(8)), Frame(0, 0, b""),
    ]  # fmt: skip
    decoder = Decoder(codec)
    index = decoder.match(block_of(frames))
    matches = [codec.match(frame) for frame in frames]
    assert index.tolist() == [spec.index if spec and not how else -1 for how, spec in matches]
    assert decoder.counts == {how: [m[0] for m in matches].count(how) for how, _ in matches}


def test_fd_by_its_own_dbc(tmp_path, capsys):
    dbc = DBC.with_name("traction_fd.dbc")
    spec = bind(dbc, (), ANY).by_name["Drive1_Samples"]
    log = log_of(tmp_path / "fd.log", [Frame(0, spec.can_id, bytes(64), FD | BRS, "can0")])
    out = tmp_path / "out.csv"
    assert run(log, out) == 2
    assert "wrong_format 1" in capsys.readouterr().err
    assert run(log, out, "--dbc", dbc) == 0
    assert "Drive1_Samples.Ia_7 [A]" in out.read_text().splitlines()[0]


# ---- what goes wrong ---------------------------------------------------------------------------


def test_time_that_goes_back(tmp_path, capsys):
    frames = [Frame(T0 + d * 1000, 0x381, bytes(8), 0, "can0") for d in (5, 9, 7, 3, 9, 10)]
    log = log_of(tmp_path / "in.log", frames)
    for kind, left in ((".mf4", "time_back 2"), (".asc", "before_the_first 1")):
        assert run(log, tmp_path / f"out{kind}") == 1
        said = capsys.readouterr()
        assert f"not written: {left}\n" in said.out
        assert f"of the input was dropped, which is more than 1%: {left}" in said.err
    with MDF(tmp_path / "out.mf4") as mdf:
        assert len(mdf.get("Drive1_Motion.Counter").timestamps) == 4
    assert run(log, tmp_path / "out.parquet") == 0
    times = pq.read_table(tmp_path / "out.parquet")["time"].cast("int64").to_pylist()
    assert times == [f.t_ns for f in frames]


@pytest.mark.parametrize("kind", [".mf4", ".asc", ".blf", ".trc"])
def test_one_wrong_stamp_and_a_clock_that_is_set_back_cost_next_to_nothing(kind, tmp_path, capsys):
    """In formats that know no time that goes back; what comes after is what came before."""
    stamps = [T0 + k * 10_000_000 for k in range(2000)]
    stamps[300] += 6_000_000_000
    stamps[1000:] = [t_ns - 3600_000_000_000 for t_ns in stamps[1000:]]
    log = log_of(tmp_path / "in.log", [Frame(t, 0x381, bytes(8), 0, "can0") for t in stamps])
    out = tmp_path / f"out{kind}"
    assert run(log, out, "--frames") == 0
    said = capsys.readouterr().out
    assert "not written: time_back 1\n" in said
    assert "the log's clock was set back 1 times" in said
    times = [frame.t_ns for block in open_log(out, strict=False).blocks for frame in block.frames()]
    assert len(times) == 1999
    steps = np.diff(times)
    assert (steps > 9_000_000).all()
    # One for the frame that is missing, one for the hole where the clock was set.
    assert np.flatnonzero(steps > 11_000_000).tolist() == [299, 998]


def test_asc_and_trc_are_the_same_bytes_wherever_and_whenever(tmp_path, monkeypatch):
    log = log_of(tmp_path / "in.log", KINDS)
    for kind in (".asc", ".trc", ".blf"):
        made = []
        for zone in ("UTC", "Asia/Shanghai"):
            monkeypatch.setenv("TZ", zone)
            time.tzset()
            assert run(log, tmp_path / f"out{kind}", "--frames") == 0
            made.append((tmp_path / f"out{kind}").read_bytes())
        assert made[0] == made[1]
    monkeypatch.undo()
    time.tzset()
    text = (tmp_path / "out.asc").read_text()
    assert text.startswith("date Tue Nov 14 22:13:20.123 2023\n")
    assert "Begin Triggerblock Tue Nov 14 22:13:20.123 2023\n" in text


@pytest.mark.parametrize("kind", [".asc", ".blf", ".csv", ".trc"])
def test_what_is_written_python_can_reads(tmp_path, kind):
    no_room, error_ns, absolute, _ = ROOM[kind]
    plain = [f for f in KINDS if not f.flags & (no_room | ERROR)]
    out = tmp_path / f"out{kind}"
    assert run(log_of(tmp_path / "in.log", plain), out, "--frames") == 0
    with can.LogReader(out) as reader:
        messages = list(reader)
    assert [(m.arbitration_id, bytes(m.data), m.is_fd, m.is_remote_frame) for m in messages] == [
        (f.can_id, f.data, bool(f.flags & FD), bool(f.flags & REMOTE)) for f in plain
    ]
    start = 0 if absolute else plain[0].t_ns
    errors = [m.timestamp * 1e9 - (f.t_ns - start) for m, f in zip(messages, plain, strict=True)]
    assert np.abs(errors).max() <= error_ns + 1000


def test_one_channel(tmp_path):
    log = log_of(tmp_path / "in.log", KINDS)
    out = tmp_path / "out.log"
    assert run(log, out, "--log-channel", "can1") == 0
    assert list(Reader(out)) == [f for f in KINDS if f.channel == "can1"]


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """Logs of every kind that is refused, and some that are good."""
    folder = tmp_path_factory.mktemp("refused")
    good = Frame(T0, 0x381, bytes(8), 0, "can0")
    whole = log_of(folder / "in.log", [good, good])
    log_of(folder / "foreign.log", [good._replace(can_id=0x7FE)])
    (folder / "bad.log").write_bytes(whole.read_bytes()[:-1].replace(b"\n", b"\nx\n"))
    for junk in ("junk.parquet", "junk.mf4", "junk.blf", "in.db.gz"):
        (folder / junk).write_bytes(gzip.compress(b"junk"))
    assert run(whole, folder / "signals.parquet") == 0
    gc.freeze()  # so that to collect what a test leaves takes no half a second
    return folder


# python-can's and asammdf's readers leave a file open when they refuse it.
@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(
    ("log", "out", "words", "said"),
    [
        ("in.log", "in.log", [], "is the file of `log` too"),
        ("in.log", "out.xyz", [], "cannot write a file with the ending"),
        ("in.log", "out", [], "(none)"),
        ("in.log", "folder.csv", [], "is a folder"),
        ("none.log", "out.csv", [], "no such file"),
        ("none.parquet", "out.csv", [], "no such file"),
        ("in.log", "out.csv", ["--log-channel", "can9"], "no channel can9 in the log; it has"),
        ("in.log", "out.csv", ["--dbc", "none.dbc"], "no such file"),
        ("foreign.log", "out.mf4", [], "none of 1 frames could be written by traction.dbc"),
        ("foreign.log", "out.parquet", [], "unknown_id 1"),
        ("in.log", "out.csv.gz", ["--frames"], "no frames in .csv.gz"),
        ("signals.parquet", "out.log", [], "holds no frames"),
        ("in.log", "signals.parquet/out.log", [], "File exists"),
        ("junk.parquet", "out.log", [], "cannot be read"),
        ("junk.mf4", "out.log", [], "cannot be read"),
        ("junk.blf", "out.log", [], "cannot be read"),
        ("in.db.gz", "out.log", [], "cannot be read: No read support for unknown log format"),
        ("bad.log", "out.csv", ["--strict"], "bad.log:2: "),
    ],
)
def test_what_is_refused(inputs, monkeypatch, capsys, log, out, words, said):
    monkeypatch.chdir(inputs)
    before = {p.name: p.read_bytes() for p in Path().iterdir()}
    Path("folder.csv").mkdir()
    capsys.readouterr()
    assert run(log, out, *words) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert said in lines[0]
    Path("folder.csv").rmdir()
    assert {p.name: p.read_bytes() for p in Path().iterdir()} == before
    gc.collect()  # a file that was left open is closed here, where that is no error


@pytest.mark.parametrize(
    ("ending", "library"), [(".parquet", "pyarrow"), (".mf4", "asammdf"), (".mcap", "mcap")]
)
def test_a_library_that_is_not_there(
    tmp_path, monkeypatch, capsys,
    ending, library,
):  # fmt: skip
    monkeypatch.setattr(extras, "find_spec", lambda _name: None)
    log = log_of(tmp_path / "in.log", KINDS)
    for words in ((log, tmp_path / f"out{ending}"), (tmp_path / f"in{ending}", "out.log")):
        assert run(*words) == 2
        assert f"needs {library}: pip install '{library}>=" in capsys.readouterr().err


def test_faulty_lines_are_counted(tmp_path, capsys):
    log = tmp_path / "in.log"
    log.write_text("(1.000000) can0 381#0000000000000000\nrubbish\n(2.000000) can0 381#00\n")
    assert run(log, tmp_path / "out.csv") == 1  # it is there, but a third of the log is not in it
    said = capsys.readouterr()
    assert "33.3 % of the input was dropped" in said.err
    assert "ok 2" in said.out
    assert "not written: wrong_length 1" in said.out
    assert "line 2:" in said.err
    assert len((tmp_path / "out.csv").read_text().splitlines()) == 2


def test_a_blf_that_was_cut(tmp_path, capsys):
    path, out = tmp_path / "in.blf", tmp_path / "out.log"
    with can.BLFWriter(path, max_container_size=4096) as logger:
        for k in range(1000):
            logger.on_message_received(can.Message(1.0 + k, 0x181, is_extended_id=False))
    assert run(path, out) == 0
    path.write_bytes(path.read_bytes()[:-3000])
    assert run(path, out) == 2
    assert "ends early after" in capsys.readouterr().err
    assert 0 < len(list(Reader(out))) < 1000
    out.unlink()
    assert run(path, out, "--strict") == 2
    assert list(tmp_path.iterdir()) == [path]


def test_any_number_of_channels_keeps_the_order_of_its_frames(tmp_path):
    log = tmp_path / "many.log"
    log.write_text("".join(f"({k}.000000) can{k} 123#{k % 256:02X}\n" for k in range(1500)))
    assert cli.main(["convert", str(log), str(tmp_path / "many.asc")]) == 0
    lines = [line.split() for line in (tmp_path / "many.asc").read_text().splitlines()]
    rows = [line for line in lines if line[2:3] == ["123"]]
    assert [(float(row[0]), int(row[1]), row[-1]) for row in rows] == [
        (float(k), k + 1, f"{k % 256:02X}") for k in range(1500)
    ]
