"""Table 1 of paper `adhesion` as text for a terminal, and tables in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from gateway.study.reproduction import METHODS, STATISTICS, Cell


def grid(header: Sequence[str], rows: Iterable[Sequence[str]], rule: str = "---:") -> str:
    """A Markdown table with numbers aligned to the right (for text, another `rule`)."""
    lines = ["| " + " | ".join(header) + " |", "|---" + f"|{rule}" * (len(header) - 1) + "|"]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def number(value: float, places: int = 2) -> str:
    """A number as text, without a negative zero."""
    return f"{round(value, places) + 0.0:.{places}f}"


def rows_of(cells: Sequence[Cell]) -> list[list[Cell]]:
    """The 12 rows of Table 1."""
    width = len(STATISTICS)
    return [list(cells[k : k + width]) for k in range(0, len(cells), width)]


def name_of(cell: Cell) -> str:
    """A row's name as the paper prints it."""
    return f"{METHODS[cell.method]}.PMSM{cell.drive}"


def table_text(cells: Sequence[Cell]) -> str:
    """Table 1 for a terminal: our row above the paper's, `*` where they do not agree."""
    lines = [f"{'Nm':<15}" + "".join(f"{s:>9} " for s in STATISTICS)]
    for row in rows_of(cells):
        ours = "".join(f"{number(c.ours):>9}{' ' if c.agrees else '*'}" for c in row)
        lines.append(f"{name_of(row[0]):<15}{ours}")
        lines.append(f"{'  paper':<15}" + "".join(f"{number(c.printed):>9} " for c in row))
    return "\n".join(lines)
