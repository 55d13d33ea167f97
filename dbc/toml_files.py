"""TOML files that a person writes: bounds of their numbers, and places of the problems in them.

A message about a number outside its bounds has unit and advice, one about an unknown key the key
that was probably meant; `numbered` adds the lines.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict

from dbc.text import near

LONGEST: Final = 24
"""Most characters of a number that a message quotes."""
KeyPath = tuple[str, ...]

_NAME: Final = r"""(?:[\w-]+|"[^"]*"|'[^']*')"""
_KEY: Final = re.compile(rf"\s*({_NAME}(?:\s*\.\s*{_NAME})*)\s*=")
_HEADER: Final = re.compile(rf"\s*(\[\[?)\s*({_NAME}(?:\s*\.\s*{_NAME})*)\s*\]")
_PARTS: Final = re.compile(_NAME)
_WORDS: Final = re.compile(r"[^.\[\]]+")


@dataclass(frozen=True)
class Within:
    """Range from low to high, both included, in `unit`; cure: what to do with a number outside.

    A call returns the number that it is given, or raises ValueError with one line.
    """

    low: float
    high: float
    unit: str
    cure: str

    def __call__(self, value: float) -> float:
        """Return `value`; raises ValueError if it is outside the bounds."""
        if self.low <= value <= self.high:
            return value
        msg = f"expected {self}, got {_text(value)}: {self.cure}"
        raise ValueError(msg)

    def __str__(self) -> str:
        """Return the range as in `0.01 to 100 ohm`."""
        return f"{_plain(self.low)} to {_plain(self.high)} {self.unit}".rstrip()


class Strict(BaseModel):
    """Part of a file that a person writes: unknown keys are refused, values are frozen."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def within(low: float, high: float, unit: str, cure: str) -> AfterValidator:
    """Bounds for a field of a pydantic model, as metadata of its `Annotated` type."""
    return AfterValidator(Within(low, high, unit, cure))


def _plain(value: float) -> str:
    return str(int(value)) if value == int(value) and abs(value) < 1e9 else f"{value:g}"


def _text(value: float) -> str:
    if isinstance(value, int) and value.bit_length() > 64:
        return f"a whole number of {value.bit_length()} bits"
    return str(value)[:LONGEST]


def did_you_mean(model: Any, loc: Sequence[int | str]) -> str:
    """Return `; did you mean 'node'?`, or an empty text if no key is similar.

    model: pydantic model of the whole document; loc: path of the rejected key, the key last.
    """
    models = [model]
    for part in loc[:-1]:
        fields = [one.model_fields[part] for one in models if part in one.model_fields]
        models = [inner for f in fields for inner in _models(f.annotation)] or models
    return near(loc[-1], (name for one in models for name in one.model_fields))


def _models(annotation: Any) -> Iterator[Any]:
    """Yield the models in a type such as `dict[str, Motor] | None`."""
    if hasattr(annotation, "model_fields"):
        yield annotation
    for part in get_args(annotation):
        yield from _models(part)


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
