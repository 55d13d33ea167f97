"""The fuzz targets hold on their corpus and on a few hundred mutations of it, and can fail.

`make fuzz-deep` runs them with coverage for as long as one likes; what that found has a name here.
"""

import gzip
import random
import subprocess
import sys
import tomllib
from collections import Counter

import numpy as np
import pytest

from dbc.candump.grammar import Verdict, parse_line
from dbc.candump.reader import LogError, Reader
from dbc.codec import bind
from dbc.contract import ANY
from dbc.e2e import protect
from dbc.frame import BRS, FD, MS, Frame
from dbc.frames import blank
from dbc.spec import DbcMismatch
from gateway.core.gateway import Gateway
from gateway.core.supervision import Life, Supervision
from gateway.settings import calibration
from gateway.settings.config import ConfigError, load, parse
from sim import scenario as scenarios
from sim.scenario import ScenarioError, parse_text
from tests.dbc_text import write
from tests.fuzzing import candump, frames, texts, tick, values
from tests.fuzzing.__main__ import NAMES, UNITS, summary
from tests.fuzzing.engine import PACKAGES
from tests.fuzzing.held import Held
from tests.fuzzing.mutate import mutate
from tests.fuzzing.targets import CORPUS, TARGETS
from tests.mutation import core
from tests.stations import Inbox

MUTATIONS = {
    "candump": 600, "readers": 40, "frames": 150, "tick": 300, "values": 24, "dbc": 60,
    "config": 250, "scenario": 250,
}  # fmt: skip
MOST_BYTES = 100_000


def mutations(name, count):
    """The same ones every time."""
    target, rng = TARGETS[name], random.Random(name)
    corpus = target.corpus()
    return [
        mutate(rng.choice(corpus), rng, target.tokens, corpus, target.longest) for _ in range(count)
    ]


@pytest.mark.parametrize("name", TARGETS)
def test_every_target_holds(name):
    target = TARGETS[name]
    inputs = [*target.corpus(), *mutations(name, MUTATIONS[name])]
    items = sum(target.run_all(data) for data in inputs)
    # Inputs that get past the first check are among them.
    assert items >= 5


def test_the_corpus_is_small_and_complete():
    assert sorted(p.name for p in CORPUS.iterdir()) == sorted(TARGETS) == sorted(NAMES)
    assert set(UNITS) == set(PACKAGES) == set(TARGETS)
    assert all(TARGETS[name].items == UNITS[name] for name in NAMES)
    files = [path for path in CORPUS.rglob("*") if path.is_file()]
    assert len(files) < 100
    assert sum(path.stat().st_size for path in files) < MOST_BYTES


def test_mutations_differ_and_stay_within_bounds():
    made = mutations("candump", 300)
    assert made == mutations("candump", 300)
    assert len(set(made)) > 200
    assert max(map(len, made)) <= TARGETS["candump"].longest


def test_the_summary_adds_up():
    run = {"target": "dbc", "executions": 1000, "items": 7, "seconds": 10.0, "found": 1}
    said = summary([run, run, {"target": "frames", "executions": 5, "found": 0}])
    assert "| dbc | 2 | 2,000 | 100 | 14 codecs | 2 |" in said
    assert said.endswith("2,005 executions.")


# ---- a broken product is found -----------------------------------------------------------------


def _fails(run, name):
    """Some input of the gate makes the target fail."""
    for data in [*TARGETS[name].corpus(), *mutations(name, MUTATIONS[name])]:
        try:
            run(data)
        except Exception:
            return
    pytest.fail("a broken product passed")


class _Miscounts(Reader):
    def _accept(self, *lines):
        self.lines += 1
        return super()._accept(*lines)


class _NeverStrict(Reader):
    def __init__(self, source, *, strict=False):
        super().__init__(source)


def _no_remote(line):
    verdict, frame = parse_line(line)
    return (Verdict.OK if verdict is Verdict.REMOTE else verdict), frame


@pytest.mark.parametrize(
    "broken", [{"reader": _Miscounts}, {"reader": _NeverStrict}, {"parse": _no_remote}]
)
def test_a_broken_reader_is_found(broken):
    _fails(lambda data: candump.candump(data, every=1, **broken), "candump")


