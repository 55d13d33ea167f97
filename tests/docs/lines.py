"""Links of the documents to lines of the code: [`name`](../path#L12), the line that defines `name`.

`python -m tests.docs.lines` sets the numbers anew.
"""

import re
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
LINK = re.compile(r"\[`(\w+)`\]\(\.\./([\w./]+\.(?:c|py))#L(\d+)\)")


class Link(NamedTuple):
    """line: as the page says; defined: as it is, 0 for nowhere."""

    page: Path
    name: str
    path: str
    line: int
    defined: int


def definition(path, name):
    """Line of the first definition of a function, from 1; 0: there is none."""
    if path.suffix == ".py":
        pattern = re.compile(rf"\s*(?:async )?def {name}\(")
    else:
        pattern = re.compile(rf"(?!.*;\s*$)[a-z][\w *]*\b{name}\(")
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        if pattern.match(line):
            return number
    return 0


def links():
    """Of all pages in docs/."""
    for page in sorted((ROOT / "docs").glob("*.md")):
        for name, path, line in LINK.findall(page.read_text(encoding="utf-8")):
            yield Link(page, name, path, int(line), definition(ROOT / path, name))


def renumber():
    """Write the lines as they are into the pages."""
    for page in {link.page for link in links()}:

        def current(found):
            return f"[`{found[1]}`](../{found[2]}#L{definition(ROOT / found[2], found[1])})"

        page.write_text(LINK.sub(current, page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    renumber()
