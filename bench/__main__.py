"""`python -m bench [PART ..] [-o FILE]`: measure and write the tables."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
from importlib.metadata import version
from pathlib import Path

from bench import (
    adhesion,
    authentication,
    convert,
    drives,
    filters,
    fleet,
    growth,
    judges,
    live,
    replay,
    speed,
    stages,
    thermal,
    whole,
    wire,
)

PARTS = {
    "whole": (whole, "Whole processes"),
    "speed": (speed, "Start, replay, simulation"),
    "stages": (stages, "Where a tick's time goes"),
    "wire": (wire, "Reading and decoding"),
    "replay": (replay, "Replay against the libraries"),
    "convert": (convert, "Convert against python-can"),
    "live": (live, "Live: frames, ticks, punctuality"),
    "authentication": (authentication, "Authenticated flags"),
    "fleet": (fleet, "A fleet of logs"),
    "filters": (filters, "What a step of the filters costs"),
    "judges": (judges, "What the detectors cost"),
    "drives": (drives, "A tick, by the number of drives"),
    "growth": (growth, "Growth, and what a fleet costs"),
    "adhesion": (adhesion, "Detection of random single losses of 20-100 %"),
    "thermal": (thermal, "Thermal watch"),
}
"""Modules with `rows`, and their titles. One without a `HEADER` has this one:"""
HEADER = ("figure", "measured", "reference in the same run", "ratio")


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
        part, title = PARTS[name]
        rows, header = part.rows(), getattr(part, "HEADER", HEADER)
        results[name] = [dict(zip(header, row, strict=True)) for row in rows]
        text += [f"\n## {title}\n", table(header, rows)]
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
