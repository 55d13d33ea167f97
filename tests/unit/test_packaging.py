"""The package outside of the repository: everything that it needs is inside, everything works."""

import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import zipfile
from importlib import metadata
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[2]
PACKAGES = ("dbc", "estimators", "gateway", "sim")
BUILD = (
    "import sys; sys.path.insert(0, ''); import core_build;"
    "getattr(core_build, f'build_{sys.argv[1]}')(sys.argv[2])"
)
HERE = f"import {', '.join(PACKAGES)}; print([p.__path__[0] for p in ({', '.join(PACKAGES)})])"


def called(*words, cwd, **environment):
    """What it says on stdout. Nothing of this process's paths is handed on."""
    kept = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run(
        words, cwd=cwd, env={**kept, **environment}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{words}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """(sdist, wheel); the wheel is made of the sdist alone."""
    here = tmp_path_factory.mktemp("built")
    source, out = here / "source", here / "out"
    out.mkdir()
    junk = shutil.ignore_patterns(
        "__pycache__", "*.egg-info", ".venv", ".git", "out", "build", "dist", ".*_cache",
        ".hypothesis", "*.so",
    )  # fmt: skip
    shutil.copytree(ROOT, source, ignore=junk)
    called(sys.executable, "-c", BUILD, "sdist", str(out), cwd=source)
    (sdist,) = out.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        archive.extractall(here / "unpacked", filter="data")
    (unpacked,) = (here / "unpacked").iterdir()
    called(sys.executable, "-c", BUILD, "wheel", str(out), cwd=unpacked, CORE_FLAGS="-O1")
    (wheel,) = out.glob("*.whl")
    return sdist, wheel


@pytest.fixture(scope="module")
def installed(built, tmp_path_factory):
    """Programs of an environment that has the wheel, and the locked dependencies on its path."""
    venv = tmp_path_factory.mktemp("environment") / "venv"
    called(sys.executable, "-m", "venv", "--without-pip", str(venv), cwd=venv.parent)
    python = str(venv / "bin" / "python")
    called(sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps",
           "--no-index", "--disable-pip-version-check", str(built[1]), cwd=venv.parent)  # fmt: skip
    (site,) = (venv / "lib").glob("python*/site-packages")
    # A path only: what the environment of these tests adds to its own path stays out.
    (site / "locked.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return venv / "bin"


def test_the_wheel_has_everything_that_the_packages_have(built):
    wanted = {
        str(path.relative_to(ROOT))
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
        if path.suffix not in (".c", ".h") or path.parent.name == "guest"
    }
    examples = ROOT / "examples"
    wanted |= {
        f"gateway/examples/{path.relative_to(examples)}"
        for path in examples.rglob("*") if path.is_file() and "__pycache__" not in path.parts
    }  # fmt: skip
    with zipfile.ZipFile(built[1]) as archive:
        names = {name for name in archive.namelist() if ".dist-info/" not in name}
    assert names == wanted | {"_traction_core.abi3.so"}
    assert built[1].name.endswith(f"-cp311-abi3-linux_{os.uname().machine}.whl")
    assert {"dbc/traction_fd.dbc", "sim/inverter.eds", "sim/scenarios/release.toml"} <= names


def test_the_sdist_has_what_a_packager_needs(built):
    with tarfile.open(built[0]) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {
        "LICENSE", "README.md", "CHANGELOG.md", "CONTRIBUTING.md", "Makefile", "requirements.lock",
        "requirements-demo.lock", "core_build.py", "dbc/e2e.c", "gateway/core/records.h",
        "docs/deploy.md",
        "examples/train.toml", "tests/unit/test_packaging.py",
        "tests/golden/loss.log.gz",
    } <= names  # fmt: skip
    assert not [name for name in names if name.endswith((".pyc", ".so"))]


def test_it_runs_from_an_empty_folder(installed, tmp_path):
    program = str(installed / "traction-gateway")
    paths = called(str(installed / "python"), "-c", HERE, cwd=tmp_path)
    assert paths.count(str(installed.parent)) == len(PACKAGES)
    version = called(program, "--version", cwd=tmp_path).strip()
    assert version == f"traction-gateway {metadata.version('traction-gateway')}"
    (tmp_path / "train.toml").write_text('[dbc]\nfile = "traction_fd.dbc"\n')
    assert "configuration" in called(program, "check", "train.toml", "--no-timing", cwd=tmp_path)
    called(program, "examples", "-o", "examples", cwd=tmp_path)
    assert "configuration" in called(program, "check", "examples/train.toml",
                                     "--no-timing", cwd=tmp_path)  # fmt: skip
    called(program, "sim", "release", "-o", "a.log", "--duration", "3", "--truth", "t.csv",
           cwd=tmp_path)  # fmt: skip
    said = called(program, "replay", "a.log", "--results", "r", "--truth", "t.csv", cwd=tmp_path)
    assert "AdhesionLost" in said
    text = (tmp_path / "r" / "report.md").read_text()
    assert "commit" not in text, "an installed package does not know one"
    assert "1 of 1 event found" in text
    assert called(program, "hil", "silent", cwd=tmp_path).startswith("ok  ")
    called(program, "demo", "--headless", "--duration", "5", "-o", "demo.png", cwd=tmp_path)
    assert (tmp_path / "demo.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.thorough
def test_uninstalling_leaves_nothing_behind(built, tmp_path):
    """Neither files nor folders; the program has run once before."""
    venv = tmp_path / "venv"
    called(sys.executable, "-m", "venv", "--without-pip", str(venv), cwd=tmp_path)
    python = str(venv / "bin" / "python")
    (site,) = (venv / "lib").glob("python*/site-packages")
    (site / "locked.pth").write_text(sysconfig.get_path("purelib") + "\n")
    before = {path for path in venv.rglob("*") if "__pycache__" not in path.parts}
    pip = (sys.executable, "-m", "pip", "--python", python)
    called(*pip, "install", "--quiet", "--no-deps", "--no-index", "--disable-pip-version-check",
           str(built[1]), cwd=tmp_path)  # fmt: skip
    called(str(venv / "bin" / "traction-gateway"), "sim", "release", "-o", "a.log",
           "--duration", "1", cwd=tmp_path)  # fmt: skip
    called(*pip, "uninstall", "--quiet", "--yes", "traction-gateway", cwd=tmp_path)
    after = {path for path in venv.rglob("*") if "__pycache__" not in path.parts}
    assert after == before


def test_what_it_asks_for_is_what_is_locked(built):
    """The wheel's own words, read as pip reads them."""
    with zipfile.ZipFile(built[1]) as archive:
        (name,) = [n for n in archive.namelist() if n.endswith(".dist-info/METADATA")]
        said = archive.read(name).decode()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    asked = [line.partition(": ")[2] for line in said.splitlines() if line.startswith("Requires-D")]
    plain = [line for line in asked if "extra ==" not in line]
    assert len(plain) == len(project["dependencies"])
    extras = {line.partition(": ")[2] for line in said.splitlines()
              if line.startswith("Provides-Extra")}  # fmt: skip
    assert extras == set(project["optional-dependencies"])
    for lock in ("requirements.lock", "requirements-demo.lock"):
        missing = [line for line in plain if _name(line) not in _pins(lock)]
        assert not missing, json.dumps(missing)


def test_what_the_demo_needs_is_locked_as_for_the_tests():
    """Same versions, and far fewer of them: `make demo` installs no tools."""
    few, all_of_them = _pins("requirements-demo.lock"), _pins("requirements.lock")
    assert few.items() <= all_of_them.items()
    assert not {"pytest", "mypy", "mkdocs", "numba"} & few.keys()


def _pins(lock):
    """Versions by name."""
    text = (ROOT / lock).read_text().lower().replace("_", "-")
    return dict(re.findall(r"^([\w.-]+)(?:\[[^\]]*\])?==(\S+)", text, re.MULTILINE))


def _name(requirement):
    end = next(k for k, c in enumerate(requirement + " ") if not (c.isalnum() or c in "-_."))
    return requirement[:end].lower().replace("_", "-")
