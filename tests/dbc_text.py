"""Small DBC files for tests, written as text."""

from __future__ import annotations

from pathlib import Path

from tests.strategies import Layout


def signal(
    name: str,
    start: int,
    length: int,
    sign: str = "+",
    order: int = 1,
    rest: str = '(1,0) [0|0] ""',
) -> str:
    return f" SG_ {name} : {start}|{length}@{order}{sign} {rest} Vector__XXX"


def message(can_id: int, name: str, size: int, *signals: str) -> str:
    return "\n".join([f"BO_ {can_id} {name}: {size} Vector__XXX", *signals, ""])


def write(path: Path, *parts: str) -> Path:
    """A file of these parts behind the usual head."""
    path.write_text("\n".join(['VERSION ""', "", "BS_:", "", "BU_: A", "", *parts, ""]))
    return path


def of_layout(path: Path, layout: Layout) -> Path:
    """A file with the one signal `S` in the one message `M` (id 1)."""
    rest = f'({layout.scale!r},{layout.offset!r}) [0|0] "u"'
    sign, order = "-" if layout.is_signed else "+", 0 if layout.is_big_endian else 1
    parts = [
        message(1, "M", layout.size, signal("S", layout.start, layout.length, sign, order, rest))
    ]
    if layout.is_float:
        parts.append(f"SIG_VALTYPE_ 1 S : {layout.length // 32};")
    return write(path, *parts)
