"""Find the pattern that fits the lines of a log: `--line auto`, and known recorders."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np

from dbc.candump.grammar import Verdict
from dbc.frame import EXTENDED
from dbc.logs.dialects import DIALECTS, format_of
from dbc.logs.format import FD_SIZES, Format
from dbc.logs.guesses import NUMBER, guesses, unit_of, variants
from dbc.logs.pattern import COMMENT

_WRONG_LENGTHS: Final = 20
"""A column is no length if it differs from the number of bytes in one of this many lines."""
_LENGTH_BEFORE: Final = re.compile(r"\s*[0-9A-Fa-f][\s,;]+(?:0[xX])?[0-9A-Fa-f]{2}\b")

_IDENTIFIER: Final = re.compile(r"(?:[0-9A-Fa-f]{3,}|0[xX][0-9A-Fa-f]+):?")
"""A text that looks like an identifier, and so is not accepted as a channel's name."""
_FALLS: Final = 3
"""A column that falls in more than one of this many lines is no time."""


class Fit(NamedTuple):
    """How a pattern fits: number of lines that are frames (good), or neither that nor comments.

    wrong_length: bad lines that would be frames with another length. length_in_data: frames whose
    data begin with one digit and continue with two, probably a length without a field in the
    pattern. header: bad lines before the first frame. stamps: times of the frames. falls: frames
    whose time is earlier than that of the frame before.
    """

    good: int
    bad: int
    header: int
    wrong_length: int
    length_in_data: int
    stamps: tuple[str, ...]
    falls: int

    @property
    def possible(self) -> bool:
        """Whether most lines behind a header fit, and time and length are in their places."""
        most = self.good > self.bad - self.header
        lengths = self.wrong_length * _WRONG_LENGTHS < self.good + self.wrong_length
        lengths = lengths and self.length_in_data * 2 <= self.good
        return most and self.good > 0 and lengths and self.falls * _FALLS <= self.good


class Proposal(NamedTuple):
    """A pattern, the numbers of lines that match it and that do not, and what was assumed."""

    pattern: str
    good: int
    bad: int
    assumed: str = ""


def fit(pattern: str, lines: Sequence[str]) -> Fit:
    """Count how these lines fit a pattern."""
    form = format_of(pattern)
    good = bad = header = wrong_length = length_in_data = 0
    stamps = []
    for line in filter(str.strip, lines):
        rows = form.regex.findall(line)
        row: tuple[str, ...] = rows[0] if rows else ("",)
        if form.order:
            row = tuple(row[k] for k in form.order)
        if row[0]:
            frame, length = _is_frame(form, row)
            wrong_length += frame and not length
            frame = frame and length
            length_in_data += frame and _LENGTH_BEFORE.match(row[-2]) is not None
            stamps += [row[0]] if frame else []
        else:
            verdict = form.line(line).verdict
            if verdict is Verdict.COMMENT:
                continue
            frame = verdict <= Verdict.ERROR_FRAME
        header = bad if frame and not good else header
        good += frame
        bad += not frame
    times = form.clock(form.times(stamps), np.ones(len(stamps), dtype=np.bool_))
    falls = int(np.count_nonzero(np.diff(times) < 0))
    return Fit(good, bad, header, wrong_length, length_in_data, tuple(stamps), falls)


def _is_frame(form: Format, row: tuple[str, ...]) -> tuple[bool, bool]:
    """Whether a line is a frame, its length aside, and whether its length is right."""
    try:
        head = form.head(row[1:-2])
        data = form.data(row[-2], head.length)
        form.times([row[0]])
    except (ValueError, OverflowError):
        return False, False
    limit = 0x1FFF_FFFF if head.flags & EXTENDED else 0x7FF
    fits = len(data) in FD_SIZES if head.length < 0 else len(data) == head.length
    frame = head.verdict is Verdict.OK and head.can_id <= limit
    return frame and _IDENTIFIER.fullmatch(head.channel) is None, fits


def best_of(patterns: Iterable[str], lines: Sequence[str]) -> tuple[str, Fit] | None:
    """The possible pattern that fits most lines; the first one if several fit equally well."""
    best: tuple[str, Fit] | None = None
    for pattern in patterns:
        found = fit(pattern, lines)
        if found.possible and (best is None or found.good > best[1].good):
            best = pattern, found
            if not found.bad:
                break
    return best


def recognised(lines: Sequence[str]) -> Proposal | None:
    """The pattern of a known recorder, if it fits more than half of these lines."""
    found = [(pattern, fit(pattern, lines)) for pattern in DIALECTS.values()]
    pattern, fits = max(found, key=lambda item: item[1].good)
    return Proposal(pattern, fits.good, fits.bad) if fits.good > fits.bad else None


def proposed(lines: Sequence[str]) -> Proposal | None:
    """The pattern that fits most of these lines, of a known recorder if one fits."""
    if (known := recognised(lines)) is not None:
        return known
    texts = [line for line in lines if line.strip() and not line.strip().startswith(COMMENT)]
    patterns = list(dict.fromkeys(guesses(texts)))
    found = best_of((*DIALECTS.values(), *patterns), texts)
    if found is None or found[1].bad:
        more = [variant for pattern in patterns for variant in variants(pattern)]
        other = best_of(more, texts)
        if other and (found is None or other[1].good > found[1].good):
            found = other
    return None if found is None else _with_words(*found)


def _with_words(pattern: str, fits: Fit) -> Proposal:
    """A proposal from a fitting pattern, with the unit of its time and what was assumed."""
    assumed = []
    if NUMBER in pattern and pattern not in DIALECTS.values():
        unit, why = unit_of(fits.stamps)
        pattern = pattern.replace(NUMBER, f"{{{unit}}}")
        assumed += [why] if why else []
    if "{data:d}" in pattern:
        base = "decimal" if "{id:d}" in pattern else "hexadecimal"
        assumed.append(f"bytes are decimal, identifiers {base}")
    return Proposal(pattern, fits.good, fits.bad, "; ".join(assumed))
