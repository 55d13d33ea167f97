"""The picture of the packages, made from the import graph: docs/pictures/packages.svg.

Rows are the layers of the import contracts in pyproject.toml, arrows are imports. An arrow that
others imply is left out: a to c where a imports b and b imports c. `python -m tests.docs.packages`
draws it anew.
"""

import ast
import itertools
import textwrap
import tomllib
from html import escape
from pathlib import Path
from typing import NamedTuple

import grimp

from core_build import SOURCES

ROOT = Path(__file__).parents[2]
PICTURE = ROOT / "docs" / "pictures" / "packages.svg"
BOX, LANE, HEIGHT, ROW, EDGE = 206, 22, 90, 128, 34
"""Pixels: width of a box and of a passing arrow, with their gaps; height of a box and of a row;
margin."""
STYLE = """
text { font: 12px sans-serif; fill: #263238 }
.name { font: bold 14px monospace } .parts { font: 10px monospace; fill: #546e7a }
.box { fill: #eceff1; stroke: #546e7a } .c { fill: #fff3e0; stroke: #e65100 }
.frame { fill: none; stroke: #90a4ae; stroke-dasharray: 6 4 }
.arrow { fill: none; stroke: #546e7a; stroke-width: 1.4; marker-end: url(#head) }
"""


class Place(NamedTuple):
    """In a row: the box of a package (to: ""), or an arrow that passes it."""

    row: int
    name: str
    to: str = ""


def layers():
    """Packages row by row, the highest first, as the import contracts have them."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = [c for c in project["tool"]["importlinter"]["contracts"] if c["type"] == "layers"]
    inner = next(c["layers"] for c in contracts if c.get("containers") == ["gateway"])
    outer = next(c["layers"] for c in contracts if "gateway" in c["layers"])
    rows = [[f"gateway.{name.strip()}" for name in layer.split("|")] for layer in inner]
    below = outer[outer.index("gateway") + 1 :]
    return rows + [[name.strip() for name in layer.split("|")] for layer in below]


def imports(names):
    """For each package, the others of which one of its modules imports something."""
    graph = grimp.build_graph(*sorted({name.split(".")[0] for name in names}), cache_dir=None)
    found = {name: set() for name in names}
    for module in graph.modules:
        for target in graph.find_modules_directly_imported_by(module):
            a, b = _package(module, names), _package(target, names)
            if a and b and a != b:
                found[a].add(b)
    return found


def _package(module, names):
    """Empty for `gateway` itself and for `gateway.__main__`, which are in no layer."""
    parts = module.split(".")
    return next((name for name in (".".join(parts[:2]), parts[0]) if name in names), "")


def reachable(edges, start):
    """All that `start` imports, directly or not."""
    found = set()
    waiting = set(edges[start])
    while waiting:
        found.add(name := waiting.pop())
        waiting |= edges[name] - found
    return found


def reduced(edges):
    """The arrows that no others imply (transitive reduction of a graph without circles)."""
    return {
        a: {b for b in targets if not any(b in reachable(edges, c) for c in targets - {b})}
        for a, targets in edges.items()
    }


def paths(rows, edges):
    """Each arrow, row by row."""
    at = {name: y for y, row in enumerate(rows) for name in row}
    return [
        [Place(at[a], a), *(Place(y, a, b) for y in range(at[a] + 1, at[b])), Place(at[b], b)]
        for a in at
        for b in sorted(edges[a], key=list(at).index)
    ]


def arrange(rows, arrows):
    """Middle of each place, pixels from the picture's: near what it is linked to, so few cross."""
    lines = [[Place(y, name) for name in row] for y, row in enumerate(rows)]
    for arrow in arrows:
        for place in arrow[1:-1]:
            lines[place.row].append(place)
    pairs = [pair for arrow in arrows for pair in itertools.pairwise(arrow)]
    up = [(below, above) for above, below in pairs]
    x = {place: middle for line in lines for place, middle in _middles(line)}
    for _ in range(12):
        for links, order in ((up, lines), (pairs, lines[::-1])):
            for line in order:
                near = {p: [x[other] for own, other in links if own == p] or [x[p]] for p in line}
                line.sort(key=lambda p, near=near: sum(near[p]) / len(near[p]))
                x.update(_middles(line))
    return x


