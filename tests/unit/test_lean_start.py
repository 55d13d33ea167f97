"""What a start does not load: cryptography is for those who have a key, MF4 for who reads logs.

asammdf, pandas, pyarrow and the others are installed where these tests run.
"""

from __future__ import annotations

import gc
import importlib
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from gateway.io import quick_start as leanstart
from gateway.settings.config import ConfigError

RUN = """
import sys
from gateway.cli import main
code = main(["run", "-i", "virtual", "-c", "lean", "--quiet", "--duration", "0.1", *sys.argv[1:]])
print("cryptography" in sys.modules, code)
"""


def loaded(folder: Path, *words: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", RUN, *words], capture_output=True, text=True, check=True, cwd=folder
    )
    return done.stdout.splitlines()[-1]


def test_run_loads_no_cryptography_unless_something_is_authenticated(tmp_path: Path) -> None:
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
         "sklearn", "cantools", "cffi", "rich")  # fmt: skip


def program(folder: Path, text: str) -> str:
    """What a program in a process of its own says last."""
    done = subprocess.run(
        [sys.executable, "-c", text], capture_output=True, text=True, check=False, cwd=folder
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[-1]


def test_run_loads_nothing_for_logs_plots_pages_and_tables(tmp_path: Path) -> None:
    assert all(map(find_spec, ("asammdf", "pandas", "pyarrow")))
    text = f"[m for m in {HEAVY} if m in sys.modules], 'can' in sys.modules"
    said = program(tmp_path, RUN.replace('"cryptography" in sys.modules', text))
    assert said == "[] True 0"


def test_mf4_is_read_and_written_in_a_program_that_started_on_a_bus(tmp_path: Path) -> None:
    text = """
from pathlib import Path
from dbc.frames import block_of
from dbc.frame import Frame
from dbc.openlog import read_any
from gateway.logfiles.mf4 import Mf4Frames
assert "asammdf" not in sys.modules
frames = [Frame(10**18 + k * 10**6, 0x100 + k, bytes([k] * 8)) for k in range(5)]
{order}
"""
    write = "sink = Mf4Frames(Path('x.mf4')); sink.add(block_of(frames)); sink.close()\n"
    read = (
        "print([(f.can_id, f.data) for f in read_any(Path('x.mf4'))] == [f[1:3] for f in frames])"
    )
    for order in (write + read, read):  # the file is there for the second
        assert program(tmp_path, RUN + text.format(order=order)) == "True"


def test_what_is_absent_for_a_while_is_there_again() -> None:
    with leanstart.absent("xdrlib_of_nobody", "json"):
        assert "json" in sys.modules, "what is loaded stays"
        with pytest.raises(ImportError):
            importlib.import_module("xdrlib_of_nobody")
    assert "xdrlib_of_nobody" not in sys.modules


def test_collecting_goes_on_after_a_start_that_failed() -> None:
    assert gc.isenabled()
    before = gc.get_freeze_count()
    start = leanstart.uncollected()
    start.__enter__()
    assert not gc.isenabled()
    assert not start.__exit__(ConfigError, ConfigError("x", []), None)
    assert gc.isenabled()
    assert gc.get_freeze_count() == before


def test_a_missing_key_is_one_clear_line(tmp_path: Path) -> None:
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


def test_a_candump_log_is_replayed_without_mf4(tmp_path: Path) -> None:
    (tmp_path / "x.log").write_text("(1.000000) can0 123#00\n")
    text = """
import sys
from gateway.cli import main
code = main(["replay", "x.log", "-o", "y.log"])
print([m for m in ("asammdf", "pandas", "pyarrow") if m in sys.modules], code)
"""
    assert program(tmp_path, text) == "[] 0"
