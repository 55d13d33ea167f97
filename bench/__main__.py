"""`python -m bench [PART ..] [-o FILE]`: measure and write the tables."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
from importlib import import_module
from importlib.metadata import version
from pathlib import Path

PARTS = {
    "whole": "Whole processes",
    "speed": "Start, replay, simulation",
    "stages": "Where a tick's time goes",
    "wire": "Reading and decoding",
    "replay": "Replay against the libraries",
    "convert": "Convert against python-can",
    "live": "Live: frames, ticks, punctuality",
    "authentication": "Authenticated flags",
    "fleet": "A fleet of logs",
    "filters": "What a step of the filters costs",
    "judges": "What the detectors cost",
    "drives": "A tick, by the number of drives",
    "growth": "Growth, and what a fleet costs",
    "thermal": "Thermal watch",
}
"""Modules with `rows`, and their titles."""
HEADER = ("figure", "measured", "reference in the same run", "ratio")
"""Of a module that has none of its own."""


def machine() -> str:
    cpu = platform.machine()
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        cpu = next((line.split(":")[1].strip() for line in lines if "model name" in line), cpu)
    names = ", ".join(f"{n} {version(n)}" for n in ("numpy", "python-can", "cantools"))
    return (
        f"{cpu}, {os.cpu_count()} processors, {platform.system()} {platform.release()}; "
        f"Python {platform.python_version()}, {names}."
    )


def table(header: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", nargs="*", choices=[*PARTS, []], help="default: all")
    parser.add_argument("-o", "--output", type=Path, help="Markdown file; a JSON stands beside it")
    options = parser.parse_args()
    text = [machine()]
    results = {}
    for name in options.part or PARTS:
        part = import_module(f"bench.{name}")
        rows, header = part.rows(), getattr(part, "HEADER", HEADER)
        results[name] = [dict(zip(header, row, strict=True)) for row in rows]
        text += [f"\n## {PARTS[name]}\n", table(header, rows)]
        if hasattr(part, "SEE"):
            text[-1] += f"\n\n{part.SEE}"
        print("\n".join(text[-2:]), flush=True)
    if options.output:
        body = (
            "# Performance\n\nWritten by `make bench`; "
            "a ratio is to the reference measured in the same run. "
            "Detection: `docs/detection.md`.\n\n" + "\n".join(text)
        )
        options.output.write_text(body + "\n", encoding="utf-8")
        options.output.with_suffix(".json").write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
