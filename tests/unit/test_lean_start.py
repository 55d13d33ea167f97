"""What a start does not load: cryptography is for those who have a key, MF4 for who reads logs.

asammdf, pandas, pyarrow and the others are installed where these tests run.
"""

import gc
import importlib
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from gateway.cli import main
from gateway.io import quick_start as leanstart
from gateway.io.console import console, note
from gateway.settings.config import ConfigError

EXAMPLE = Path(__file__).parents[2] / "examples" / "train.toml"

RUN = """
import sys
from gateway.cli import main
code = main(["run", "-i", "virtual", "-c", "lean", "--quiet", "--duration", "0.1", *sys.argv[1:]])
print("cryptography" in sys.modules, code)
"""


def loaded(folder, *words):
    done = subprocess.run(
        [sys.executable, "-c", RUN, *words], capture_output=True, text=True, check=True, cwd=folder
    )
    return done.stdout.splitlines()[-1]


def test_run_loads_no_cryptography_unless_something_is_authenticated(tmp_path):
    assert loaded(tmp_path) == "False 0"
    config = tmp_path / "train.toml"
    config.write_text("[authentication]\n")
    assert loaded(tmp_path, "--config", str(config), "--listen-only") == "False 0"
    key = tmp_path / "auth.key"
    key.write_text("00112233445566778899aabbccddeeff")
    key.chmod(0o600)
    assert loaded(tmp_path, "--config", str(config)) == "True 0"
    assert (tmp_path / "trip").read_text() == "00000001\n"


HEAVY = ("asammdf", "pandas", "pyarrow", "matplotlib", "starlette", "textual", "scipy.linalg",
         "sklearn", "cantools", "cffi", "rich", "mcap")  # fmt: skip


