"""`traction-gateway shrink`: from a long log to a few frames after which a flag is the same."""

import json
import re
from functools import reduce
from hashlib import sha256
from importlib.util import module_from_spec, spec_from_file_location
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import gateway
from bench.real_wheels import RATED_A
from bench.shrink_recordings import temperatures, wheels
from dbc.candump.reader import Reader
from dbc.candump.writer import Writer
from dbc.codec import bind
from dbc.frames import join
from gateway.cli import main
from gateway.core.flags import FlagKind
from gateway.core.gateway import Gateway
from gateway.core.start_record import resumed, start_bytes, state_of
from gateway.io.log_file import BadLogError
from gateway.io.prepare import prepare
from gateway.io.replay import replay
from gateway.logfiles import shrunk_files
from gateway.logfiles.ddmin import minimise
from gateway.logfiles.shrink import Wanted, shrink
from gateway.settings.config import ConfigError, parse
from sim.simulation import Simulation
from tests import simrun
from tests.golden.test_golden import CASES
from tests.inverters import spoken
from tests.storm.campaign import config_of
from tests.storm.logged import write_storm

GOLDEN = Path(__file__).parents[1] / "golden"
LOSS = GOLDEN / "loss.log.gz"
INVERTERS = Path(__file__).parents[2] / "examples" / "inverters"
TICK_NS = 10_000_000


def shrunk(tmp_path, flag, *more, log=LOSS):
    """What the command leaves, and its exit code."""
    folder = tmp_path / "shrunk"
    return folder, main(["shrink", str(log), "--flag", flag, "-o", str(folder), *more])


def written_test(folder):
    """The function of the file that pytest would run."""
    spec = spec_from_file_location("shrunk", folder / shrunk_files.TEST)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return next(value for name, value in vars(module).items() if name.startswith("test_"))


def flags_sent(folder, can_id, log=shrunk_files.LOG):
    run = gateway.replay(folder / log, start=folder / shrunk_files.START)
    return [(f.t_ns, f.data) for f in run.frames if f.can_id == can_id]


@pytest.mark.parametrize("flag", ["adhesion:2@0.8", "adhesion:3@1.62", "adhesion:2@1.27"])
def test_the_written_test_passes_with_few_frames_and_the_bytes_of_the_whole_log(
    tmp_path, capsys, flag
):
    folder, code = shrunk(tmp_path, flag)
    assert code == 0, capsys.readouterr()
    written_test(folder)()
    whole = {(f.t_ns, f.data) for f in gateway.replay(LOSS).frames}
    assert flags_sent(folder, 0x1A0)[-1] in whole
    frames = (folder / shrunk_files.LOG).read_text().splitlines()
    # 2.4 s of log, of which detection and debounce alone are a part.
    assert 20 < len(frames) < 0.02 * 8121
    assert f"frames: {len(frames)} of 8,121" in capsys.readouterr().out


def test_no_frame_is_left_without_which_the_flag_would_be_the_same(tmp_path):
    folder, _ = shrunk(tmp_path, "adhesion:2@0.8", "--before", "0.02")
    frames = (folder / shrunk_files.LOG).read_text().splitlines(keepends=True)
    right = flags_sent(folder, 0x1A0)[-1]
    for k in range(0, len(frames), 5):
        (folder / "less.log").write_text("".join(frames[:k] + frames[k + 1 :]))
        run = gateway.replay(folder / "less.log", start=folder / shrunk_files.START)
        states = [change for change in run.events.to_pylist() if change["drive"] == 2]
        same_tick = [c["t_s"] for c in states if c["state"] == "AdhesionLost"]
        sent = [(f.t_ns, f.data) for f in run.frames if f.can_id == 0x1A0]
        assert sent[-1:] != [right] or same_tick != [right[0] / 1e9] or len(states) != 2, k


def test_a_test_that_is_given_another_log_fails(tmp_path):
    folder, _ = shrunk(tmp_path, "adhesion:2@0.8")
    path = folder / shrunk_files.LOG
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:-12]))
    with pytest.raises(AssertionError):
        written_test(folder)()