def _middles(line):
    widths = [_width(place) for place in line]
    ends = itertools.accumulate(widths)
    return [(p, e - w / 2 - sum(widths) / 2) for p, w, e in zip(line, widths, ends, strict=True)]


def _width(place):
    return LANE if place.to else BOX


def svg():
    """The picture."""
    rows = layers()
    edges = reduced(imports({name for row in rows for name in row}))
    arrows = paths(rows, edges)
    x = arrange(rows, arrows)
    half = max(abs(middle) + _width(place) / 2 for place, middle in x.items()) + EDGE
    inside = sum(row[0].startswith("gateway.") for row in rows)
    size = f"{2 * half:.0f} {ROW * len(rows) + EDGE:.0f}"
    return "\n".join([
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size}">',
        f"<title>Packages and what they import</title><style>{STYLE}</style>",
        '<defs><marker id="head" markerWidth="8" markerHeight="8" refX="7" refY="4" orient="auto">'
        '<path d="M0 0L8 4L0 8z" fill="#546e7a"/></marker></defs>',
        '<rect width="100%" height="100%" fill="#fff"/>',
        f'<rect class="frame" x="8" y="8" width="{2 * half - 16:.0f}" '
        f'height="{ROW * inside}"/><text x="18" y="28" class="name">gateway/</text>',
        *(_arrow(arrow, x, half) for arrow in arrows),
        *(_box(place, x[place] + half) for place in x if not place.to),
        "</svg>\n",
    ])  # fmt: skip


def _arrow(arrow, x, half):
    out = f"M{x[arrow[0]] + half:.0f} {_top(arrow[0].row) + HEIGHT}"
    for above, place in itertools.pairwise(arrow):
        was, here, top = x[above] + half, x[place] + half, _top(place.row)
        bend = top - (ROW - HEIGHT) // 2
        out += f"C{was:.0f} {bend} {here:.0f} {bend} {here:.0f} {top}"
        out += f"V{top + HEIGHT}" if place.to else ""
    return f'<path class="arrow" d="{out}"/>'


def _top(row):
    return EDGE + ROW * row


def _box(place, middle):
    """Name, sub-packages, the first sentence of its docstring; C is another colour."""
    folder = ROOT / place.name.replace(".", "/")
    module = folder / "__init__.py" if folder.is_dir() else folder.with_suffix(".py")
    about = ast.get_docstring(ast.parse(module.read_text(encoding="utf-8"))) or ""
    parts = sorted(p.parent.name for p in folder.glob("*/__init__.py"))
    left, top = middle - BOX / 2 + 9, _top(place.row)
    compiled = any((ROOT / source).is_relative_to(folder) for source in SOURCES)
    kind = "box c" if compiled else "box"
    sentence = about.splitlines()[0].replace("`", "").partition(". ")[0].rstrip(".")
    lines = [("parts", " ".join(parts))] * bool(parts)
    lines += [("", line) for line in textwrap.wrap(sentence, 31)]
    return "\n".join([
        f'<rect class="{kind}" x="{left:.0f}" y="{top}" width="{BOX - 18}" height="{HEIGHT}"/>',
        f'<text x="{left + 8:.0f}" y="{top + 18}">'
        f'<tspan class="name">{place.name.rpartition(".")[2]}</tspan>',
        *(
            f'<tspan class="{style}" x="{left + 8:.0f}" dy="16">{escape(line)}</tspan>'
            for style, line in lines
        ),
        "</text>",
    ])  # fmt: skip


if __name__ == "__main__":
    PICTURE.write_text(svg(), encoding="utf-8")
