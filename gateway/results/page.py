"""A report as Markdown, and the same as one HTML file with its pictures inside."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from pathlib import Path
from typing import Final


def write(folder: Path, title: str, text: str, figures: Iterable[str]) -> None:
    """`report.md` and `report.html` in `folder`; `figures`: stems of the SVG files there.

    Raises OSError.
    """
    from markdown_it import MarkdownIt

    (folder / "report.md").write_text(text, encoding="utf-8")
    body = MarkdownIt("commonmark").enable("table").render(text)
    for name in figures:
        picture = base64.b64encode((folder / f"{name}.svg").read_bytes()).decode()
        body = body.replace(f'src="{name}.svg"', f'src="data:image/svg+xml;base64,{picture}"')
    whole = PAGE.replace("TITLE", title).replace("BODY", body)
    (folder / "report.html").write_text(whole, encoding="utf-8")


PAGE: Final = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>TITLE</title>
<style>
body { font: 16px/1.5 system-ui, sans-serif; color: #222; max-width: 72rem;
       margin: 2rem auto; padding: 0 1rem; }
table { border-collapse: collapse; font-size: 0.85rem; margin: 1rem 0; display: block;
        overflow-x: auto; font-variant-numeric: tabular-nums; }
th, td { border-bottom: 1px solid #ddd; padding: 0.25rem 0.6rem; }
th { background: #f4f4f4; }
td:first-child { white-space: nowrap; }
strong { color: #B03A00; }
code { background: #f4f4f4; padding: 0 0.2em; }
img { max-width: 100%; height: auto; }
</style>
</head>
<body>
BODY</body>
</html>
"""
