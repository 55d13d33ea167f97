"""`python -m bench [PART ..] [-o FILE]`: measure and write the tables."""

from __future__ import annotations

import argparse
import json
import platform
from importlib.metadata import version
from pathlib import Path

from bench import adhesion, fleet, kernels, speed, thermal

PARTS = {
    "speed": speed,
    "fleet": fleet,
    "kernels": kernels,
    "adhesion": adhesion,
    "thermal": thermal,
}
TITLES = {
    "speed": "Speed",
    "fleet": "A fleet of logs",
    "kernels": "What a step of the filters costs",
    "adhesion": "Detection of random single losses of 20-100 %",
    "thermal": "Thermal watch",
}


def table(header: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", nargs="*", choices=[*PARTS, []], help="default: all")
    parser.add_argument("-o", "--output", type=Path, help="Markdown file; a JSON stands beside it")
    options = parser.parse_args()
    names = ", ".join(f"{n} {version(n)}" for n in ("numpy", "numba", "python-can", "cantools"))
    text = [f"Python {platform.python_version()}, {names}; {platform.machine()}."]
    results = {}
    for name in options.part or PARTS:
        rows = PARTS[name].rows()
        results[name] = [dict(zip(PARTS[name].HEADER, row, strict=True)) for row in rows]
        text += [f"\n## {TITLES[name]}\n", table(PARTS[name].HEADER, rows)]
        print("\n".join(text[-2:]), flush=True)
    if options.output:
        body = (
            "# Figures\n\nWritten by `python -m bench -o FILE`; detection: `docs/detection.md`.\n"
            + "\n".join(text)
        )
        options.output.write_text(body + "\n", encoding="utf-8")
        options.output.with_suffix(".json").write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
