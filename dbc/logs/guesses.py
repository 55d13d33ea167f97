"""Patterns that may fit the lines of an unknown log; `--line auto` tries them.

A pattern has a time, a separator and an order of columns. Only times and separators that occur in
the lines are tried. Lines of `key=value` give a pattern of their own.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import pairwise, product
from statistics import median
from typing import Final

NUMBER: Final = "{us}"
"""A time that is a number in an unknown unit, which `unit_of` finds; us have room for 16 digits."""
_DECIMAL: Final = r"-?\d{1,18}(?:[.,]\d*)?"
_TIMES: Final = {
    NUMBER: rf"{_DECIMAL}(?=[\s,;])", f"[{NUMBER}]": rf"\[{_DECIMAL}\]",
    f"({NUMBER})": rf"\({_DECIMAL}\)", f"( {NUMBER})": rf"\([ \t]+{_DECIMAL}\)",
    f"{NUMBER}:": rf"{_DECIMAL}:\s",
    "{ns}": r"\d{19}(?=[\s,;])",
    "{clock}": r"\d{1,2}:\d\d:\d\d(?!:)", "[{clock}]": r"\[\d{1,2}:\d\d:\d\d",
    "({clock})": r"\(\d{1,2}:\d\d:\d\d", "{date}": r"\d{4}-\d\d-\d\d[T ]\d\d:",
    "[{date}]": r"\[\d{4}-\d\d-\d\d[T ]\d\d:", "({date})": r"\(\d{4}-\d\d-\d\d[T ]\d\d:",
    "{ms:x}": r"[0-9A-Fa-f]{1,15}(?=[\s,;])",
}  # fmt: skip
_SEPARATORS: Final = ("; ", ";", ", ", ",", " ")
_COLUMNS: Final = (
    "id dlc data", "id [dlc] data", "channel id dlc data", "channel id [dlc] data",
    "channel id dir d dlc data", "id dir d dlc data",
    "id dir dlc data", "dir id dlc data", "channel id dir dlc data", "channel dir id dlc data",
    "dir channel id dlc data", "channel id dir skip dlc data", "id dir skip dlc data",
    "channel id skip dlc data", "id skip dlc data", "skip id dlc data",
    "id data", "channel id data", "id dir data", "dir id data", "channel id dir data",
    "dir channel id data", "channel dir id data", "id#data", "channel id#data",
    "type id dlc data", "id type dlc data", "channel type id dlc data", "channel id type dlc data",
    "type id data", "id type data", "channel type id data", "channel id type data",
    "dir type id dlc data", "type id dir dlc data", "channel id type dir dlc data",
    "dir id [dlc] data", "channel dir id [dlc] data", "id dlc data dir", "id: data",
    "channel dir brs esi id [dlc] data",
)  # fmt: skip
_COLUMN: Final = re.compile(r"\b(id|dlc|data|channel|dir|brs|esi|skip|type)\b")
_TYPE: Final = r"(?<![^\s,;])(?:[SX]|STD|EXT|SFF|EFF)(?![^\s,;])"
"""A word for the number of bits of the identifier."""
_DIRECTION: Final = r"(?<![^\s,;])[RTrt][xX]?(?![^\s,;])"
_KIND: Final = (
    r"(?<![^\s,;])(?![RTrt][xX]?[\s,;])(?:[A-Za-z]*[G-Zg-z][A-Za-z]*|[A-Za-z])(?![^\s,;])"
)
"""A word that is neither a direction nor a byte, such as the `d` in `Rx d 8`."""
_KEYS: Final = {
    "us": ("t", "time", "ts", "timestamp", "stamp"),
    "id": ("id", "canid", "can_id", "arbitration_id", "identifier", "msgid", "cobid"),
    "data": ("data", "payload", "bytes", "d"), "dlc": ("dlc", "len", "length", "dl"),
    "channel": ("channel", "ch", "chan", "bus", "if", "iface", "interface"),
    "dir": ("dir", "direction"),
}  # fmt: skip
_KEY: Final = re.compile(r"(\w+)([=:]\s*)(?=\S)")
_ROW: Final = re.compile(r"(\d+)[\s,;]+(\d+[.,]\d+)[\s,;]")
_NUMBERED: Final = re.compile(r"^\s*\d+[\s,;]+")
_EPOCH_DIGITS: Final = {10: "s", 13: "ms", 16: "us"}
_STEPS: Final = ((1000, "ms"), (1_000_000, "us"))
"""Unit of whole numbers whose median step between frames is below the limit; of all others ns."""
_MOST_PER_MS = 20
"""Most frames of one bus within 1 ms; more with the same stamp are stamped in whole seconds."""
_LEAST_US: Final = 40
"""Shorter than the shortest frame at 1 Mbit/s, in us."""


def guesses(lines: Sequence[str]) -> Iterator[str]:
    """Yield patterns to try, the likeliest first. The lines must not be blank or comments."""
    numbered = _are_numbered(lines)
    bare = [_NUMBERED.sub("", line) for line in lines] if numbered else lines
    directed = _most(lines, rf".*{_DIRECTION}")
    typed = _most(lines, rf".*{_TYPE}")
    columns = [
        names
        for names in _COLUMNS
        if ("dir" in names.split(), "type" in names.split()) == (directed, typed)
    ]
    if not _most(lines, rf".*{_KIND}"):
        columns = [names for names in columns if "skip" not in names or "[" in names]
    for time, sep in product(_times_in(bare), _separators_in(lines)):
        start = f"{{skip}}{sep}{time}" if numbered else time
        yield from (start + sep + _fields(names, sep) for names in columns)
    yield from _of_keys(lines)
    yield "{ms:x8}{id:x8}{data}"


def variants(pattern: str) -> tuple[str, ...]:
    """The pattern with decimal bytes; if it has a length, also with a word behind the data."""
    decimal = pattern.replace("{data}", "{data:d}")
    sep = "," if ",{data}" in pattern else ";" if ";{data}" in pattern else " "
    longer = (f"{pattern}{sep}{{skip}}",) if "{dlc}" in pattern else ()
    return decimal.replace("{id}", "{id:d}"), decimal, *longer


def unit_of(stamps: Sequence[str]) -> tuple[str, str]:
    """The unit of decimal times, `s` to `ns`, and the assumption behind it, "" if there is none."""
    if not all(stamp.lstrip("-").isdecimal() for stamp in stamps):
        return "s", ""
    if (unit := _EPOCH_DIGITS.get(len(stamps[0]))) is not None:
        return unit, f"times of {len(stamps[0])} digits are since 1970, in {unit}"
    steps = [abs(int(b) - int(a)) for a, b in pairwise(stamps)]
    step = median([step for step in steps if step] or [0])
    unit = next((unit for limit, unit in _STEPS if step < limit), "ns")
    if unit == "ms" and min(steps, default=0) >= _LEAST_US and len(set(steps)) * 2 > len(steps) > 9:
        # Frames that are stamped in ms come one right behind the other, or in equal distances.
        unit = "us"
    if sum(steps) * _MOST_PER_MS < len(steps):
        unit = "s"
    return unit, f"times are whole numbers, mostly {step:g} apart: taken for {unit}"


def too_close(stamps: Sequence[str]) -> bool:
    """Whether these whole numbers cannot be microseconds, as frames take longer."""
    span = abs(int(stamps[-1]) - int(stamps[0]))
    return len(stamps) > _MOST_PER_MS and span * 2 < (len(stamps) - 1) * _LEAST_US


def _fields(columns: str, sep: str) -> str:
    return _COLUMN.sub(r"{\1}", columns).replace(" ", sep)


def _most(lines: Sequence[str], regex: str) -> bool:
    found = sum(re.match(rf"\s*(?:{regex})", line) is not None for line in lines)
    return found * 2 > len(lines)


def _times_in(lines: Sequence[str]) -> list[str]:
    return [time for time, regex in _TIMES.items() if _most(lines, regex)]


def _separators_in(lines: Sequence[str]) -> list[str]:
    return [sep for sep in _SEPARATORS if _most(lines, ".*" + sep.replace(" ", "[ \\t]"))]


def _are_numbered(lines: Sequence[str]) -> bool:
    """Whether lines begin with their number, and a time with decimals follows."""
    rows = [match for line in lines if (match := _ROW.match(line.strip()))]
    numbers = [int(row[1]) for row in rows]
    times = [float(row[2].replace(",", ".")) for row in rows]
    counted = all(b - a == 1 for a, b in pairwise(numbers))
    return len(rows) > max(2, len(lines) // 2) and counted and times == sorted(times)


def _of_keys(lines: Sequence[str]) -> Iterator[str]:
    """Yield a pattern from the first line with keys for time, id and data: `t=1 id=181 data=01`."""
    for line in lines[:10]:
        keys = [match for match in _KEY.finditer(line) if not match[1].isdecimal()]
        names = [_field_of(match[1]) for match in keys]
        if not keys or not {"us", "id", "data"} <= set(names):
            continue
        text = line[: keys[0].start()]
        for k, (match, name) in enumerate(zip(keys, names, strict=True)):
            end = keys[k + 1].start() if k + 1 < len(keys) else len(line)
            value = line[match.end() : end]
            used = name != "skip" and f"{{{name}}}" not in text
            text += match[0] + f"{{{name if used else 'skip'}}}"
            text += value[len(value.rstrip(" \t,;")) :]
        yield text.rstrip()
        return


def _field_of(key: str) -> str:
    return next((field for field, keys in _KEYS.items() if key.lower() in keys), "skip")
