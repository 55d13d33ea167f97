"""Prose linter: proselint on the pages, and a style of our own (`python -m tests.docs.prose`).

The style: at most `SHORT` words between two stops on a page that a visitor reads, `LONG` elsewhere;
and none of `PRIVATE`, words and turns that stand for a term of the field. Of docstrings and
comments of the product only these words are checked.
"""

import ast
import io
import re
import sys
import tokenize
from pathlib import Path

from proselint.checks import __register__ as theirs
from proselint.registry import CheckRegistry
from proselint.registry.checks import Check, CheckResult
from proselint.registry.checks.types import Existence
from proselint.tools import LintFile

ROOT = Path(__file__).parents[2]
SHORT, LONG = 25, 40
PRIVATE = (
    r"(?:for|of|by|to|with) who", r"who asks?", r"(?:is|are) (?:said|told)", r"doubts", r"hears?",
    r"(?:that|which|what) (?:is|are) none", r"heard", r"believes?", r"believed",
)  # fmt: skip
"""Regular expressions, in any case of letters."""
ERRORS = (
    "archaism", "lexical_illusions", "malapropisms", "needless_variants", "nonwords", "oxymorons",
    "redundancy", "uncomparables", "weasel_words",
)  # fmt: skip
"""Those checks of proselint that find errors, not taste."""
PRODUCT = ("dbc", "estimators", "gateway", "sim")
STOP = re.compile(r"[.!?:;](?=[*_)]*(?:\s|$))|\n\s*\n|\n\s*(?:[-*+]|\d+\.)\s")
WORD = re.compile(r"[A-Za-z][\w'-]*")


def pages():
    """Path of each page, and how many words it may have between two stops.

    Without docs/reference: it is made of docstrings, which are checked as such.
    """
    for path in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(ROOT.glob("docs/**/*.md"))):
        if path.parent.name == "reference":
            continue
        short = path.parent == ROOT or path.parent.name == "tutorials"
        yield path, SHORT if short else LONG


def explanations(path):
    """Docstrings and comments of a source, each in its lines; empty lines for the code."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        found = [(token.start[0], token.string)
                 for token in tokenize.generate_tokens(io.StringIO(text).readline)
                 if token.type == tokenize.COMMENT]  # fmt: skip
        found += [(node.lineno, node.value.value) for node in ast.walk(ast.parse(text))
                  if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
                  and isinstance(node.value.value, str)]  # fmt: skip
    else:
        found = [(text.count("\n", 0, one.start()) + 1, one[0])
                 for one in re.finditer(r"/\*.*?\*/", text, re.DOTALL)]  # fmt: skip
    lines = [""] * (text.count("\n") + 1)
    for first, part in found:
        for k, line in enumerate(part.split("\n"), first - 1):
            lines[k] += f" {line.strip(' */#')}"
    return re.sub(r"`[^`]*`", lambda name: re.sub(r"[^\n]", "x", name[0]), "\n".join(lines))


def sources():
    """Python and C of the product."""
    for package in PRODUCT:
        for path in sorted((ROOT / package).rglob("*.[pch]*")):
            if path.suffix in {".py", ".c", ".h"}:
                yield path


def blank(match):
    """As many spaces, so that what follows stays where it is."""
    return re.sub(r"[^\n]", " ", match[0])


def prose(text):
    """The sentences of a page: no code, tables, headings, pictures or targets of links."""
    for fence in (r"```.*?```", r"<!--.*?-->"):
        text = re.sub(fence, blank, text, flags=re.DOTALL)
    text = re.sub(r"^ *(?:[|#<!]|    ).*$", blank, text, flags=re.MULTILINE)
    text = re.sub(r"`[^`]*`", lambda match: "x" * len(match[0]), text)
    return re.sub(r"\]\([^)]*\)", blank, text)


def too_long(most):
    """A check of proselint: where a sentence has more words than that."""

    def check(text, rule):
        begin = 0
        for stop in [*STOP.finditer(text), None]:
            end = stop.start() if stop else len(text)
            words = list(WORD.finditer(text, begin, end))
            if len(words) > most:
                yield CheckResult(rule.path, f"{len(words)} words without a stop, at most {most}",
                                  (words[0].start(), end), None)  # fmt: skip
            begin = stop.end() if stop else end

    return check


def words():
    """A check of proselint: `PRIVATE`."""
    turns = (turn.replace(" ", r"\s+") for turn in PRIVATE)
    private = Existence(tuple(f"(?i:{turn})" for turn in turns))
    return Check(private, path="house.words", message="a private turn, '{}': the field's term?")


def run(name, text, checks):
    """What these checks of proselint find, a line each."""
    registry = CheckRegistry()
    registry.checks[:] = checks
    enabled = dict.fromkeys((*ERRORS, "house"), True)
    found = LintFile(name, text).lint({"max_errors": 1000, "checks": enabled})
    return [f"{name}:{at.pos[0]}: {at.check_result.message}" for at in found]


def lint(name, text, most):
    """What is wrong with a page."""
    return run(name, prose(text), [*theirs, words(), Check(too_long(most), path="house.length")])


def main():
    """Lint all pages and sources; exit code 1 if anything is wrong."""
    found = (
        *(lint(str(path.relative_to(ROOT)), path.read_text(encoding="utf-8"), most)
          for path, most in pages()),
        *(run(str(path.relative_to(ROOT)), explanations(path), [words()]) for path in sources()),
    )  # fmt: skip
    for line in (line for lines in found for line in lines):
        print(line)
    sys.exit(any(found))


if __name__ == "__main__":
    main()
