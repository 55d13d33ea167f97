"""Ended from outside: real programs, signals at any moment, readers that leave."""

import gzip
import os
import random
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from gateway.cli import main
from gateway.io.endings import LOOK_S, LOOKS, Ended, raised
from gateway.io.whole_file import PART, whole, write_text
from tests.thorough import some
from tests.unit.test_cli import SCENARIO

PROGRAM = [sys.executable, "-m", "gateway"]
PATIENCE_S = 300
ATTEMPTS = 5
ENDLESS = """title = "endless"
seed = 1
duration_s = 90000
drives = 3
[[expect]]
flag = "adhesion"
is = "good"
"""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """A log of seconds, one whose end nobody lives to see, and scenarios."""
    here = tmp_path_factory.mktemp("inputs")
    (here / "s.toml").write_text(SCENARIO)
    (here / "fail.toml").write_text(
        SCENARIO.replace('is = "bad"\ndrive = 2', 'is = "bad"\ndrive = 1', 1)
    )
    (here / "endless.toml").write_text(ENDLESS)
    (here / "train.toml").write_text("[[drive]]\nnode = 1\n")
    assert main(["sim", str(here / "s.toml"), "-o", str(here / "s.log")]) == 0
    member = gzip.compress((here / "s.log").read_bytes(), 1)
    with (here / "endless.log.gz").open("wb") as file:
        for _ in range(4000):  # each sets the clock back; 340 MB, which take some ten seconds
            file.write(member)
    return here


def start(words, **pipes):
    """The program, in a session of its own: its signals are for nobody else."""
    given = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **pipes}
    return subprocess.Popen([*PROGRAM, *map(str, words)], start_new_session=True, **given)


def ended(process, number):
    """Send the signal; the exit code as a shell has it, and what stood on stderr."""
    process.send_signal(number)
    _, errors = process.communicate(timeout=PATIENCE_S)
    code = process.returncode
    return (128 - code if code < 0 else code), errors.decode()


def wait_for_part(process, folder):
    """Until it writes: it is at its work then."""
    limit = time.monotonic() + PATIENCE_S
    while not any(PART in path.name for path in folder.rglob("*")):
        assert process.poll() is None, process.stderr.read().decode()
        assert time.monotonic() < limit
        time.sleep(0.01)


def files(folder):
    """Files that say they are whole."""
    return sorted(p.name for p in folder.rglob("*") if p.is_file() and PART not in p.name)


WRITING = {
    "replay": ("replay", "IN/endless.log.gz", "-o", "OUT/o.log"),
    "replay-results": (
        "replay", "IN/endless.log.gz", "-o", "OUT/o.log.gz", "--results", "OUT/results",
    ),
    "convert-log": ("convert", "IN/endless.log.gz", "OUT/o.log.gz"),
    "convert-blf": ("convert", "IN/endless.log.gz", "OUT/o.blf"),
    "convert-parquet": ("convert", "IN/endless.log.gz", "OUT/o.parquet", "--frames"),
    "sim": ("sim", "IN/endless.toml", "-o", "OUT/o.log", "--truth", "OUT/truth.csv"),
    "hil": (
        "hil", "IN/endless.toml", "-o", "OUT/o.log", "--junit", "OUT/j.xml", "--results", "OUT/r",
    ),
    "fleet": ("fleet", "IN/endless.log.gz", "-o", "OUT/fleet", "-j", "1"),
}  # fmt: skip
COMPUTING = {
    "convert-signals": ("convert", "IN/endless.log.gz", "OUT/o.csv"),
    "convert-mf4": ("convert", "IN/endless.log.gz", "OUT/o.mf4", "--frames"),
    "calibrate": ("calibrate", "IN/endless.log.gz", "-o", "OUT/cells.toml"),
    "evaluate": ("evaluate", "--seeds", "1-900", "-j", "2", "-o", "OUT/e"),
    "evaluate-thermal": ("evaluate", "thermal", "--seeds", "1-900", "-o", "OUT/e"),
    "demo": ("demo", "--headless", "--duration", "9000", "-o", "OUT/demo.png"),
}  # fmt: skip


def in_turn(names):
    """One signal each for a change, the other one before a release; of a fleet: test_fleet.py."""
    other = pytest.mark.thorough
    return [
        pytest.param(
            name,
            number,
            marks=[other] * (name == "fleet" or (k + j) % 2 == 1),
            id=f"{name}-{number.name[3:]}",
        )
        for k, name in enumerate(names)
        for j, number in enumerate((signal.SIGINT, signal.SIGTERM))
    ]


