"""A report as Markdown, and the same as one HTML file with its pictures inside.

The HTML file is self-contained, and readable on a phone and on paper. Its script zooms into
pictures over time and links an event in a table to its time in a picture; without the script the
rest still works.
"""

from __future__ import annotations

import base64
import html
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Final

from dbc.text import printable
from gateway.io.whole_file import write_text

_SPECIAL: Final = re.compile(r"([!-/:-@\[-`{-~])")
_HARMLESS: Final = frozenset(",.:;/'%=?@-+()\"&")
"""Punctuation without a meaning in Markdown in the middle of a line."""


def plain(text: str) -> str:
    """Foreign text as Markdown that shows it literally, in one line without markup or HTML."""
    escaped = _SPECIAL.sub(
        lambda m: m[1] if m[1] in _HARMLESS else f"\\{m[1]}", printable(text).replace("&", "&amp;")
    )
    # At the start of a line these begin a list or underline a heading.
    return f"\\{escaped}" if escaped[:1] in ("-", "+", "=") else escaped


def literal(text: str) -> str:
    """Foreign text, such as names of files or channels, as code in Markdown."""
    escaped = printable(text)
    return plain(escaped) if not escaped or "`" in escaped or "|" in escaped else f"`{escaped}`"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a table, its cells being Markdown, with an empty line before and after.

    A column whose name ends with a colon is aligned to the right.
    """
    rule = ("---:" if name.endswith(":") else "---" for name in head)
    names = (name.removesuffix(":") for name in head)
    lines = [f"| {' | '.join(names)} |", f"|{'|'.join(rule)}|"]
    return ["", *lines, *(f"| {' | '.join(row)} |" for row in rows), ""]


def folded(summary: str, lines: Iterable[str]) -> list[str]:
    """Lines in a section that is folded on the screen, and shown on paper."""
    return ["", "<details>", f"<summary>{html.escape(summary)}</summary>", "", *lines, "",
            "</details>", ""]  # fmt: skip


def code(text: str, language: str) -> list[str]:
    """A block of code, fenced with more backticks than the code contains in a row."""
    longest = max((len(run) for run in re.findall(r"`{3,}", text)), default=2)
    fence = "`" * (longest + 1)
    return [f"{fence}{language}", text.rstrip("\n"), fence]


def picture(words: str, stem: str) -> list[str]:
    """A picture, `stem`.svg beside the report; words: its description for readers without it."""
    return ["", f"![{plain(words)}]({stem}.svg)", ""]


class Anchors:
    """Anchors of headings, formed as Markdown viewers form them."""

    def __init__(self) -> None:
        self._given: dict[str, int] = {}

    def anchor_of(self, heading: str) -> str:
        """Anchor of the next heading with this text."""
        name = re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") or "section"
        count = self._given.get(name, 0)
        self._given[name] = count + 1
        return f"{name}-{count}" if count else name


def write(
    folder: Path,
    title: str,
    text: str,
    figures: Iterable[str],
    spans: Mapping[str, float] = MappingProxyType({}),
) -> None:
    """Write `report.md` and `report.html` in `folder`; `figures`: stems of the SVG files there.

    spans: seconds on the time axis by stem, for pictures of `figures.panels`, which get a zoom.
    Raises OSError.
    """
    from markdown_it import MarkdownIt

    from gateway.reports.figures import LEFT, RIGHT

    write_text(folder / "report.md", text)
    reader = MarkdownIt("commonmark").enable("table")
    tokens = reader.parse(text)
    anchors = Anchors()
    for k, token in enumerate(tokens):
        if token.type == "heading_open":
            words = "".join(child.content for child in tokens[k + 1].children or ())
            token.attrSet("id", anchors.anchor_of(words))
    body = reader.renderer.render(tokens, reader.options, {})
    for name in figures:
        inside = base64.b64encode((folder / f"{name}.svg").read_bytes()).decode()
        span = spans.get(name)
        data = f' data-x="{LEFT:.5f} {RIGHT:.5f} {span:.3f}"' if span else ""
        source = f'src="data:image/svg+xml;base64,{inside}"{data}'
        body = body.replace(f'src="{name}.svg"', source)
    page = PAGE.replace("TITLE", html.escape(printable(title)), 1).replace(
        "BODY", body + SCRIPT * bool(spans), 1
    )
    write_text(folder / "report.html", page)


PAGE: Final = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>TITLE</title>
<style>
body { font: 16px/1.5 system-ui, sans-serif; color: #222; background: #fff; max-width: 60rem;
       margin: 2rem auto; padding: 0 1rem; }
h1, h2, h3, h4 { line-height: 1.25; overflow-wrap: anywhere; }
h2 { margin-top: 2.5rem; border-bottom: 1px solid #ccc; padding-bottom: 0.2rem; }
table { border-collapse: collapse; font-size: 0.85rem; margin: 1rem 0; display: block;
        overflow-x: auto; font-variant-numeric: tabular-nums; }
th, td { border-bottom: 1px solid #ddd; padding: 0.25rem 0.6rem; text-align: left;
         vertical-align: top; }
th { background: #f4f4f4; white-space: nowrap; }
th:empty { padding: 0; border: 0; }
td:last-child { min-width: 8rem; }
td:first-child { white-space: nowrap; }
strong { color: #B03A00; }
blockquote { margin: 1rem 0; padding: 0.4rem 1rem; border-left: 0.4rem solid #0072B2;
             background: #f2f7fb; }
blockquote strong { color: inherit; }
code { background: #f4f4f4; padding: 0 0.2em; overflow-wrap: anywhere; }
pre { background: #f4f4f4; padding: 0.6rem; overflow-x: auto; font-size: 0.8rem; }
details { margin: 1rem 0; }
summary { cursor: pointer; }
img { max-width: 100%; height: auto; }
a { color: #005A8E; }
.zoom { overflow: auto; max-height: 85vh; }
.zoom > div { position: relative; min-width: 44rem; }
.zoom img { width: 100%; display: block; }
.zoom i { position: absolute; top: 0; bottom: 0; border-left: 2px solid #D55E00; }
@media (max-width: 45rem) {
  body { margin: 1rem auto; padding: 0 0.7rem; }
  p:has(> img) { overflow-x: auto; }
  p > img { max-width: none; width: 44rem; }
}
@media print {
  body { max-width: none; margin: 0; font-size: 10pt; }
  table { display: table; font-size: 8pt; }
  thead { display: table-header-group; }
  .zoom { max-height: none; overflow: visible; }
  .zoom > div { width: 100% !important; min-width: 0; }
  .tools { display: none; }
  tr, img, blockquote { break-inside: avoid; }
  h1, h2, h3, h4 { break-after: avoid; }
  pre { white-space: pre-wrap; }
  details::details-content { content-visibility: visible; display: block; }
}
</style>
</head>
<body>
BODY</body>
</html>
"""

