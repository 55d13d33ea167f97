"""Header of a CSV of frames: the kinds of its columns by their names, and a pattern of its rows."""

from __future__ import annotations

import re
from typing import Final, NamedTuple

_NAMES: Final = {
    "time": "timestamp time timestampepoch t abstime offset timeabs relative",
    "id": "arbitrationid id canid identifier messageid msgid arbid addr address",
    "extended": "extended ide ext isextended isextendedid xtd",
    "remote": "remote rtr isrtr isremote isremoteframe remoteedlbrsesi",
    "error": "error iserror iserrorframe er",
    "fd": "fd edl isfd",
    "brs": "brs bitrateswitch",
    "esi": "esi errorstateindicator",
    "dlc": "dlc dl",
    "length": "len length datalength size",
    "direction": "dir direction tr rxtx txrx tx",
    "channel": "bus channel buschannel interface ch network",
    "data": "data databytes payload bytes",
    "type": "type",
    "format": "format",
    "flags": "flags",
}
_KIND: Final = {name: kind for kind, names in _NAMES.items() for name in names.split()}
_BYTE: Final = re.compile(r"(?:d|b|data|byte)(\d{1,2})")
UNIT: Final = re.compile(r"[\[(_ ](ns|us|µs|ms|s|sec|seconds)[\])]?$")
_HEX_TITLE: Final = re.compile(r"(?:[ _]+|\b)\(?hex\)?$")
_DOTTED: Final = re.compile(r"(?:\w+\.)+(?=\w+$)")
"""Names of the records around a column, as ROS writes them: `field.id`."""


class Columns(NamedTuple):
    """Columns of a header. kinds: kind of each column, see `_NAMES`; empty for unknown ones."""

    separator: str
    titles: list[str]
    plain: list[str]
    kinds: list[str]


def columns_of(text: str) -> Columns | None:
    """Columns of a header; None for any other line, such as one that begins with a digit."""
    if text[:1].isdigit():
        return None
    separator = max(",;\t", key=text.count)
    titles = [title.strip().strip('"').lower() for title in text.split(separator)]
    marked = [_HEX_TITLE.search(title) is not None for title in titles]
    titles = [_DOTTED.sub("", _HEX_TITLE.sub("", title)) for title in titles]
    plain = [re.sub(r"[^a-z0-9]", "", UNIT.sub("", title)) for title in titles]
    kinds = [_KIND.get(name, "byte" if _BYTE.fullmatch(name) else "") for name in plain]
    # A column that is hexadecimal by its title stands for the same one in decimal.
    known = {kind for kind, is_hex in zip(kinds, marked, strict=True) if is_hex}
    kinds = [k if m or k not in known else "" for k, m in zip(kinds, marked, strict=True)]
    if not {"time", "id"} <= set(kinds) or not {"data", "byte"} & set(kinds):
        return None
    return Columns(separator, titles, plain, kinds)


def row_pattern(separator: str, kinds: list[str], split: bool) -> tuple[list[str], list[str]]:
    """Patterns of the columns, and the kinds of their groups.

    If `split`, the last group is all from the first byte on: rows may end early. Time and
    identifier may stand behind the bytes of a row that has all columns.
    """
    cell = rf'(?:"[^"\n]*"|[^"{separator}\n][^{separator}\n]*|)'
    pattern: list[str] = []
    groups: list[str] = []
    for k, kind in enumerate(kinds):
        if kind == "byte" and split:
            if "data" in groups:
                continue
            groups.append("data")
            if not {"time", "id"} & set(kinds[k:]):
                return [*pattern, r"([^\n]*)"], groups
            pattern.append(f"((?:{cell}{separator}){{{kinds.count('byte') - 1}}}{cell})")
            continue
        if not kind or kind in groups or kind == "byte":
            pattern.append(cell)
            continue
        groups.append(kind)
        # A time begins with a digit, unlike a header, which may occur again.
        time = rf'[ ]*"?([-+]?\d[^{separator}"\n]*)"?[ ]*'
        pattern.append(time if kind == "time" else f"({cell})")
    return pattern, groups


def is_header(text: str) -> bool:
    """Whether a line names the columns of a log."""
    return columns_of(text) is not None