def placed(words, inputs, out="OUT"):
    return [w.replace("IN/", f"{inputs}/").replace("OUT/", f"{out}/") for w in words]


def in_the_middle(words, folder, number, delay_s, ready=None):
    """Start, wait until ready and so long, send the signal: output folder, exit code and errors.

    A program that was done by then, because this process stood still, is started anew and ended
    sooner. One that a signal does not end is done each time.
    """
    for attempt in range(ATTEMPTS):
        out = folder / str(attempt)
        out.mkdir()
        process = start(word.replace("OUT/", f"{out}/") for word in words)
        if ready is not None:
            ready(process, out)
        time.sleep(delay_s / (attempt + 1))
        code, errors = ended(process, number)
        if code:
            break
    return out, code, errors


@pytest.mark.parametrize(("name", "number"), in_turn(WRITING))
def test_what_a_signal_ends_says_so_and_leaves_nothing_half_written(inputs, tmp_path, name, number):
    delay_s = random.Random(f"{name} {number}").uniform(0.0, 0.7)
    words = placed(WRITING[name], inputs)
    out, code, errors = in_the_middle(words, tmp_path, number, delay_s, wait_for_part)
    assert code == 128 + number, errors
    assert "Traceback" not in errors
    if name == "fleet":
        assert files(out) == ["fleet.csv", "fleet.parquet"]
        assert pq.read_table(out / "fleet" / "fleet.parquet").num_rows == 0
    else:
        assert files(out) == []


@pytest.mark.parametrize(("name", "number"), in_turn(COMPUTING))
def test_a_signal_ends_what_computes(inputs, tmp_path, name, number):
    # MF4 keeps what its clock allows, one member of all these: it is at its end soon.
    soon, late = (0.2, 0.9) if name == "convert-mf4" else (0.8, 2.0)
    delay_s = random.Random(f"{name} {number}").uniform(soon, late)
    out, code, errors = in_the_middle(placed(COMPUTING[name], inputs), tmp_path, number, delay_s)
    assert code == 128 + number, errors
    assert files(out) == []


@pytest.mark.parametrize("seed", some([0, 1], range(2, 8)))
def test_at_any_moment_a_file_is_whole_or_not_there(inputs, tmp_path, seed):
    """Also before the first line of ours runs, and after the last."""
    draw = random.Random(seed)
    process = start(placed(("replay", "IN/s.log", "-o", "OUT/o.log"), inputs, tmp_path))
    time.sleep(draw.uniform(0.0, 3.0))
    number = draw.choice([signal.SIGINT, signal.SIGTERM])
    code, errors = ended(process, number)
    assert code in (0, 128 + number), errors
    if files(tmp_path):
        assert main(["replay", str(inputs / "s.log"), "-o", str(tmp_path / "again.log")]) == 0
        assert (tmp_path / "o.log").read_bytes() == (tmp_path / "again.log").read_bytes()
    else:
        assert code != 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["int", "term"])
def test_a_service_is_told_to_stop_and_ends_well(inputs, number):
    process = start(["run", "-i", "virtual", "-c", "endings", "--quiet", "-v"])
    for line in process.stderr:
        if b"ready " in line or b"bus is up" in line:
            break
    code, errors = ended(process, number)
    assert code == 0, errors
    process = start(["monitor", inputs / "s.log", "--web", "127.0.0.1:0"])
    assert b"web: http" in process.stderr.readline()
    code, errors = ended(process, number)
    assert code == 0, errors


@pytest.mark.parametrize(
    ("words", "verdict"),
    [
        (("--help",), None), (("replay", "IN/s.log"), None), (("hil", "IN/fail.toml"), 1),
        *(pytest.param(words, None, marks=pytest.mark.thorough) for words in (
            ("replay", "--help"), ("hil", "IN/s.toml"), ("sim", "IN/s.toml"),
            ("check", "IN/train.toml", "--no-timing"), ("convert", "IN/s.log", "OUT/o.parquet"),
            ("completion", "bash"),
        )),
    ],
    ids=lambda given: "-".join(given[:2]).replace("IN/", "") if isinstance(given, tuple) else "",
)  # fmt: skip
def test_who_does_not_read_on_has_seen_nothing_pass(inputs, tmp_path, words, verdict):
    reading, writing = os.pipe()
    os.close(reading)
    buffered = {**os.environ, "PYTHONUNBUFFERED": ""}  # argparse says nothing of a failed write
    process = start(placed(words, inputs, tmp_path), stdout=writing, env=buffered)
    os.close(writing)
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode in {141, verdict or 141}, errors.decode()
    assert b"Traceback" not in errors
    assert b"ignored" not in errors


