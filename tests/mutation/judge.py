"""Runs the tests of a part against each of its mutants, one at a time.

    python -m tests.mutation.judge doubt doubt.mutants doubt.jsonl

Everything is imported once. Each mutant is a fork that forgets the mutated module and whatever
imports it, reads the mutant in its place, and runs the tests until one fails: those first that have
found the last ones, then the quickest, as the run with nothing changed has measured them. That run
must pass, and so must a module that is read in its own place: what cannot run finds every mutant.
Nothing on disk is changed. Goes on where it was stopped. A mutant that takes longer than a minute
is found, as `timeout`; one that cannot behave otherwise is `none`, and nothing is run.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import json
import os
import re
import signal
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import pytest
from hypothesis import Phase, settings

PARTS = Path(__file__).with_name("parts.toml")
OURS = ("dbc", "estimators", "gateway", "sim", "tests")
LIMIT_S = 60
SAME = re.compile(r"Comparison\w*_(Is|Eq|IsNot|NotEq)_(Is|Eq|IsNot|NotEq)$")
WORDS = re.compile(r"\b(Flag|Profile|SmState|Check|Reason|evidence|flag|found)\b")


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


@functools.cache
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
    """Quickest first; what each test takes. An example that fails is not made small."""

    def __init__(self, took: dict[str, float]) -> None:
        self.known, self.took, self.failed = took, dict[str, float](), ""

    def pytest_configure(self) -> None:
        phases = (Phase.explicit, Phase.generate)
        settings.register_profile("judge", settings.get_profile("gate"), phases=phases)
        settings.load_profile("judge")

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items.sort(key=lambda item: self.known.get(item.nodeid, 0.0))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.took[report.nodeid] = self.took.get(report.nodeid, 0.0) + report.duration
        if report.failed:
            self.failed = report.nodeid


def run(tests: list[str], took: dict[str, float]) -> tuple[int, Order]:
    """Exit code of the tests (and options of pytest), and what was seen of each."""
    order = Order(took)
    # A warning of an overflow finds nothing.
    options = ["-x", "-q", "--assert=plain", "-W", "ignore::RuntimeWarning", "-o", "timeout=0"]
    options += ["-p", "no:cacheprovider", "-p", "no:xdist"]
    code = pytest.main([*options, *tests], plugins=[order])
    return int(code), order


def forked(limit_s: float, work: Callable[[], tuple[int, Order]]) -> tuple[str, dict[str, Any]]:
    """Outcome of `work` in a process of its own, and what it has seen."""
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
            code, order = work()
            said = {"took": order.took, "failed": order.failed}
            os.write(theirs, json.dumps(said).encode()[:60_000])
        os._exit(code)
    os.close(theirs)
    end = time.monotonic() + limit_s
    while time.monotonic() < end:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            with os.fdopen(ours, "rb") as pipe:
                said = json.loads(pipe.read() or "{}")
            outcomes = {0: "survived", 99: "error"}
            return outcomes.get(os.waitstatus_to_exitcode(status), "killed"), said
        time.sleep(0.02)
    os.killpg(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    os.close(ours)
    return "timeout", {}


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


def equivalent(mutant: dict[str, Any], source: str) -> bool:
    """Whether a mutant cannot behave otherwise.

    An annotation; `is` for `==` between members of an enumeration.
    """
    turned = SAME.search(mutant["operator"])
    if turned and ("Not" in turned[1]) == ("Not" in turned[2]):
        return bool(WORDS.search(mutant["before"]))
    try:
        return bare(mutant["code"]) == bare(source)
    except SyntaxError:
        return False


def judged(target: str, path: str, code: str, tests: list[str], took: dict[str, float]) -> str:
    """What becomes of one mutant. A test that has found one is the first for the next."""
    try:
        compiled = compile(code, str(Path(path).resolve()), "exec")
    except SyntaxError:
        return "killed"

    forgotten = above(target)

    def work() -> tuple[int, Order]:
        for name in forgotten:
            sys.modules.pop(name, None)
            package, _, own = name.rpartition(".")
            if package in sys.modules:
                sys.modules[package].__dict__.pop(own, None)
        sys.meta_path.insert(0, Instead(target, compiled))
        return run(tests, took)

    outcome, said = forked(LIMIT_S, work)
    if said.get("failed"):
        took[said["failed"]] = min(took.values()) - 1.0
    return outcome


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
    took: dict[str, float] = said["took"]
    for path in asked["modules"]:
        if judged(named(path), path, Path(path).read_text(), tests, took) != "survived":
            print(f"{part}: the tests do not pass with {path} in its own place")
            return 1
    print(f"{part}: the tests take {sum(took.values()):.1f} s", flush=True)
    done = set()
    if result.exists():
        done = {json.loads(line)["number"] for line in result.read_text().splitlines()}
    with result.open("a") as out:
        for mutant in mutants(source):
            if mutant["number"] in done:
                continue
            path, begun = mutant["module"], time.monotonic()
            if equivalent(mutant, Path(path).read_text()):
                mutant["outcome"] = "none"
            else:
                mutant["outcome"] = judged(named(path), path, mutant["code"], tests, took)
            del mutant["code"]
            mutant["seconds"] = round(time.monotonic() - begun, 1)
            print(json.dumps(mutant), file=out, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
