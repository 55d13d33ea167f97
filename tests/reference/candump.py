"""Candump logs read and written one line after the other: the oracle of the two C files.

Reading is the grammar of `dbc.candump.grammar` on each line, with the rules of `Reader` around it.
Writing is formatted text. Neither knows the fast ways of the C files.
"""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

from dbc.candump.grammar import DROPS, Verdict, name_bytes, parse_line, tail_of
from dbc.candump.reader import Problem
from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, FD_LENGTHS, REMOTE, TX, Frame
from dbc.text import printable

NO_LINE_END = frozenset((Verdict.BLANK, Verdict.COMMENT, Verdict.DROPCOUNT))
"""What an unterminated last line may be."""


class Log(NamedTuple):
    """What is in a log; `fault` is the text of the LogError at which strict reading stops."""

    frames: list[Frame]
    counts: Counter[Verdict]
    lines: int
    problems: list[Problem]
    drops: int
    fault: str


def read(data: bytes, *, strict: bool = False, problems_kept: int = 100) -> Log:
    """Frames and counts of a whole log, which is not packed."""
    *lines, rest = data.split(b"\n")
    frames: list[Frame] = []
    counts: Counter[Verdict] = Counter()
    problems: list[Problem] = []
    tails: dict[bytes, int] = {}
    drops, number, fault = 0, 0, ""
    for number, line in enumerate([*lines, *([rest] if rest else [])], 1):
        verdict, frame = parse_line(line)
        is_last = number > len(lines) and verdict not in NO_LINE_END
        # A frame cut inside its data would be a shorter frame.
        if is_last and (frame is None or tails.get(tail_of(line)[0]) != tail_of(line)[1]):
            verdict, frame = Verdict.CUT, None
        counts[verdict] += 1
        if frame is not None:
            frames.append(frame)
            digits, tail = tail_of(line)
            tails[digits] = tail
        if verdict is Verdict.DROPCOUNT:
            drops += int(DROPS.match(line)[1])
        if verdict.is_fault:
            text = printable(line[:120].decode("ascii", "backslashreplace").strip())
            if len(problems) < problems_kept:
                problems.append(Problem(number, verdict, text))
            if strict:
                fault = f"log:{number}: {verdict.name.lower().replace('_', ' ')}: {text}"
                break
    return Log(frames, counts, number, problems, drops, fault)


def write(frame: Frame, channel: str = "can0") -> bytes | None:
    """The line of a frame, without its end; None for what no line can say."""
    t_ns, can_id, data, flags, own, dlc = frame
    size = len(data)
    if flags & ERROR:
        fits = not flags & (REMOTE | FD | EXTENDED) and can_id < 1 << 29
        digits = f"{can_id | 1 << 29:08X}"
    else:
        fits = can_id < 1 << (29 if flags & EXTENDED else 11)
        digits = f"{can_id:08X}" if flags & EXTENDED else f"{can_id:03X}"
    if flags & (BRS | ESI) and not flags & FD:
        fits = False
    if flags & REMOTE:
        fits = fits and not size and not flags & FD and dlc <= 15
        body = f"R{dlc if dlc > 0 else ''}" if dlc < 9 else f"R8_{dlc:X}"
    elif flags & FD:
        fits = fits and size in FD_LENGTHS and dlc < 9
        body = f"#{(1 if flags & BRS else 0) | (2 if flags & ESI else 0)}{data.hex().upper()}"
    else:
        fits = fits and size <= 8 and (dlc < 9 or (size == 8 and dlc <= 15))
        body = data.hex().upper() + (f"_{dlc:X}" if dlc > 8 else "")
    name = name_bytes(own or channel)
    if not (fits and can_id >= 0 and 0 <= t_ns < 9 * 10**18 and name):
        return None
    seconds, ns = divmod(t_ns, 10**9)
    decimals = f"{ns:09d}" if ns % 1000 else f"{ns // 1000:06d}"
    return b"(%010d.%b) %b %b#%b%b" % (
        seconds, decimals.encode(), name, digits.encode(), body.encode(),
        b" T" if flags & TX else b"",
    )  # fmt: skip