@pytest.mark.parametrize("broken", [_Miscounts, _NeverStrict])
def test_a_reader_that_is_broken_on_long_logs_is_found(broken):
    tokens = TARGETS["readers"].tokens
    _fails(lambda data: candump.readers(data, tokens, broken), "readers")


def test_a_reader_is_given_the_lines_that_are_said():
    read = []

    class Counts(Reader):
        def blocks(self):
            yield from super().blocks()
            read.append(self.lines)

    target = TARGETS["readers"]
    for data in [data for data in target.corpus() if not data.startswith(candump.ZIPPED)]:
        read.clear()
        said = candump.readers(data, target.tokens, Counts)
        assert said > candump.GROWN
        assert read[0] in (said, said - 1)  # the last may be empty


class _TakesAnyLength(Inbox):
    """Cuts frames to the length that is expected, as many receivers do."""

    def take(self, came, now):
        cut = [f._replace(data=f.data[:8], flags=f.flags & ~FD) for f in came]
        return super().take(cut, now)


class _LosesOne(Inbox):
    def take(self, came, now):
        return super().take(list(came)[1:], now)


class _Repeats(Gateway):
    """The last frame of a tick goes out twice."""

    def step(self, came, now):
        out = super().step(came, now)
        return [*out, *out[-1:]]


class _Unprotected(Gateway):
    def step(self, came, now):
        return [f._replace(data=b"\0" + f.data[1:]) for f in super().step(came, now)]


@pytest.mark.parametrize("broken", [_TakesAnyLength, _LosesOne])
def test_a_broken_decoder_is_found(broken):
    _fails(lambda data: frames.frames(data, inbox=broken, every=1 << 40), "frames")


@pytest.mark.parametrize("broken", [_Repeats, _Unprotected])
def test_a_broken_core_is_found(broken):
    _fails(lambda data: frames.frames(data, gateway=broken, every=1), "frames")


class _Divides(Gateway):
    """By what a current has moved in a tick."""

    def step(self, arrived, now):
        out = super().step(arrived, now)
        assert 1.0 / float(np.ptp(self.inbox.samples.y[:5, 0])) > 0.0
        return out


def test_a_gateway_that_divides_by_a_value_is_found():
    _fails(lambda data: values.values(data, gateway=_Divides), "values")


@pytest.mark.parametrize("broken", [_Unprotected])
def test_a_broken_tick_is_found(broken):
    _fails(lambda data: tick.tick(data, broken, every=1), "tick")


BROKEN = """
import sys
from pathlib import Path
from tests.fuzzing.test_fuzzing import mutations
from tests.fuzzing.tick import SETUPS, tick
from tests.mutation.forked import become

for setup in range(len(SETUPS)):
    tick(bytes([setup]))
become(Path(sys.argv[1]))
print("begun", flush=True)
for data in mutations("tick", 300):
    tick(data)
"""


def test_a_core_that_follows_a_damaged_count_out_of_its_ring_is_found(tmp_path):
    """It crashes, or breaks what lies there; with sanitizers a step behind the end is enough."""
    source, before = "gateway/core/current_plausibility.c", "[p->samples % CURRENT_HISTORY]"
    lines = (core.ROOT / source).read_text().splitlines()
    at = next(k for k, line in enumerate(lines) if before in line)
    changed = lines[at].strip().replace(before, "[p->samples]")
    mutant = core.Mutant(source, at + 1, lines[at].strip(), changed)
    (library,) = core.libraries(source, [mutant], tmp_path)
    assert library is not None
    command = [sys.executable, "-c", BROKEN, str(library)]
    done = subprocess.run(command, cwd=core.ROOT, capture_output=True, text=True, check=False)
    assert done.stdout == "begun\n", done.stderr
    assert done.returncode != 0


def _bare_cantools(path, nodes, contract):
    """A loader that lets out whatever cantools raises."""
    from cantools.database import load_file

    load_file(path, database_format="dbc")
    return bind(path, nodes, contract)


