"""Which pattern fits the lines of a log: `--line auto`, and recorders that are recognised."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from dbc.candump.grammar import Verdict
from dbc.frame import EXTENDED
from dbc.logs.dialects import DIALECTS, format_of
from dbc.logs.format import FD_SIZES, Format

GUESSES: Final = (
    *DIALECTS.values(),
    "{s} {id} {dir} {dlc} {data}", "{s} {channel} {id} {dir} {dlc} {data}",
    "{s} {id} {dlc} {data}", "{s} {channel} {id} {dlc} {data}", "{s} {id} {data}",
    "{s} {channel} {id} {data}", "{s} {id}#{data}", "{s} {channel} {id}#{data}",
    "{s},{id},{dlc},{data}", "{s},{channel},{id},{dlc},{data}", "{s},{id},{data}",
    "{s};{id};{dlc};{data}", "{s};{channel};{id};{dlc};{data}", "{s};{id};{data}",
    "[{s}] {channel} {id} {dlc} {data}", "[{s}] {id} {dlc} {data}", "[{s}] {id} {data}",
    "[{clock}] {id} {data}", "{clock} {channel} {id} {dlc} {data}", "{clock} {id} {dlc} {data}",
    "{clock} {id} {data}", "{date} {channel} {id} {dlc} {data}", "{date} {id} {dlc} {data}",
    "{date} {id} {data}", "{date},{id},{dlc},{data}", "{date},{id},{data}",
    "{ms:x} {id:x} {data}", "{ms:x},{id:x},{data}", "{ms:x8}{id:x8}{data}",
)  # fmt: skip
"""What `--line auto` tries, in this order among those that match equally many lines."""


def share(pattern: str, lines: Sequence[str]) -> tuple[int, int]:
    """How many of these lines are frames by a pattern, and how many neither that nor comments."""
    form = format_of(pattern)
    good = bad = 0
    for line in lines:
        rows = form.regex.findall(line)
        row = rows[0] if rows else ("",)
        if form.order:
            row = tuple(row[k] for k in form.order)
        if row[0]:
            frame = _is_frame(form, row)
        else:
            verdict = form.line(line).verdict
            if verdict in (Verdict.BLANK, Verdict.COMMENT):
                continue
            frame = verdict <= Verdict.ERROR_FRAME
        good += frame
        bad += not frame
    return good, bad


def _is_frame(form: Format, row: tuple[str, ...]) -> bool:
    try:
        head = form.head(row[1:-2])
        data = form.data(row[-2], head.length)
        form.times([row[0]])
    except (ValueError, OverflowError):
        return False
    limit = 0x1FFF_FFFF if head.flags & EXTENDED else 0x7FF
    fits = len(data) in FD_SIZES if head.length < 0 else len(data) == head.length
    return head.verdict is Verdict.OK and fits and head.can_id <= limit


def proposed(lines: Sequence[str], among: Sequence[str] = GUESSES) -> tuple[str, int, int] | None:
    """The pattern that reads most of these lines, with their number and that of the others."""
    best: tuple[str, int, int] | None = None
    for pattern in among:
        good, bad = share(pattern, lines)
        if good and (best is None or good > best[1]):
            best = pattern, good, bad
    return best
