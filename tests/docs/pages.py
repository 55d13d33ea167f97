"""The fenced blocks of the documents: what a reader would copy into a terminal or a file."""

import re
import shutil
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
PROGRAMS = re.compile(
    r"\s*(sudo |timeout \S+ (--\S+ )*)*(traction-gateway|pytest|make|candump|cantools|ip"
    r"|systemctl|apt-get|pip|pipx|python3?|modprobe|journalctl|install|units=)\b"
)
COMMENT = re.compile(r"<!-- (run|file): (.*?) -->")


class Block(NamedTuple):
    """page: relative to the repository; run: "here", "vcan" or "no, REASON"; file: a name or ""."""

    page: str
    line: int
    language: str
    run: str
    file: str
    text: str

    @property
    def commands(self):
        """True if it looks like something for a terminal."""
        return any(PROGRAMS.match(line) for line in self.text.splitlines())


def pages():
    """All documents a user reads."""
    files = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return [str(path.relative_to(ROOT)) for path in files]


def blocks(page):
    """In order; a comment just before a block says how it is run, or what file it is."""
    said = {}
    language, begin, inside = "", 0, None
    for number, line in enumerate((ROOT / page).read_text(encoding="utf-8").splitlines(), 1):
        if inside is not None:
            if line.strip() == "```":
                text = "\n".join(inside) + "\n"
                run = said.get("run", "here")
                yield Block(page, begin, language, run, said.get("file", ""), text)
                said, inside = {}, None
            else:
                inside.append(line)
        elif line.strip().startswith("```"):
            language, begin, inside = line.strip()[3:], number, []
        elif found := COMMENT.fullmatch(line.strip()):
            said[found[1]] = found[2]
        elif line.strip():
            said = {}


def folder_for(tmp):
    """A folder that has of the repository what its pages name, and a `train.toml` of one's own."""
    for name in ("dbc", "examples"):
        (tmp / name).symlink_to(ROOT / name)
    shutil.copy(ROOT / "examples" / "train.toml", tmp)
    return tmp
