"""Compiled code made ahead: of this program or refused, read-only, incomplete, damaged."""

from __future__ import annotations

import argparse
import logging
import os
import subprocess
import sys
from pathlib import Path

import pytest

from dbc._kernelcache import Settings
from gateway.commands import warm
from gateway.config import ConfigError
from gateway.drivers.kernelcache import count, identity, make, tell, use

NO_TEMPORARY = """
import sys, tempfile
tempfile._candidate_tempdir_list = lambda: ["/nonexistent"]
from gateway.cli import main
sys.exit(main(sys.argv[1:]))
"""


def program(*words: str, start: tuple[str, ...] = ("-m", "gateway")) -> tuple[int, str, str]:
    done = subprocess.run(
        [sys.executable, *start, *words], capture_output=True, text=True, check=False,
    )  # fmt: skip
    return done.returncode, done.stdout, done.stderr


@pytest.mark.slow
def test_what_warm_made_is_used_and_what_is_missing_or_damaged_is_said(tmp_path: Path) -> None:
    kernels = tmp_path / "kernels"
    # One drive and one message set are enough, and half of the time.
    config = tmp_path / "train.toml"
    config.write_text("[[drive]]\nnode = 1\n")
    code, said, errors = program("warm", str(config), "-o", str(kernels))
    assert code == 0, errors
    number = count(kernels)
    assert number > 20
    assert f"{number} kernels in {kernels}" in said
    run = ("run", "-v", "--quiet", "--config", str(config), "-i", "virtual", "-c", "kernels",
             "--duration", "0.05", "--kernels", str(kernels))  # fmt: skip
    # Nothing is copied, so a full or missing folder for temporary files stops nobody.
    code, _, errors = program(*run, start=("-c", NO_TEMPORARY))
    assert code == 0, errors
    assert f"{number} kernels were ready" in errors
    assert "compiled" not in errors
    (one,) = kernels.rglob("*.fill_inputs.*.nbc")
    one.write_bytes(one.read_bytes()[:1000])
    (two,) = kernels.rglob("*.send.*.nbc")
    two.unlink()
    before = {path: path.stat().st_mtime_ns for path in kernels.rglob("*")}
    code, _, errors = program(*run)
    assert code == 0, errors
    assert "2 kernels were compiled in this start" in errors
    assert {path: path.stat().st_mtime_ns for path in kernels.rglob("*")} == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["kernels", "train.toml"]


@pytest.mark.parametrize("kind", ["absent", "a file", "empty", "another program's"])
def test_run_refuses_other_kernels_in_one_line_that_says_what_to_do(
    kind: str, tmp_path: Path
) -> None:
    kernels = tmp_path / "kernels"
    if kind == "a file":
        kernels.touch()
    elif kind != "absent":
        kernels.mkdir()
    if kind == "another program's":
        (kernels / "0123456789abcdef").mkdir()
    code, said, errors = program("run", "-i", "virtual", "-c", "x", "--duration", "0.05",
                                 "--kernels", str(kernels))  # fmt: skip
    assert code == 2
    assert not said
    assert len(errors.splitlines()) == 1
    assert f"traction-gateway warm -o {kernels}" in errors
    if kind == "another program's":
        assert "0123456789abcdef" in errors


@pytest.fixture
def settings(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("folder", "write", "compiled", "lost"):
        monkeypatch.setattr(Settings, name, getattr(Settings, name))


@pytest.mark.usefixtures("settings")
def test_a_program_finds_what_it_made_and_no_other_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    place = make(tmp_path)
    (place / "f.nbc").touch()
    use(tmp_path)
    Settings.compiled = 0
    with caplog.at_level(logging.INFO):
        tell()
    assert "1 kernels were ready" in caplog.text
    monkeypatch.setattr("dbc._kernelcache.VERSIONS", "of tomorrow")
    with pytest.raises(ConfigError, match=place.name):
        use(tmp_path)


@pytest.mark.parametrize("what", ["VERSIONS", "sources", "processor"])
def test_the_name_of_a_folder_depends_on(what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    before = identity()
    assert before == identity()
    if what == "processor":
        asked = "import gateway.drivers.kernelcache as k; print(k.identity())"
        other = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
        after = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True,
                               check=True, env={**os.environ, **other}).stdout.strip()  # fmt: skip
    else:
        other_one = "0" if what == "VERSIONS" else lambda root, top: {top: __file__}
        monkeypatch.setattr(f"dbc._kernelcache.{what}", other_one)
        after = identity()
    assert len(after) == len(before) == 16
    assert after != before


@pytest.mark.usefixtures("settings")
def test_old_programs_do_not_pile_up_and_nothing_else_is_deleted(tmp_path: Path) -> None:
    for n in range(5):
        (tmp_path / f"{n:016x}").mkdir()
        os.utime(tmp_path / f"{n:016x}", (n, n))
    (tmp_path / "notes").mkdir()
    mine = make(tmp_path).name
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {"notes", mine, f"{3:016x}", f"{4:016x}"}


@pytest.mark.usefixtures("settings")
def test_warm_fails_where_it_could_not_keep_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def lose(*_: object) -> None:
        Settings.lost += 1

    monkeypatch.setattr("gateway.drivers.warm.warm_up", lose)
    assert warm.run(argparse.Namespace(config=[], kernels=tmp_path)) == 2
    assert "2 kernels could not be kept" in capsys.readouterr().out
