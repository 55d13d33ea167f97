"""Runs the tests of a part against each of its mutants, one at a time.

    NUMBA_DISABLE_JIT=1 python -m tests.mutation.judge said said.mutants said.jsonl

Everything is imported once. Each mutant is a fork that forgets the mutated module and whatever
imports it, reads the mutant in its place, and runs the tests until one fails: the quickest first,
as the run with nothing changed has measured them. That run must pass: a test that cannot run finds
every mutant. Nothing on disk is changed. Goes on where it was stopped; a mutant that takes longer
than a minute is found, as `timeout`; one of an annotation is none, and nothing is run.
"""

from __future__ import annotations

import ast
import contextlib
import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import json
import os
import signal
import sys
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import pytest

PARTS = Path(__file__).with_name("parts.toml")
OURS = ("dbc", "estimators", "gateway", "sim", "tests")
LIMIT_S = 60


def named(path: str) -> str:
    """Module of a file."""
    return path.removesuffix(".py").replace("/", ".")


def imports(module: ModuleType) -> set[str]:
    """What a module of ours imports when it runs."""
    path = getattr(module, "__file__", None)
    if path is None:
        return set()
    found = set()
    todo: list[ast.AST] = [ast.parse(Path(path).read_text())]
    while todo:
        node = todo.pop()
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            continue
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        todo += ast.iter_child_nodes(node)
    return found


def above(target: str) -> set[str]:
    """The target and every module of ours that imports it, or one that does."""
    mine = {name: module for name, module in sys.modules.items() if name.split(".")[0] in OURS}
    needs = {name: imports(module) for name, module in mine.items()}
    found: set[str] = set()
    new = {target}
    while new:
        found |= new
        new = {name for name, needed in needs.items() if needed & found} - found
    return found


class Instead(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Gives one module another content."""

    def __init__(self, target: str, code: CodeType) -> None:
        self.target, self.code = target, code

    def find_spec(self, name: str, *_: Any) -> importlib.machinery.ModuleSpec | None:
        if name != self.target:
            return None
        return importlib.util.spec_from_loader(name, self, origin=self.code.co_filename)

    def exec_module(self, module: ModuleType) -> None:
        module.__file__ = self.code.co_filename
        exec(self.code, module.__dict__)


class Order:
    """Quickest first; what each test takes."""

    def __init__(self, took: dict[str, float]) -> None:
        self.known, self.took = took, dict[str, float]()

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items.sort(key=lambda item: self.known.get(item.nodeid, 0.0))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.took[report.nodeid] = self.took.get(report.nodeid, 0.0) + report.duration


def run(tests: list[str], took: dict[str, float]) -> tuple[int, dict[str, float]]:
    """Exit code of the tests (and options of pytest), and what each took."""
    order = Order(took)
    # A warning of an overflow finds nothing: compiled code has none.
    options = ["-x", "-q", "--assert=plain", "-W", "ignore::RuntimeWarning", "-o", "timeout=0"]
    options += ["-p", "no:cacheprovider", "-p", "no:xdist"]
    code = pytest.main([*options, *tests], plugins=[order])
    return int(code), order.took


def forked(limit_s: float, work: Any) -> tuple[str, str]:
    """Outcome of `work` in a process of its own, and what it said."""
    ours, theirs = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.setpgid(0, 0)
        os.close(ours)
        null = os.open(os.devnull, os.O_RDWR)
        for fd in (0, 1, 2):
            os.dup2(null, fd)
        code = 99
        with contextlib.suppress(BaseException):
            code, said = work()
            os.write(theirs, json.dumps(said).encode()[:60_000])
        os._exit(code)
    os.close(theirs)
    end = time.monotonic() + limit_s
    while time.monotonic() < end:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            with os.fdopen(ours, "rb") as pipe:
                said = pipe.read().decode()
            return {0: "survived"}.get(os.waitstatus_to_exitcode(status), "killed"), said
        time.sleep(0.02)
    os.killpg(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    os.close(ours)
    return "timeout", ""


class Bare(ast.NodeTransformer):
    """Without annotations: `from __future__ import annotations` keeps them from being evaluated."""

    def visit_arg(self, node: ast.arg) -> ast.arg:
        node.annotation = None
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        node.returns = None
        self.generic_visit(node)
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AnnAssign:
        node.annotation = ast.Constant(None)
        return node


def bare(code: str) -> str:
    """What a file does, as text."""
    return ast.dump(Bare().visit(ast.parse(code)))


def judged(target: str, path: str, code: str, tests: list[str], took: dict[str, float]) -> str:
    """What becomes of one mutant."""
    try:
        compiled = compile(code, str(Path(path).resolve()), "exec")
    except SyntaxError:
        return "killed"
    if bare(code) == bare(Path(path).read_text()):
        return "none"

    def work() -> tuple[int, dict[str, float]]:
        for name in above(target):
            sys.modules.pop(name, None)
            package, _, own = name.rpartition(".")
            if package in sys.modules:
                sys.modules[package].__dict__.pop(own, None)
        sys.meta_path.insert(0, Instead(target, compiled))
        return run(tests, took)[0], {}

    return forked(LIMIT_S, work)[0]


def changed(before: str, after: str) -> tuple[str, str]:
    """The first line that differs, in both."""
    old, new = before.splitlines(), after.splitlines()
    at = next((k for k, (x, y) in enumerate(zip(old, new, strict=False)) if x != y), len(new) - 1)
    return old[at].strip(), new[at].strip()


def mutants(path: Path) -> Iterator[dict[str, Any]]:
    """Those of a file of `mutants.py`, with the line before and after."""
    sources: dict[str, str] = {}
    with path.open() as lines:
        for number, line in enumerate(lines):
            mutant = json.loads(line)
            source = sources.setdefault(mutant["module"], Path(mutant["module"]).read_text())
            mutant["number"] = number
            mutant["before"], mutant["after"] = changed(source, mutant["code"])
            yield mutant


def main() -> int:
    """Judge what is not judged yet."""
    part, source, result = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
    asked = tomllib.loads(PARTS.read_text())[part]
    for test in asked["tests"]:
        importlib.import_module(named(test))
    tests = [*asked["tests"], "-k", asked.get("only", "")]
    outcome, said = forked(600.0, lambda: run(tests, {}))
    if outcome != "survived":
        print(f"{part}: the tests do not pass with nothing changed")
        return 1
    took = json.loads(said)
    print(f"{part}: the tests take {sum(took.values()):.1f} s", flush=True)
    done = set()
    if result.exists():
        done = {json.loads(line)["number"] for line in result.read_text().splitlines()}
    with result.open("a") as out:
        for mutant in mutants(source):
            if mutant["number"] in done:
                continue
            code = mutant.pop("code")
            begun = time.monotonic()
            mutant["outcome"] = judged(named(mutant["module"]), mutant["module"], code, tests, took)
            mutant["seconds"] = round(time.monotonic() - begun, 1)
            print(json.dumps(mutant), file=out, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