def _silent(path, nodes, contract):
    try:
        return bind(path, nodes, contract)
    except DbcMismatch:
        raise DbcMismatch(path, []) from None


@pytest.mark.parametrize("broken", [_bare_cantools, _silent])
def test_a_broken_dbc_loader_is_found(broken):
    _fails(lambda data: texts.dbc(data, broken), "dbc")


def _bare_toml(path):
    return parse(tomllib.loads(path.read_text()), str(path))


def _no_path(path):
    try:
        return load(path)
    except ConfigError as error:
        raise ConfigError("x", ["something is wrong"] * len(error.problems)) from None


@pytest.mark.parametrize("broken", [_bare_toml, _no_path])
def test_a_broken_configuration_is_found(broken):
    _fails(lambda data: texts.config(data, broken), "config")


def _bare_scenario(path):
    return scenarios.parse(tomllib.loads(path.read_text()))


def _two_lines(path):
    try:
        return scenarios.load(path)
    except ScenarioError as error:
        error.problems = ("\n".join(error.problems),)
        raise


@pytest.mark.parametrize("broken", [_bare_scenario, _two_lines])
def test_a_broken_scenario_loader_is_found(broken):
    _fails(lambda data: texts.scenario(data, broken), "scenario")


# ---- every identifier, kind and length ---------------------------------------------------------


def test_no_wrong_kind_or_length_is_decoded():
    """Every 11-bit identifier, all 64 flags, lengths 0..64: only our messages are, as they are.

    The bytes are right for the message, checksum and counter too, whatever kind and length the
    frame has: nothing else than these can keep it out.
    """
    for codec in frames.CODECS:
        specs = {m.can_id: m for m in codec.messages if m.node in frames.NODES and not m.is_gateway}
        flags, length = (a.ravel() for a in np.meshgrid(np.arange(64), np.arange(65)))
        room = len(flags)
        ends = Counter()
        right = 0
        for can_id, spec in specs.items():
            box = Inbox(codec, frames.NODES, 10 * MS, Supervision(frames.NODES, 300 * MS))
            payload = codec.encode(spec, {s.name: 0.0 for s in spec.signals} | {"Quality": 1})
            kind = (FD | BRS) if spec.is_fd else 0
            for k in range(6):
                protect(spec, payload, k)
                box.take([Frame(k * MS, can_id, bytes(payload), kind)], k * MS)
            before = Counter(box.counts)
            assert before["decoded"] + before["not_available"] > 1
            protect(spec, payload, 6)
            # Checksums by themselves: the state machine would keep out all but the first.
            rows = blank(room, ["can0"])
            rows.t_ns[:], rows.can_id[:], rows.flags[:], rows.length[:] = (
                6 * MS,
                can_id,
                flags,
                length,
            )
            rows.data[:] = 0
            rows.data[:, : spec.length] = np.frombuffer(bytes(payload), np.uint8)
            fits = (flags & (1 | 2 | 4) == 0) & (flags & FD == kind & FD) & (length == spec.length)
            right += int(fits.sum())
            box.take(rows.pick(~fits), 6 * MS)
            after = Counter(box.counts)
            after.subtract(before)
            for name in ("decoded", "not_available", "range", "error", "repeated", "not_yet_valid"):
                assert after[name] == 0, (spec.name, name)
            plain = flags & (1 | 2 | 4) == 0
            assert after["wrong_length"] == int((plain & ~fits).sum())
            assert after["error_frame"] == int((flags & 4 != 0).sum())
            assert after["remote"] == int((flags & 6 == 2).sum())
            assert after["unknown_id"] == int((flags & 7 == 1).sum())
            ends += after
        # With or without BRS and ESI, and those bits mean nothing of a classic frame.
        assert right == 4 * len(specs)
        assert ends["received"] == len(specs) * room - right


# ---- found ---------------------------------------------------------------------------------------


DEEP = "[" * 5000
LONG = "9" * 5000


