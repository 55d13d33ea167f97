"""Share of the time in which each flag was known: a flag that is always `Unknown` is no success."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final

from gateway.core.codes import Flag

FLAGS: Final = ("adhesion", "thermal")
"""Flags of a drive."""
UNKNOWN: Final = "Unknown"
Shares = Mapping[str, Mapping[int, float]]
"""Percent of the time, by flag and node."""


def spans(
    changes: Iterable[tuple[int, int, str, str]], last_ns: int
) -> Iterator[tuple[int, str, str, int]]:
    """Yield (node, flag, state, ns) for each time in which a flag had one state.

    changes: rows of (time in ns, node, flag, new state), in the order of time.
    """
    since: dict[tuple[int, str], tuple[int, str]] = {}
    for t_ns, node, flag, state in changes:
        if (node, flag) in since:
            began, before = since[node, flag]
            yield node, flag, before, t_ns - began
        since[node, flag] = t_ns, state
    for (node, flag), (began, state) in since.items():
        yield node, flag, state, last_ns - began


def shares(
    changes: Iterable[tuple[int, int, str, str]], nodes: Iterable[int], first_ns: int, last_ns: int
) -> Shares:
    """Shares from rows as `spans` takes them."""
    known_ns = {flag: dict.fromkeys(nodes, 0) for flag in FLAGS}
    for node, flag, state, ns in spans(changes, last_ns):
        known_ns[flag][node] += ns if state != UNKNOWN else 0
    span = max(last_ns - first_ns, 1)
    return {
        flag: {node: min(100.0, 100.0 * ns / span) for node, ns in each.items()}
        for flag, each in known_ns.items()
    }


def of_frames(
    seen: Mapping[tuple[str, int], Sequence[tuple[int, Flag]]], nodes: Iterable[int], since_ns: int
) -> Shares:
    """Shares of the flag frames on the wire from `since_ns` on; 0 if there are none."""
    nodes = tuple(nodes)
    return {flag: {node: _share(seen.get((flag, node), ()), since_ns) for node in nodes}
            for flag in FLAGS}  # fmt: skip


def _share(seen: Sequence[tuple[int, Flag]], since_ns: int) -> float:
    states = [state is not Flag.UNKNOWN for t_ns, state in seen if t_ns >= since_ns]
    return 100.0 * sum(states) / len(states) if states else 0.0


def text(known: Shares) -> str:
    """One line with the share of each flag, by drive if the drives differ."""
    return "; ".join(f"{flag} {_of(known[flag])}" for flag in FLAGS) + " of the time"


def _of(each: Mapping[int, float]) -> str:
    words = {node: f"{share:.1f} %" for node, share in each.items()}
    if len(set(words.values())) == 1:
        return next(iter(words.values()))
    return ", ".join(f"{word} (drive {node})" for node, word in words.items())


def silent(known: Shares) -> dict[str, list[int]]:
    """Drives whose flag was never known, by flag; only flags with such drives."""
    never = {flag: [node for node, share in known[flag].items() if not share] for flag in FLAGS}
    return {flag: nodes for flag, nodes in never.items() if nodes}


def drives(nodes: Sequence[int], of: int) -> str:
    """` of drive 3`, ` of drives 3, 4`; empty if these are all `of` drives."""
    if len(nodes) == of:
        return ""
    return f" of drive{'s' * (len(nodes) > 1)} {', '.join(map(str, nodes))}"


def short_of(known: Shares, wanted: Mapping[str, float]) -> list[str]:
    """A line for each flag of a drive known for less than `wanted`, in percent by flag."""
    return [
        f"{flag} of drive {node} was known for {share:.1f} % of the time, expected {least_:g} %"
        for flag, least_ in wanted.items()
        for node, share in known[flag].items()
        if share < least_
    ]


def percentage(text: str) -> float:
    """Parse a share in percent. Raises ArgumentTypeError unless it is 0 to 100."""
    try:  # not `number_or_nan`: pytest reads its options before a user's `dbc.py` is known
        share = float(text)
    except ValueError:
        share = math.nan
    if not 0.0 <= share <= 100.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a percentage: expected 0 to 100")
    return share


def wanted(word: str) -> tuple[str, float]:
    """Flag and least percentage from `90` or `thermal=90`, for argparse and pytest."""
    flag, _, number = word.rpartition("=")
    if (flag or FLAGS[0]) not in FLAGS:
        raise argparse.ArgumentTypeError(f"{flag!r} is no flag: expected {' or '.join(FLAGS)}")
    return flag or FLAGS[0], percentage(number)