SCRIPT: Final = """<script>
"use strict";
const MOST = 32, SHOWN_S = 5;
const make = (name, more) => Object.assign(document.createElement(name), more);
const pictures = [...document.querySelectorAll("img[data-x]")].map((img) => {
  const [left, right, span] = img.dataset.x.split(" ").map(Number);
  const box = make("div", {className: "zoom"}), inner = make("div");
  const mark = make("i", {hidden: true}), label = make("label", {className: "tools"});
  const slider = make("input", {type: "range", min: 1, max: MOST, step: "any", value: 1});
  label.append("zoom ", slider);
  img.before(label, box);
  inner.append(img, mark);
  box.append(inner);
  const set = (zoom, at = (box.scrollLeft + box.clientWidth / 2) / inner.offsetWidth) => {
    slider.value = zoom;
    inner.style.width = `${100 * slider.value}%`;
    box.scrollLeft = at * inner.offsetWidth - box.clientWidth / 2;
  };
  slider.oninput = () => set(slider.value);
  box.addEventListener("wheel", (turn) => {
    if (!turn.ctrlKey) return;
    turn.preventDefault();
    set(slider.value * (turn.deltaY < 0 ? 1.25 : 0.8));
  }, {passive: false});
  const drive = /of drive (\\d+) over time/.exec(img.alt);
  const jump = (seconds) => {
    const at = left + (right - left) * seconds / span;
    mark.hidden = false;
    mark.style.left = `${100 * at}%`;
    set(span / SHOWN_S, at);
    box.scrollIntoView({block: "center"});
  };
  return {img, jump, drive: drive ? drive[1] : "all"};
});
for (const table of document.querySelectorAll("table")) {
  const head = [...table.rows[0].cells].map((cell) => cell.textContent);
  const who = head.indexOf("drive"), from = head.indexOf("from / s");
  if (who < 0 || from < 0) continue;
  for (const row of [...table.rows].slice(1)) {
    const drive = row.cells[who].textContent, cell = row.cells[from];
    const mine = pictures.filter((p) => p.drive === drive);
    const after = mine.find((p) => table.compareDocumentPosition(p.img) & 4);
    const picture = after ?? mine.at(-1);
    if (!picture) continue;
    const text = cell.textContent, seconds = Number(text.replaceAll(",", ""));
    const link = make("a", {href: "#", textContent: text, title: "show in the picture"});
    link.onclick = (click) => { click.preventDefault(); picture.jump(seconds); };
    cell.replaceChildren(link);
  }
}
</script>
"""
