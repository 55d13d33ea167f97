"""What `judge` has found: the score, and every survivor.

    python -m tests.mutation.survivors -o tests/mutation/outcomes.json out/mutants/*.jsonl

Mutants that are none are left out, see `judge.equivalent`. The file keeps of each module a letter
per mutant, in cosmic-ray's order, and the hash of what was mutated.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tests.mutation.judge import PARTS
from tests.provenance import commit_of

LETTERS = {"killed": "k", "timeout": "t", "none": "n", "survived": "S", "error": "E"}
ALIVE = ("survived", "error")


def hash_of(module: str) -> str:
    """Of a module as it is now."""
    return hashlib.sha256(Path(module).read_bytes()).hexdigest()[:12]


def kept(module: str, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """What is kept of a module's mutants."""
    ordered = sorted(rows, key=lambda row: row["number"])
    return {
        "code": hash_of(module),
        "outcomes": "".join(LETTERS[row["outcome"]] for row in ordered),
        "survivors": [
            {key: row[key] for key in ("line", "operator", "before", "after")}
            for row in ordered
            if row["outcome"] in ALIVE
        ],
    }


def score(module: str, told: dict[str, Any]) -> str:
    """A line, and one per survivor."""
    letters = told["outcomes"]
    none, late, alive = letters.count("n"), letters.count("t"), len(told["survivors"])
    real = len(letters) - none
    lines = [
        f"{module}: {len(letters)} made, {none} are none, {real - alive} of {real} found"
        f" ({100.0 * (1.0 - alive / max(real, 1)):.1f} %), {late} of them by time"
    ]
    lines += [f"  {row['line']}: {row['before']}  ->  {row['after']}" for row in told["survivors"]]
    return "\n".join(lines)


def main() -> int:
    """Score and survivors of all sessions."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutation.survivors")
    parser.add_argument("sessions", nargs="+", type=Path)
    parser.add_argument("-o", type=Path, help="what is in it of other modules stays")
    options = parser.parse_args()
    modules = defaultdict(list)
    for path in options.sessions:
        for line in path.read_text().splitlines():
            row = json.loads(line)
            modules[row["module"]].append(row)
    found = {module: kept(module, rows) for module, rows in modules.items()}
    for module, told in found.items():
        print(score(module, told))
    if options.o is not None:
        commit = commit_of(PARTS.parent)
        old = json.loads(options.o.read_text()) if options.o.exists() else {}
        new = {module: {"commit": commit, **told} for module, told in found.items()}
        options.o.write_text(json.dumps(old | new, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
