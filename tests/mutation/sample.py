"""A few of the mutants that were found, by seed, for a test in CI: `sample.json`.

    python -m tests.mutation.sample out/mutants

Of each part in `parts.toml` so many as its share of all; one line each, found by its text.
"""

from __future__ import annotations

import json
import random
import sys
import tomllib
from pathlib import Path

from tests.mutation.judge import PARTS, mutants

COUNT = 48
SAMPLE = Path(__file__).with_name("sample.json")


def lines(before: str, after: str) -> int:
    """How many lines differ; -1: another number of lines."""
    old, new = before.splitlines(), after.splitlines()
    return sum(x != y for x, y in zip(old, new, strict=True)) if len(old) == len(new) else -1


def found(folder: Path, part: str) -> list[dict[str, object]]:
    """Mutants of a part that its tests have found, of one line each."""
    results = map(json.loads, (folder / f"{part}.jsonl").read_text().splitlines())
    killed = {row["number"] for row in results if row["outcome"] == "killed"}
    return [
        {key: mutant[key] for key in ("module", "line", "operator", "before", "after")}
        for mutant in mutants(folder / f"{part}.mutants")
        if mutant["number"] in killed
        and lines(Path(mutant["module"]).read_text(), mutant["code"]) == 1
    ]


def main() -> int:
    """Write the sample."""
    folder = Path(sys.argv[1])
    parts = {part: found(folder, part) for part in tomllib.loads(PARTS.read_text())}
    every = sum(map(len, parts.values()))
    generator = random.Random(1)
    sample = {
        part: generator.sample(rows, max(4, round(COUNT * len(rows) / every)))
        for part, rows in parts.items()
    }
    SAMPLE.write_text(json.dumps(sample, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
