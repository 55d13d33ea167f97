"""What `judge` has found: the score, and every survivor.

    python -m tests.mutation.survivors flags.jsonl ..

Mutants that are none are left out, see `judge.equivalent`.
"""

from __future__ import annotations

import json
import sys
from collections import defaultdict
from pathlib import Path


def main() -> int:
    """Score and survivors of all sessions."""
    modules = defaultdict(list)
    for path in map(Path, sys.argv[1:]):
        for line in path.read_text().splitlines():
            row = json.loads(line)
            modules[row["module"]].append(row)
    for module, rows in modules.items():
        real = [row for row in rows if row["outcome"] != "none"]
        alive = [row for row in real if row["outcome"] in ("survived", "error")]
        late = sum(row["outcome"] == "timeout" for row in real)
        print(f"{module}: {len(rows)} made, {len(rows) - len(real)} are none,"
              f" {len(real) - len(alive)} of {len(real)} found"
              f" ({100.0 * (1.0 - len(alive) / max(len(real), 1)):.1f} %),"
              f" {late} of them by time")  # fmt: skip
        for row in alive:
            print(f"  {row['line']}: {row['before']}  ->  {row['after']}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
