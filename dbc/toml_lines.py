"""Line numbers of the keys of a TOML file, for messages about them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Final

KeyPath = tuple[str, ...]

_NAME: Final = r"""(?:[\w-]+|"[^"]*"|'[^']*')"""
_KEY: Final = re.compile(rf"\s*({_NAME}(?:\s*\.\s*{_NAME})*)\s*=")
_HEADER: Final = re.compile(rf"\s*(\[\[?)\s*({_NAME}(?:\s*\.\s*{_NAME})*)\s*\]")
_PARTS: Final = re.compile(_NAME)
_WORDS: Final = re.compile(r"[^.\[\]]+")


def numbered(problems: Iterable[str], text: str) -> list[str]:
    """Each problem with the line of its key, or of the table that should have the key.

    A problem begins with the path of its key, `drive.0.node: ..` or `event[0].at_s: ..`; if no
    part of the path is in the text, the problem is returned unchanged.
    """
    lines = lines_of(text)
    out = []
    for problem in problems:
        path = tuple(_WORDS.findall(problem.partition(": ")[0]))
        while path and path not in lines:
            path = path[:-1]
        out.append(f"line {lines[path]}: {problem}" if path else problem)
    return out


def lines_of(text: str) -> dict[KeyPath, int]:
    """Line of each table and key, by its path; tables of an array are numbered from 0.

    Lines inside a multi-line string that look like TOML count as TOML: good enough for a message.
    """
    lines: dict[KeyPath, int] = {}
    counts: dict[KeyPath, int] = {}
    table: KeyPath = ()
    for number, line in enumerate(text.splitlines(), 1):
        if header := _HEADER.match(line):
            parts = _parts(header[2])
            table = ()
            for k, part in enumerate(parts):
                table += (part,)
                # The rest of the path belongs to the last table of the array so far.
                if table in counts and (header[1] == "[" or k + 1 < len(parts)):
                    table += (str(counts[table]),)
            if header[1] == "[[":
                counts[table] = counts.get(table, -1) + 1
                lines.setdefault(table, number)
                table += (str(counts[table]),)
            lines.setdefault(table, number)
        elif key := _KEY.match(line):
            parts = _parts(key[1])
            for end in range(1, len(parts) + 1):
                lines.setdefault((*table, *parts[:end]), number)
    return lines


def _parts(dotted: str) -> list[str]:
    return [part.strip("\"'") for part in _PARTS.findall(dotted)]