def program(folder, text):
    """What a program in a process of its own says last."""
    done = subprocess.run(
        [sys.executable, "-c", text], capture_output=True, text=True, check=False, cwd=folder
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[-1]


def test_run_loads_nothing_for_logs_plots_pages_and_tables(tmp_path):
    assert all(map(find_spec, ("asammdf", "pandas", "pyarrow")))
    text = f"[m for m in {HEAVY} if m in sys.modules], 'can' in sys.modules"
    said = program(tmp_path, RUN.replace('"cryptography" in sys.modules', text))
    assert said == "[] True 0"


def test_mf4_is_read_and_written_in_a_program_that_started_on_a_bus(tmp_path):
    text = """
from pathlib import Path
from dbc.frames import block_of
from dbc.frame import Frame
from dbc.logs.opening import open_reader
from gateway.logfiles.mf4 import Mf4Frames
assert "asammdf" not in sys.modules
frames = [Frame(10**18 + k * 10**6, 0x100 + k, bytes([k] * 8)) for k in range(5)]
{order}
"""
    write = "sink = Mf4Frames(Path('x.mf4')); sink.add(block_of(frames)); sink.close()\n"
    read = (
        "read = open_reader(Path('x.mf4'), strict=False)\n"
        "print([(f.can_id, f.data) for f in read] == [f[1:3] for f in frames])"
    )
    for order in (write + read, read):  # the file is there for the second
        assert program(tmp_path, RUN + text.format(order=order)) == "True"


def test_what_is_absent_for_a_while_is_there_again():
    with leanstart.absent("xdrlib_of_nobody", "json"):
        assert "json" in sys.modules, "what is loaded stays"
        with pytest.raises(ImportError):
            importlib.import_module("xdrlib_of_nobody")
    assert "xdrlib_of_nobody" not in sys.modules


def test_collecting_goes_on_after_a_start_that_failed():
    assert gc.isenabled()
    before = gc.get_freeze_count()
    start = leanstart.uncollected()
    start.__enter__()
    assert not gc.isenabled()
    assert not start.__exit__(ConfigError, ConfigError("x", []), None)
    assert gc.isenabled()
    assert gc.get_freeze_count() == before


def test_what_a_start_has_made_is_not_searched_at_once():
    gc.unfreeze()
    with leanstart.unsearched():
        made = [[]]
    assert any(one is made for one in gc.get_objects(generation=2))
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0


def test_a_missing_key_is_one_clear_line(tmp_path):
    config = tmp_path / "train.toml"
    config.write_text("[authentication]\n")
    done = subprocess.run(
        [sys.executable, "-m", "gateway", "run", "-i", "virtual", "-c", "x", "--quiet",
         "--config", str(config)], capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.startswith("traction-gateway: ")
    assert "auth.key" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "trip").exists(), "no start is counted that did not happen"


def test_a_candump_log_is_replayed_without_mf4_and_threads_of_numpy(tmp_path):
    (tmp_path / "x.log").write_text("(1.000000) can0 123#00\n")
    text = """
import os, sys
from gateway.cli import main
code = main(["replay", "x.log", "-o", "y.log"])
loaded = [m for m in ("asammdf", "pandas", "pyarrow") if m in sys.modules]
print(loaded, code, len(os.listdir("/proc/self/task")))
"""
    assert program(tmp_path, text) == "[] 0 1"


RICH = ("FORCE_COLOR", "TTY_COMPATIBLE", "COLUMNS")
"""Variables by which rich decides, terminal or not."""
BRIEF = """
import sys
from gateway.cli import main
code = main(sys.argv[1:])
print([m for m in {names} if m in sys.modules], code)
"""
UNUSED = ("scipy", "matplotlib", "cantools", "canopen", "rich", "asyncio", "sklearn", "pywt",
          "cryptography", "asammdf", "pandas", "pyarrow", "mcap", "starlette",
          "textual")  # fmt: skip


def brief(folder, names, *words):
    """What of these a command has loaded, and its exit code."""
    done = subprocess.run(
        [sys.executable, "-c", BRIEF.format(names=names), *words],
        capture_output=True, text=True, check=True, cwd=folder,
        env={k: v for k, v in os.environ.items() if k not in RICH},
    )  # fmt: skip
    return done.stdout.splitlines()[-1]


def test_check_loads_what_it_needs(tmp_path):
    """The simulator, NumPy and pydantic; python-can for who names a bus."""
    assert brief(tmp_path, (*UNUSED, "can"), "check", str(EXAMPLE)) == "[] 0"
    said = brief(tmp_path, ("scipy", "can"), "check", str(EXAMPLE), "-i", "virtual", "-c", "x")
    assert said == "['can'] 0"


def test_replay_loads_what_it_needs(tmp_path):
    (tmp_path / "x.log").write_text("(1.000000) can0 123#00\n")
    words = ("replay", "x.log", "--config", str(EXAMPLE), "-o", "y.log")
    assert brief(tmp_path, (*UNUSED, "can", "sim"), *words) == "[] 0"


def test_help_loads_no_numpy(tmp_path):
    """Nor what would load it; where it has options of a bus, these are python-can's."""
    text = """
import sys
from gateway.cli import VERBS, main
loaded = {}
for verb in VERBS:
    try:
        main([verb, "--help"])
    except SystemExit as ended:
        heavy = [m for m in ("numpy", "scipy", "matplotlib") if m in sys.modules]
        loaded[verb] = ended.code or heavy
print({verb: found for verb, found in loaded.items() if found}, len(loaded) == len(VERBS))
"""
    assert program(tmp_path, text) == "{} True"


def test_options_of_a_bus_are_part_of_the_help_and_of_what_is_refused(capsys):
    for words in (["check", "--help"], ["check"], ["check", "x.toml", "--bitrate", "much"]):
        with pytest.raises(SystemExit):
            main(words)
        out, err = capsys.readouterr()
        assert "--data-bitrate" in out + err, words


def test_a_line_that_is_piped_is_as_rich_would_print_it(capsys, monkeypatch):
    for name in RICH:
        monkeypatch.delenv(name, raising=False)
    words = "replayed 21.00 s of can0 in 0.18 s (120 times real time), 2101 ticks"
    for text in (words, 3 * words, "[red]x[/red]", "a:smile: b: c", "12:30 \u2603", "tab\tx", ""):
        for wrap in (False, True):
            note(text, wrap=wrap)
            ours = capsys.readouterr().err
            console().print(text, markup=False, soft_wrap=not wrap)
            assert ours == capsys.readouterr().err, (text, wrap)


@pytest.mark.parametrize("verb", ["check", "replay"])
def test_what_ends_at_once_has_printed_all_and_done_what_was_registered(verb, tmp_path):
    (tmp_path / "x.log").write_text("(1.000000) can0 123#00\n")
    text = """
import atexit, sys
from gateway.cli import program
atexit.register(lambda: open("ended", "w").write("yes"))
atexit.register(print, "the end")
program()
"""
    file = str(EXAMPLE) if verb == "check" else "x.log"
    done = subprocess.run(
        [sys.executable, "-c", text, verb, file], capture_output=True, text=True, check=False,
        cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0
    assert done.stdout.endswith("the end\n")
    assert len(done.stdout.splitlines()) > 3
    assert (tmp_path / "ended").read_text() == "yes"
    done = subprocess.run(
        [sys.executable, "-c", text, verb, "missing"], capture_output=True, text=True, check=False,
        cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 2
    assert "missing: no such file" in done.stderr


def test_what_only_papers_need_is_asked_for_by_its_extra(tmp_path):
    text = """
import importlib.util
known = importlib.util.find_spec
import gateway.io.extras as extras
extras.find_spec = lambda name: None if name in ("autograd", "pywt", "sklearn") else known(name)
from gateway.cli import main
print(main(["reproduce", "thermal", "-o", "out"]))
"""
    done = subprocess.run(
        [sys.executable, "-c", text], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    assert done.stdout == "2\n"
    assert (
        "needs autograd, pywt, sklearn: pip install 'autograd>=1.8' 'PyWavelets>=1.7' "
        in done.stderr
    )
    assert not (tmp_path / "out").exists()