@pytest.mark.parametrize("text", [f"x = {DEEP}", f"x = {LONG}", f'x = """{LONG}'])
def test_toml_that_tomllib_cannot_hold_is_one_clear_line(text, tmp_path):
    """tomllib raises RecursionError and bare ValueErrors."""
    with pytest.raises(ConfigError) as refused:
        load(Held(text.encode(), "train.toml"))
    assert len(refused.value.problems) == 1
    assert refused.value.problems[0].startswith("cannot be read as TOML: ")
    with pytest.raises(ScenarioError) as unfit:
        parse_text(text)
    assert unfit.value.problems[0].startswith("not TOML: ")
    path = tmp_path / "calibration.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match="cannot be read as TOML"):
        calibration.load(path, (1,), 5.0)


def test_a_name_with_a_nul_is_refused():
    config = load(Held(b'dbc.file = "a\\u0000b"\nthermal.calibration = "c\\u0000d"\n', "t.toml"))
    with pytest.raises(DbcMismatch, match="cannot be read: embedded null byte"):
        bind(config.dbc_path, (1,))
    with pytest.raises(ConfigError, match="embedded null byte"):
        calibration.load(config.calibration_path, (1,), 5.0)


def test_strict_says_that_a_zipped_log_is_cut():
    """The last piece looked like a whole line of the same length: nothing was said."""
    line = b"(1.000000) can0 123#1122\n"
    whole = gzip.compress(2 * line, mtime=0) + gzip.compress(line[:-1], mtime=0)
    cut = Reader(Held(whole[:-1]))
    assert len(list(cut)) == 2
    assert cut.counts[Verdict.CUT] == 1
    with pytest.raises(LogError, match="log:3: cut: compressed data end early"):
        list(Reader(Held(whole[:-1]), strict=True))
    with pytest.raises(LogError, match="compressed data are damaged"):
        list(Reader(Held(whole[:-4] + b"\1\0\0\0"), strict=True))


def test_a_time_below_zero_is_no_time():
    """-1 stands for "none": a frame with it was used, and its silence never noticed."""
    codec = frames.CODECS[0]
    spec = codec.by_name["Drive1_Motion"]
    box = Inbox(codec, frames.NODES, 10 * MS, Supervision(frames.NODES, 300 * MS))
    payload = codec.encode(spec, {"Quality": 1, "Speed": 100.0})
    protect(spec, payload, 0)
    box.take([Frame(-1, spec.can_id, bytes(payload))], 10 * MS)
    assert box.counts["time_back"] == 1
    assert box.counts["decoded"] == box.counts["not_available"] == 0


def test_a_heartbeat_from_the_future_is_no_life():
    """It kept its node alive until then: no silence was ever noticed."""
    watch = Supervision(frames.NODES, 300 * MS)
    box = Inbox(frames.CODECS[0], frames.NODES, 10 * MS, watch)
    box.take([Frame(frames.LAST, 0x701, b"\x05"), Frame(-1, 0x702, b"\x05")], 10 * MS)
    assert box.counts["time_back"] == 2
    assert {watch.life(node, 10 * MS) for node in frames.NODES} == {Life.NEVER_SEEN}
    for at in (10 * MS, 110 * MS):
        box.take([Frame(at, 0x701, b"\x05")], at)
    assert watch.life(1, 110 * MS) is Life.ALIVE
    assert watch.life(1, 411 * MS) is Life.LOST


@pytest.mark.parametrize(
    ("by", "said"),
    [
        ("Z", "M.W: is multiplexed by Z, which the message does not have"),
        ("W", "M.W: is multiplexed by itself"),
        ("Y", "M.W: is multiplexed by itself"),
    ],
)
def test_a_multiplexer_that_is_not_there_is_named(by, said, tmp_path):
    """A KeyError; and where signals select each other decoding would not end."""
    path = write(
        tmp_path / "mux.dbc",
        "BO_ 1 M: 8 A",
        ' SG_ Y m0M : 8|8@1+ (1,0) [0|0] "" A',
        ' SG_ W m1M : 16|8@1+ (1,0) [0|0] "" A\n',
        "SG_MUL_VAL_ 1 Y W 0-0;",
        f"SG_MUL_VAL_ 1 W {by} 1-1;",
    )
    with pytest.raises(DbcMismatch) as refused:
        bind(path, (), ANY)
    assert said in refused.value.problems
