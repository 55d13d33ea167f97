"""The text of a DBC, split into its entries.

An entry starts with a keyword at the start of a line or behind the semicolon of the entry before.
Further signals may follow in the line of a message or signal. Text that belongs to no entry
becomes an entry with an empty keyword.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final, NamedTuple

_WORDS: Final = (
    r"(?P<{}>VERSION|NS_|BS_|BU_|VAL_TABLE_|BO_TX_BU_|BO_|SG_MUL_VAL_|SG_|SIG_VALTYPE_|"
    r"SIGTYPE_VALTYPE_|SIG_GROUP_|SIG_TYPE_REF_|SGTYPE_|SGTYPE_VAL_|VAL_|CM_|BA_DEF_DEF_REL_|"
    r"BA_DEF_DEF_|BA_DEF_REL_|BA_DEF_SGTYPE_|BA_DEF_|BA_SGTYPE_|BA_REL_|BA_|EV_DATA_|EV_|"
    r"ENVVAR_DATA_|CAT_DEF_|CAT_|FILTER)(?![A-Za-z0-9_])"
)
_START: Final = re.compile(r"^[ \t]*" + _WORDS.format("word"), re.MULTILINE)
_OF_NOTE: Final = re.compile(
    r"^[ \t]*" + _WORDS.format("first") + r"|;[ \t]*(?:" + _WORDS.format("next") + r")?"
    r"|\"|//|(?<![A-Za-z0-9_])(?P<inner>SG_)(?=\s+\w+(?:\s+\w+)?\s*:)",
    re.MULTILINE,
)
TEXT: Final = r'"(?:[^"\\]++|\\"|\\)*+"'
"""Pattern of a text in quotes, which may hold quotes behind a backslash."""
_TEXT: Final = re.compile(TEXT)
_END: Final = re.compile(r"\s*;")
ENDED: Final = frozenset({
    "VAL_", "VAL_TABLE_", "CM_", "BA_DEF_", "BA_DEF_DEF_", "BA_", "SIG_VALTYPE_", "SG_MUL_VAL_",
    "SIG_GROUP_", "BO_TX_BU_",
})  # fmt: skip
"""Keywords whose entries end with a semicolon."""
_HEADS: Final = {
    "BO_": re.compile(r"\s*BO_\s+\S+\s+\S+\s*:\s*\S+[^\n]*"),
    "SG_": re.compile(rf"\s*SG_[^\"]*{TEXT}[^\n]*(?:(?<=,)\s*[^\n]*)*"),
    "VERSION": re.compile(rf"\s*VERSION\s+{TEXT}"),
    "BS_": re.compile(r"[^\n]*"),
    "BU_": re.compile(r"[^\n]*(?:\n[\w \t]*$)*", re.MULTILINE),
    "NS_": re.compile(r"[^\n]*(?:\n[\w \t]*$)*", re.MULTILINE),
}
"""Extent of an entry that has no semicolon; further lines are not part of it."""


class Entry(NamedTuple):
    """One entry: its line, counted from 1, its keyword, and its text without `//` comments."""

    line: int
    keyword: str
    text: str


class _Piece(NamedTuple):
    """A piece: keyword, first character, the one behind the last, and the same of its comments."""

    keyword: str
    first: int
    last: int
    comments: tuple[tuple[int, int], ...]


def split(text: str) -> list[Entry]:
    """All entries of a text, in the order of the text."""
    out: list[Entry] = []
    line, at = 1, 0
    for piece in _pieces(text):
        line += text.count("\n", at, piece.first)
        at = piece.first
        content = _without(text, piece)
        out += _parts(line, piece.keyword, content)
    return out


def _pieces(text: str) -> Iterator[_Piece]:
    """Pieces from one keyword to the next."""
    keyword, first, at = "", 0, 0
    comments: list[tuple[int, int]] = []
    while found := _OF_NOTE.search(text, at):
        at = found.end()
        if found[0] == "//":
            at = text.find("\n", at)
            at = len(text) if at < 0 else at
            comments.append((found.start(), at))
        elif found[0] == '"':
            at = _behind(text, found.start(), keyword)
        elif word := _starts(found, keyword, text):
            start = found.start(found.lastgroup or 0)
            yield _Piece(keyword, first, start, tuple(comments))
            keyword, first, comments = word, start, []
    yield _Piece(keyword, first, len(text), tuple(comments))


def _starts(found: re.Match[str], keyword: str, text: str) -> str:
    """The keyword that starts an entry here, if one does."""
    word = found["first"] or found["next"] or found["inner"] or ""
    if found["inner"] and keyword not in ("BO_", "SG_"):
        return ""
    if word and keyword == "NS_":
        # In the list of keywords at the start of most files a keyword stands alone in its line.
        line = text[found.end() : found.end() + 80].partition("\n")[0]
        return word if line.strip() else ""
    return word


def _behind(text: str, quote: int, keyword: str) -> int:
    """Where a text in quotes ends; one without an end reaches to the next line that is an entry.

    A comment (CM_) may have lines that look like entries if a semicolon follows its closing quote.
    """
    found = _TEXT.match(text, quote)
    end = found.end() if found else len(text)
    line = text.find("\n", quote, end)
    start = _START.search(text, line + 1, end) if line >= 0 else None
    if start is None or (found and keyword == "CM_" and _END.match(text, end)):
        return end
    return start.start()


def _without(text: str, piece: _Piece) -> str:
    """A piece without its comments."""
    out, at = [], piece.first
    for first, last in piece.comments:
        out.append(text[at:first])
        at = last
    return "".join([*out, text[at : piece.last]])


def _parts(line: int, keyword: str, text: str) -> Iterator[Entry]:
    """Yield an entry, and the lines behind it that are not part of it."""
    end = 0
    if keyword:
        head = _HEADS[keyword].match(text) if keyword in _HEADS else None
        end = head.end() if head else 0
        end = end or (keyword not in _HEADS and _semicolon(text)) or len(text)
        yield Entry(line, keyword, text[:end].rstrip())
    rest = text[end:]
    if rest.strip(" \t\n;"):
        before = len(rest) - len(rest.lstrip(" \t\n;"))
        at = line + text.count("\n", 0, end + before)
        yield Entry(at, "", rest.strip(" \t\n;"))


def _semicolon(text: str) -> int:
    """The character behind the first semicolon outside of quotes; 0 if there is none."""
    bare = re.sub(TEXT, lambda found: "_" * len(found[0]), text)
    return bare.partition('"')[0].find(";") + 1