def test_a_configuration_is_named_from_the_folder_of_the_test(tmp_path):
    config = tmp_path / "train.toml"
    config.write_text('[[drive]]\nnode = 1\n[[drive]]\nnode = 2\n[dbc]\nfile = "traction_fd.dbc"\n')
    log = GOLDEN / "fd.log.gz"
    folder, code = shrunk(tmp_path, "adhesion:2@0.82", "--config", str(config), log=log)
    assert code == 0
    written_test(folder)()
    assert "../train.toml" in (folder / shrunk_files.TEST).read_text()


def test_stamps_finer_than_those_of_candump_stay_in_their_tick(tmp_path):
    """The ticks begin 500 ns behind a whole microsecond, some frames just behind these."""
    log = tmp_path / "fine.asc"
    assert main(["convert", str(LOSS), str(log)]) == 0
    digits = count(500, 37)
    fine = re.sub(r"^ *(\d+\.\d{6}) (?=\d)", lambda m: f"{m[1]}{next(digits) % 1000:03d} ",
                  log.read_text(), flags=re.M)  # fmt: skip
    log.write_text(fine)
    folder, code = shrunk(tmp_path, "adhesion:2@0.81", log=log)
    assert code == 0
    written_test(folder)()


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "changes"), [
    (3, 2), *(pytest.param(seed, 5, marks=pytest.mark.thorough) for seed in (1001, 2000)),
])  # fmt: skip
def test_changes_in_a_storm_are_shrunk_to_the_same_bytes(tmp_path, seed, changes):
    """Classic CAN, CAN FD, wrong values; several kinds of filter and detector."""
    log = tmp_path / "storm.log"
    write_storm(log, seed, 1500)
    config = config_of(seed)
    codec = bind(config.dbc_path, config.nodes)
    run = gateway.replay(log, config)
    first_s = run.events["t_s"][0].as_py()
    whole = {(f.t_ns, f.can_id, f.data) for f in run.frames}
    later = [row for row in run.events.to_pylist() if row["t_s"] > first_s]
    assert len(later) > 10
    for row in later[:: len(later) // changes]:
        wanted = Wanted(FlagKind[row["flag"].upper()], row["drive"], row["t_s"] - first_s)
        left = shrink(log, config, codec, wanted, 50_000_000)
        assert left.flag_frame[:3] in whole
        assert left.word == row["state"]
        assert left.frames.size < 0.02 * left.total
        shrunk_files.write_test(tmp_path / "out", left, wanted, None, log)
        shrunk_files.read_back(tmp_path / "out", left, config, codec)


@pytest.mark.parametrize(("name", "state"), [
    ("green_table_exp30", "AdhesionLost"), ("F6", "Fault"),
])  # fmt: skip
def test_what_others_recorded_is_shrunk_to_the_same_bytes(tmp_path, name, state):
    """A robot's wheels that come to another floor, a half-bridge that is too hot."""
    case = temperatures(name, tmp_path) if state == "Fault" else wheels(name, RATED_A, tmp_path)
    codec = bind(case.config.dbc_path, case.config.nodes)
    run = gateway.replay(case.path, case.config)
    events = run.events.to_pylist()
    row = next(row for row in events if row["state"] == state)
    kind = FlagKind[row["flag"].upper()]
    wanted = Wanted(kind, row["drive"], row["t_s"] - events[0]["t_s"])
    left = shrink(case.path, case.config, codec, wanted, 50_000_000)
    assert left.flag_frame[:3] in {(f.t_ns, f.can_id, f.data) for f in run.frames}
    assert (left.word, left.frames.size < 0.02 * left.total) == (state, True)
    shrunk_files.write_test(tmp_path / "out", left, wanted, None, case.path)
    shrunk_files.read_back(tmp_path / "out", left, case.config, codec)


def prepared(case):
    dbc, nodes, detector = CASES[case]
    config = parse({
        "dbc": {"file": dbc}, "drive": [{"node": n} for n in nodes],
        "adhesion": {"detector": detector},
    })  # fmt: skip
    log = GOLDEN / f"{case.removesuffix(f'_{detector}')}.log.gz"
    return config, bind(config.dbc_path, nodes), reduce(join, Reader(log).blocks())


def sent_by(config, codec, frames, back=None):
    """Every frame that is sent, and the gateway, after all of these."""
    out = []
    done = replay(
        [frames], lambda start_ns: back or Gateway(config, codec, start_ns), TICK_NS,
        lambda _now, sent, _gateway: out.extend(sent),
    )  # fmt: skip
    return out, done.gateway


def assert_goes_on(config, codec, frames, ticks):
    """Stopped after so many ticks, saved and loaded, it sends what it would have sent."""
    whole, _ = sent_by(config, codec, frames)
    at_ns = frames.t_ns.item(0) + ticks * TICK_NS
    before, stopped = sent_by(config, codec, frames.pick(frames.t_ns <= at_ns))
    back = resumed(start_bytes(stopped, state_of(stopped)), "start.bin", config, codec)
    assert back.view == stopped.view
    rest = frames.pick(frames.t_ns > stopped.now_ns)
    after, _ = sent_by(config, codec, rest, back)
    assert before + after == whole


@settings(max_examples=20, deadline=None)
@given(case=st.sampled_from(sorted(CASES)), ticks=st.integers(1, 120))
def test_a_gateway_goes_on_from_a_start_record_as_it_would_have(case, ticks):
    assert_goes_on(*prepared(case), ticks)


def test_a_detector_of_ones_own_goes_on_from_a_start_record(tmp_path):
    config, codec, frames = prepared("loss_median")
    at_ns = frames.t_ns.item(0) + TICK_NS
    _, stopped = sent_by(config, codec, frames.pick(frames.t_ns <= at_ns))
    (tmp_path / "start.bin").write_bytes(start_bytes(stopped, state_of(stopped)))
    rest = frames.pick(frames.t_ns > stopped.now_ns)
    with Writer(tmp_path / "rest.log") as writer:
        for k in range(rest.size):
            writer.write(rest.frame(k))
    asked = []

    def silent(evidence):
        asked.append(evidence)
        return gateway.Opinion(np.zeros(3), evidence.usable, 0.0)

    start = tmp_path / "start.bin"
    gateway.replay(tmp_path / "rest.log", config, detector=silent, start=start)
    assert asked


@given(needed=st.sets(st.integers(0, 59)), size=st.integers(0, 60))
def test_ddmin_keeps_what_is_needed_and_nothing_else(needed, size):
    wanted = np.array(sorted(k for k in needed if k < size), dtype=np.int64)
    groups = [np.arange(size) % 3 == k for k in range(3)]
    kept = minimise(groups, size, lambda mask: bool(mask[wanted].all()))
    assert np.flatnonzero(kept).tolist() == wanted.tolist()


@pytest.mark.parametrize(("flag", "text"), [
    ("adhesion:2@1.0", "does not change within 0.05 s of 1 s; the nearest changes are at 0.000"),
    ("adhesion:7@0.8", "no drive 7; the configuration has 1, 2, 3"),
    ("adhesion:2@9", "9 s is after the end of the log, 2.399 s"),
    ("thermal:2@0", "no change to test"),
])  # fmt: skip
def test_a_flag_that_is_not_there_is_refused_with_what_there_is(tmp_path, capsys, flag, text):
    folder, code = shrunk(tmp_path, flag)
    assert code == 2
    assert text in capsys.readouterr().err
    assert not folder.exists()


@pytest.mark.parametrize("flag", ["adhesion", "comm:1@2", "adhesion:x@2", "adhesion:1@nan"])
def test_words_that_name_no_flag_are_refused(tmp_path, capsys, flag):
    with pytest.raises(SystemExit):
        shrunk(tmp_path, flag)
    assert "such as adhesion:2@41.3" in capsys.readouterr().err


def test_the_state_of_mapped_inverters_is_in_the_start_record(tmp_path):
    config, codec = prepare(INVERTERS / "cascadia_pm.toml")
    lost = {"at_s": 2.0, "for_s": 1.0, "drive": 1, "kind": "adhesion_loss", "depth": 0.8}
    drives = simrun.run(Simulation(simrun.scenario(drives=3, event=[lost]), simrun.codec()), 3.5)
    log = simrun.log_of(tmp_path / "cascadia.log", spoken(config, drives))
    for ticks in (7, 150):
        assert_goes_on(config, codec, reduce(join, Reader(log).blocks()), ticks)
    start, *changes = gateway.replay(log, config).events.to_pylist()
    states = [row for row in changes if row["state"] != "Unknown"]
    assert [row["state"] for row in states] == ["Adhering"] * 2 + ["AdhesionLost", "Adhering"]
    for row in states[-2:]:
        wanted = Wanted(FlagKind.ADHESION, row["drive"], row["t_s"] - start["t_s"])
        left = shrink(log, config, codec, wanted, 50_000_000)
        shrunk_files.write_test(tmp_path / "out", left, wanted, None, log)
        shrunk_files.read_back(tmp_path / "out", left, config, codec)
        assert left.frames.size < 0.02 * left.total


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    """The file of a start record."""
    folder, _ = shrunk(tmp_path_factory.mktemp("record"), "adhesion:2@0.8")
    return folder / shrunk_files.START


def test_a_start_record_is_refused_where_it_does_not_fit(record):
    data = record.read_bytes()
    config, codec = prepare(None)
    other, _, _ = prepared("loss_median")
    magic, _, rest = data.split(b"\n", 2)
    header, packed = rest.split(b"\n", 1)
    newer = json.dumps({**json.loads(header), "layout": "0"}).encode() + b"\n" + packed
    newer = b"\n".join((magic, sha256(newer).hexdigest().encode(), newer))
    for wrong, used, text in (
        (b"(1.0) can0 181#00\n", config, "is not a start record"),
        (data[:-1] + bytes([data[-1] ^ 1]), config, "is damaged"),
        (data[:200], config, "is damaged"),
        (magic, config, "is damaged"),
        (data.replace(b'"now_ns": 7', b'"now_ns": 8'), config, "is damaged"),
        (data, other, "give the same configuration"),
        (newer, config, "another version of traction-gateway"),
    ):
        with pytest.raises(ConfigError, match=text):
            resumed(wrong, "start.bin", used, codec)


def test_a_log_from_before_the_start_record_is_refused(record):
    with pytest.raises(BadLogError, match="do not belong together"):
        gateway.replay(LOSS, start=record)


def test_a_state_outside_of_the_records_is_refused(tmp_path):
    config = parse({"drive": [{"node": n} for n in (1, 2, 3)],
                    "adhesion": {"detector": "paper_vb_reuse", "reuse": 0.5}})  # fmt: skip
    with pytest.raises(ConfigError, match="paper_vb_reuse"):
        state_of(Gateway(config, bind(config.dbc_path, config.nodes), 0))


def test_a_frame_that_candump_cannot_say_is_an_error(tmp_path):
    config, codec, _ = prepared("loss")
    wanted = Wanted(FlagKind.ADHESION, 2, 0.81)
    left = shrink(LOSS, config, codec, wanted, 50_000_000)
    left = left._replace(frames=left.frames._replace(names=["a name with blanks"]))
    with pytest.raises(BadLogError, match="a frame that the flag needs"):
        shrunk_files.write_test(tmp_path, left, wanted, None, LOSS)
    left = left._replace(frames=left.frames.part(0, 5)._replace(names=["can0"]))
    shrunk_files.write_test(tmp_path, left, wanted, None, LOSS)
    with pytest.raises(BadLogError, match="does not give the same flag"):
        shrunk_files.read_back(tmp_path, left, config, codec)


def test_a_flag_between_two_frames_is_tested_by_the_next_one(tmp_path):
    """A loop of 5 ms: a flag frame is sent every second tick."""
    config, codec, frames = prepared("loss")
    config = config.model_copy(update={"loop": config.loop.model_copy(update={"rate_hz": 200})})
    run = gateway.replay(LOSS, config)
    first_s = run.events["t_s"][0].as_py()
    times = [(row["drive"], row["t_s"] - first_s) for row in run.events.to_pylist()]
    node, at_s = next((n, t) for n, t in times if t > 0.5 and round(t * 1000) % 10 == 5)
    wanted = Wanted(FlagKind.ADHESION, node, at_s)
    left = shrink(LOSS, config, codec, wanted, 50_000_000)
    assert left.flag_frame.t_ns - left.change.now_ns == 5_000_000
    log = tmp_path / "short.log"
    with Writer(log) as writer:
        writer.write_block(frames.pick(frames.t_ns <= left.change.now_ns))
    with pytest.raises(BadLogError, match="before a frame with the flag is sent"):
        shrink(log, config, codec, wanted, 50_000_000)
