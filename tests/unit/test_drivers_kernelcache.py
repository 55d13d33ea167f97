"""Compiled code made ahead, read-only, incomplete, or with no place to be kept."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from pathlib import Path

import pytest

from gateway.drivers import kernelcache
from gateway.drivers.kernelcache import Kernels, count


def program(*words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "gateway", *words], capture_output=True, text=True, check=False,
        env={**os.environ, **environment},
    )  # fmt: skip


@pytest.mark.slow
def test_what_warm_made_is_used_and_what_is_missing_is_said(tmp_path: Path) -> None:
    kernels = tmp_path / "kernels"
    # One drive and one message set are enough, and half of the time.
    config = tmp_path / "train.toml"
    config.write_text("[[drive]]\nnode = 1\n")
    place = {"TMPDIR": str(tmp_path)}
    made = program("warm", str(config), "-o", str(kernels), **place)
    assert made.returncode == 0, made.stderr
    number = count(kernels)
    assert number > 20
    assert f"{number} kernels in {kernels}" in made.stdout
    start = ("run", "-v", "--quiet", "--config", str(config), "-i", "virtual", "-c", "kernels",
             "--duration", "0.05", "--kernels", str(kernels))  # fmt: skip
    ready = program(*start, **place)
    assert ready.returncode == 0, ready.stderr
    assert f"{number} kernels were ready" in ready.stderr
    assert "compiled" not in ready.stderr
    (one,) = kernels.rglob("*.decode_block-*.1.nbc")
    one.unlink()
    before = {path: path.stat().st_mtime_ns for path in kernels.rglob("*")}
    missing = program(*start, **place)
    assert missing.returncode == 0, missing.stderr
    assert f"of {number} kernels were compiled in this start" in missing.stderr
    assert {path: path.stat().st_mtime_ns for path in kernels.rglob("*")} == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["kernels", "train.toml"]


@pytest.fixture
def variable(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv(kernelcache.VARIABLE, "")
    monkeypatch.delenv(kernelcache.VARIABLE)
    monkeypatch.setattr(kernelcache.tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(kernelcache.atexit, "register", lambda *_, **__: None)


@pytest.mark.usefixtures("variable")
def test_where_numba_can_write_nothing_is_changed(caplog: pytest.LogCaptureFixture) -> None:
    Kernels().tell()
    assert kernelcache.VARIABLE not in os.environ
    assert not caplog.records


@pytest.mark.usefixtures("variable")
def test_without_a_place_a_temporary_one_is_used_and_said(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    monkeypatch.setattr(kernelcache.os, "access", lambda *_: False)
    kernels = Kernels()
    own = Path(os.environ[kernelcache.VARIABLE])
    assert own.parent == tmp_path
    assert "every start compiles" in caplog.text
    (own / "a").mkdir()
    (own / "a" / "f.1.nbc").touch()
    kernels.tell()
    assert "1 of 1 kernels were compiled in this start" in caplog.text


@pytest.mark.usefixtures("variable")
@pytest.mark.parametrize("kind", ["absent", "a file", "a file in it"])
def test_a_folder_that_is_none_is_said_and_survived(
    kind: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    prepared = tmp_path / "prepared"
    if kind == "a file":
        prepared.touch()
    elif kind == "a file in it":
        prepared.mkdir()
        (prepared / "README").touch()
    with caplog.at_level(logging.INFO):
        Kernels(prepared).tell()
    assert "cannot be used" in caplog.text
    assert str(prepared) in caplog.text
    assert Path(os.environ[kernelcache.VARIABLE]).is_dir()


def test_read_only_folders_are_copied_to_writable_ones(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv(kernelcache.VARIABLE, "")
    monkeypatch.setattr(kernelcache.tempfile, "tempdir", str(tmp_path))
    folder = tmp_path / "kernels" / "gateway_0123"
    folder.mkdir(parents=True)
    (folder / "f.1.nbc").write_bytes(b"code")
    (folder / "f.1.nbc").chmod(0o444)
    folder.chmod(0o555)
    with caplog.at_level(logging.INFO):
        Kernels(tmp_path / "kernels").tell()
    copy = Path(os.environ[kernelcache.VARIABLE]) / "gateway_0123"
    assert copy.stat().st_mode & 0o200
    assert (copy / "f.1.nbc").stat().st_mode & 0o200
    assert (copy / "f.1.nbc").read_bytes() == b"code"
    assert "1 kernels were ready" in caplog.text
    folder.chmod(0o755)
