"""The product speaks the field's words: names.md's are gone, and one name means one thing."""

import ast
import io
import re
import tokenize
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("dbc", "estimators", "gateway", "sim")
GONE = {
    "said", "told", "room", "heard", "believed", "lean", "stretch", "went", "doubt", "warmth",
    "heatside", "take", "tell",
}  # fmt: skip
THEIRS = {"take_along_axis", "tell"}
"""Names of NumPy and of files."""
PROTOCOLS = {
    "advance": "plants, and whatever goes on by periods",
    "run": "verbs of the command line, loops of ticks",
    "arguments": "verbs of the command line",
    "close": "whatever is open",
    "add": "whatever takes a log block by block: (self, block)",
    "link": "records that point to one another",
    "step": "whatever goes on by a tick",
    "fit": "methods that learn",
    "send": "buses and sockets",
    "line": "readers of logs, a line each",
    "head": "readers of logs, what a line says beside its data",
    "clock": "readers of logs, times of lines in a row",
}
"""Functions that many classes define: what they have in common."""
MOST = 6


def sources(*endings):
    for package in PACKAGES:
        for ending in endings:
            yield from sorted((ROOT / package).rglob(f"*{ending}"))


def identifiers(path):
    """Of Python or C, without comments and texts."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        tokens = tokenize.generate_tokens(io.StringIO(text).readline)
        return {token.string for token in tokens if token.type == tokenize.NAME}
    code = re.sub(r'"(?:\\.|[^"\\\n])*"|/\*.*?\*/|//[^\n]*', " ", text, flags=re.DOTALL)
    return set(re.findall(r"[A-Za-z_]\w*", code))


def gone(name):
    return bool(GONE & set(name.lower().strip("_").split("_"))) and name not in THEIRS


def test_no_identifier_is_a_private_word():
    found = {path.relative_to(ROOT).as_posix(): sorted(filter(gone, identifiers(path)))
             for path in sources(".py", ".c", ".h")}  # fmt: skip
    assert len(found) > 250
    assert not {path: names for path, names in found.items() if names}


@pytest.mark.parametrize("name", ["said", "_told_ns", "MAKE_ROOM", "take"])
def test_a_private_word_is_found(name):
    assert gone(name)


def test_no_function_name_stands_for_many_things():
    names = Counter(
        node.name
        for path in sources(".py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and not node.name.startswith("__")
    )
    often = {name for name, count in names.items() if count > MOST}
    assert often == set(PROTOCOLS)


def test_add_is_one_protocol():
    other = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path in sources(".py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef)
        and node.name == "add"
        and [argument.arg for argument in node.args.args] != ["self", "block"]
    ]
    assert not other, f"give it a verb of its own: {other}"


def private(path):
    """Private names that it imports from the product, and names of the product that it patches."""
    text = path.read_text(encoding="utf-8")
    product = "|".join(PACKAGES)
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in PACKAGES:
            names = [*node.module.split("."), *(alias.name for alias in node.names)]
            yield from (name for name in names if name.startswith("_"))
    yield from re.findall(rf'\bsetattr\(\s*f?"((?:{product})\.[\w.{{}}]+)"', text)


def test_few_tests_know_private_names_or_patch_by_a_text():
    found = {path.name for path in (ROOT / "tests").rglob("*.py") if [*private(path)]}
    assert "test_fleet.py" in found
    assert len(found) <= 10, sorted(found)