def test_nor_does_an_error_that_nobody_reads(inputs):
    reading, writing = os.pipe()
    os.close(reading)
    process = start(["replay", inputs / "s.log"], stderr=writing)
    os.close(writing)
    process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 141


def test_results_that_find_no_room_are_an_error(inputs):
    with Path("/dev/full").open("wb") as full:
        process = start(["replay", inputs / "s.log"], stdout=full)
        _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 2
    assert b"[Errno 28] No space left" in errors
    assert errors.count(b"Errno") == 1
    assert b"Traceback" not in errors


# ---- parts -------------------------------------------------------------------------------------


def send_self(number):
    os.kill(os.getpid(), number)
    time.sleep(1.0)


def half_written(path, error, **how):
    with whole(path, **how) as part:
        part.write_text("ne")
        assert part.suffix == path.suffix, "writers go by it"
        raise error


def test_the_note_outlives_who_swallows_the_signal():
    before = signal.getsignal(signal.SIGTERM)
    with raised() as note:
        with pytest.raises(KeyboardInterrupt):
            send_self(signal.SIGTERM)
        assert note.ended is not None
        assert note.ended.code == 143
        with pytest.raises(Ended, match="SIGINT"):
            send_self(signal.SIGINT)
    assert note.ended.number == signal.SIGTERM, "the first one counts"
    assert signal.getsignal(signal.SIGTERM) is before


class Swallows:
    """What it raises at its end nobody hears of."""

    def __del__(self):
        send_self(signal.SIGTERM)


def swallowing(note):
    swallows = Swallows()
    del swallows
    assert note.ended is not None
    time.sleep(PATIENCE_S)


def test_a_signal_that_python_cannot_raise_comes_again(capfd):
    with raised() as note, pytest.raises(Ended):
        swallowing(note)
    assert "ignored" not in capfd.readouterr().err


def swallowed_by_an_except():
    with suppress(BaseException):
        send_self(signal.SIGTERM)
    time.sleep(PATIENCE_S)


def test_a_signal_that_an_except_swallows_comes_again():
    with raised() as note, pytest.raises(Ended):
        swallowed_by_an_except()
    assert note.ended.number == signal.SIGTERM


def tidying(done):
    try:
        send_self(signal.SIGTERM)
    finally:
        time.sleep(3 * LOOK_S * LOOKS)
        done.append("tidied")


def test_what_tidies_up_after_a_signal_is_left_in_peace():
    done = []
    with raised(), pytest.raises(Ended):
        tidying(done)
    assert done == ["tidied"]


def test_what_was_ignored_stays_ignored():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with raised() as note:
            os.kill(os.getpid(), signal.SIGINT)
        assert note.ended is None
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_file_is_whole_or_the_old_one(tmp_path):
    path = tmp_path / "deep" / "a.txt"
    write_text(path, "old")
    for error in (ValueError("half"), KeyboardInterrupt()):
        with pytest.raises(type(error)):
            half_written(path, error)
    assert [p.name for p in path.parent.iterdir()] == ["a.txt"]
    assert path.read_text() == "old"
    with pytest.raises(KeyboardInterrupt):
        half_written(path, KeyboardInterrupt(), keep=True)
    assert path.read_text() == "old"
    assert path.with_name("a.txt.part").read_text() == "ne"
    link = tmp_path / "link.txt"
    link.symlink_to(path)
    write_text(link, "new")
    assert link.is_symlink()
    assert path.read_text() == "new"


def test_a_device_or_a_pipe_is_written_to_as_it_is(tmp_path):
    with whole(Path("/dev/null")) as part:
        assert part == Path("/dev/null")
    fifo = tmp_path / "fifo.log"
    os.mkfifo(fifo)
    with whole(fifo) as part:
        assert part == fifo
    assert fifo.is_fifo()
