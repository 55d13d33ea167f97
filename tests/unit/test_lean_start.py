"""What a start does not load: cryptography is for those who have a key, MF4 for who reads logs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

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


def test_run_loads_nothing_for_mf4(tmp_path: Path) -> None:
    heavy = "[m for m in ('asammdf', 'pandas', 'pyarrow') if m in sys.modules]"
    code = RUN.replace('"cryptography" in sys.modules', f"'can' in sys.modules, {heavy}")
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    assert done.stdout.splitlines()[-1] == "True [] 0"


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
