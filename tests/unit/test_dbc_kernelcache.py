"""Old machine code never runs: what a kernel was compiled from, and whether its file is whole."""

from __future__ import annotations

import ast
import importlib
import os
import pkgutil
import shutil
import subprocess
import sys
from collections import namedtuple
from pathlib import Path

import numba
import pytest
from numba.core.caching import NullCache
from numba.core.registry import CPUDispatcher

from dbc import _kernelcache
from dbc._kernelcache import PRODUCT, KernelCache, Settings

ROOT = Path(_kernelcache.__file__).parents[1]
KERNELS = """
from dbc._kernelcache import njit
from toy import helpers
from toy.helpers import (
    OFFSET,  # a comment
)


@njit(cache=True)
def total(x):
    return helpers.twice(x) + OFFSET
"""
HELPERS = """
from dbc._kernelcache import njit
from toy.deep import FACTOR

OFFSET = {offset}


@njit(cache=True)
def twice(x):
    return {factor} * x
"""
ASK = """
from toy.kernels import total
from dbc._kernelcache import Settings
print(total(10), Settings.compiled, Settings.lost)
"""


class Toy:
    """A package of three modules that kernels are compiled from, as if in new processes."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.package = folder, folder / "toy"
        self.package.mkdir(parents=True)
        self.write()

    def write(self, offset: str = "1", factor: str = "FACTOR", deep: str = "2") -> None:
        """Every file is as old as before."""
        texts = {"__init__": "", "kernels": KERNELS, "deep": f"FACTOR = {deep}\n",
                 "helpers": HELPERS.format(offset=offset, factor=factor)}  # fmt: skip
        for name, text in texts.items():
            (self.package / f"{name}.py").write_text(text)
            os.utime(self.package / f"{name}.py", (1e9, 1e9))

    def ask(self, *given: object) -> tuple[int, int, int]:
        """What the kernel says, how many functions were compiled, how many not kept."""
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, "path", [str(self.folder), *sys.path])
            patch.setattr(sys, "dont_write_bytecode", True)
            for name in [name for name in sys.modules if name.partition(".")[0] == "toy"]:
                del sys.modules[name]
            for found in (_kernelcache.stamp, _kernelcache.sources, _kernelcache._source,
                          _kernelcache._folder, _kernelcache._say):  # fmt: skip
                found.cache_clear()
            importlib.invalidate_caches()
            before = Settings.compiled, Settings.lost
            answer = importlib.import_module("toy.kernels").total(*(given or (10,)))
            return int(answer), Settings.compiled - before[0], Settings.lost - before[1]

    def files(self) -> list[Path]:
        return sorted(self.folder.rglob("*.nbc"))


@pytest.fixture
def toy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Toy:
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    return Toy(tmp_path / "site")


@pytest.mark.parametrize(
    ("change", "answer"),
    [({"offset": "7"}, 27), ({"factor": "(4)   "}, 41), ({"deep": "5"}, 51)],
    ids=["constant", "function", "constant of a helper of a helper"],
)
def test_an_upgrade_of_another_module_arrives(
    toy: Toy, change: dict[str, str], answer: int
) -> None:
    """Two versions in one place, which differ in one helper; and nothing of the old one stays."""
    assert toy.ask() == (21, 2, 0)
    assert toy.ask() == (21, 0, 0)
    toy.write(**change)
    assert toy.ask() == (answer, 2, 0)
    assert toy.ask() == (answer, 0, 0)
    assert len(toy.files()) == 2


def test_in_new_processes_too(toy: Toy) -> None:
    def ask(**environment: str) -> str:
        paths = os.pathsep.join([str(toy.folder), *filter(None, sys.path)])
        given = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1", "PYTHONPATH": paths, **environment}
        return subprocess.run([sys.executable, "-c", ASK], capture_output=True, text=True,
                              env=given, check=True).stdout  # fmt: skip

    assert ask() == "21 2 0\n"
    toy.write(deep="5")
    assert ask() == "51 2 0\n"
    assert ask() == "51 0 0\n"
    assert ask(NUMBA_DISABLE_JIT="1") == "51 0 0\n"


@pytest.mark.parametrize("place", ["beside", "named", "home"])
def test_two_versions_side_by_side_never_share(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    one, two = Toy(tmp_path / "one"), Toy(tmp_path / "two")
    two.write(deep="5")
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "c") if place == "named" else "")
    if place == "home":
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "c"))
        for toy in (one, two):
            (toy.package / "__pycache__").touch()  # no folder can be made there
    for toy, answer in [(one, 21), (two, 51)]:
        assert toy.ask() == (answer, 2, 0)
    for toy, answer in [(one, 21), (two, 51)]:
        assert toy.ask() == (answer, 0, 0)
    kept = len(list((tmp_path / "c").rglob("*.nbc")))
    assert kept == (0 if place == "beside" else 4)


@pytest.mark.parametrize("damage", ["empty", "cut", "garbage", "one bit", "another's", "a folder"])
def test_a_damaged_file_is_compiled_anew(toy: Toy, damage: str) -> None:
    toy.ask()
    helper, kernel = toy.files()
    whole = kernel.read_bytes()
    if damage == "a folder":
        kernel.unlink()
        kernel.mkdir()
    else:
        kernel.write_bytes({
            "empty": b"", "cut": whole[: len(whole) // 2], "garbage": b"\x80\x04garbage." * 999,
            "one bit": whole[:-700] + bytes([whole[-700] ^ 1]) + whole[-699:],
            "another's": helper.read_bytes(),
        }[damage])  # fmt: skip
    kept = damage != "a folder"
    assert toy.ask() == (21, 1, not kept)
    assert toy.ask() == (21, not kept, not kept)


def test_fields_of_a_named_tuple_in_another_order_are_other_code(toy: Toy) -> None:
    """Who takes a tuple need not import the module that makes it."""
    kernel = "from dbc._kernelcache import njit\n@njit(cache=True)\ndef total(p):\n    return p.a\n"
    (toy.package / "kernels.py").write_text(kernel)
    for order, answer in (("ab", 3), ("ba", 4)):
        assert toy.ask(namedtuple("Pair", tuple(order))(3, 4)) == (answer, 1, 0)


def test_what_cannot_be_kept_is_compiled_in_memory_and_said_once(
    toy: Toy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (toy.package / "__pycache__").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(toy.package / "__init__.py"))
    assert toy.ask() == (21, 2, 2)
    assert caplog.text.count("every start compiles") == len(caplog.records) == 1


def test_a_full_disk_is_no_reason_to_die(
    toy: Toy, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(path: Path, data: bytes) -> int:
        path.touch()
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", full)
        assert toy.ask() == (21, 2, 2)
    assert caplog.text.count("No space left on device") == 1
    assert toy.ask() == (21, 2, 0)
    assert not list(toy.folder.rglob("*.tmp.*"))


def test_every_kernel_of_the_product_is_kept_so() -> None:
    """A kernel that numba itself keeps would not notice a changed helper."""
    found = set()
    for package in map(importlib.import_module, PRODUCT):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            text = Path(module.module_finder.path, f"{module.name.rpartition('.')[2]}.py")  # type: ignore[union-attr]
            if module.ispkg or not any(w in text.read_text() for w in ("njit", "_lean")):
                continue
            for value in vars(importlib.import_module(module.name)).values():
                if isinstance(value, CPUDispatcher):
                    found.add(value)
    kept = [one for one in found if not isinstance(one._cache, NullCache)]
    assert kept
    assert [one for one in kept if not isinstance(one._cache, KernelCache)] == []


def imported(root: Path, module: str) -> set[str]:
    """Modules of the product that a module imports, directly or not: by Python's own grammar."""
    found: set[str] = set()
    left = [module]
    while left:
        name = left.pop()
        file = root.joinpath(*name.split(".")).with_suffix(".py")
        file = file if file.is_file() else file.with_suffix("") / "__init__.py"
        if name in found or name.partition(".")[0] not in PRODUCT or not file.is_file():
            continue
        found.add(name)
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                left += [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{name}: relative imports are not followed"
                left += [f"{node.module}", *(f"{node.module}.{one.name}" for one in node.names)]
    return found


@pytest.mark.parametrize(
    "module",
    ["dbc._e2e_kernels", "gateway._outbox_kernels", "gateway._flags_kernels", "sim._kernels"],
)
def test_a_real_kernel_is_stamped_by_all_that_it_imports_and_nothing_else(
    module: str, tmp_path: Path
) -> None:
    for package in PRODUCT:
        left = shutil.ignore_patterns("__pycache__", "static")
        shutil.copytree(ROOT / package, tmp_path / package, ignore=left)

    def file(name: str) -> Path:
        path = tmp_path.joinpath(*name.split("."))
        module = path.with_suffix(".py")
        return module if module.exists() else path / "__init__.py"

    def stamped() -> bytes | None:
        for found in (_kernelcache.stamp, _kernelcache.sources, _kernelcache._source):
            found.cache_clear()
        return _kernelcache.stamp(module, str(file(module)))

    before, mine = stamped(), imported(tmp_path, module)
    assert before is not None
    others = {
        "dbc._candump_kernels",
        "estimators.maisd",
        "gateway._ticks_kernels",
        "sim.plant",
    } - mine
    for name in mine | others:
        text = file(name).read_text()
        file(name).write_text(text + "# changed\n")
        assert (stamped() != before) == (name in mine), name
        file(name).write_text(text)
    assert stamped() == before
