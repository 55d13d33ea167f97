"""What `judge` has found: the score, and every survivor.

    python -m tests.mutation.survivors flags.jsonl ..

Mutants of annotations are none; `is` and `==` are the same for the members of an enumeration:
such mutants are no others either, and are left out.
"""

from __future__ import annotations

import json
import re
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

SAME = re.compile(r"Comparison\w*_(Is|Eq|IsNot|NotEq)_(Is|Eq|IsNot|NotEq)$")
WORDS = re.compile(r"\b(Flag|Profile|SmState|Check|Reason|evidence|flag|found)\b")


def equivalent(row: dict[str, Any]) -> bool:
    """Whether the mutant cannot behave otherwise."""
    if row["outcome"] == "none":
        return True
    plain = not row["module"].endswith("_kernels.py")
    same = SAME.search(row["operator"]) and WORDS.search(row["before"])
    # Of numbers from arrays, as in the loops, `is` is another.
    return bool(plain and same and row["outcome"] == "survived")


def main() -> int:
    """Score and survivors of all sessions."""
    modules = defaultdict(list)
    for path in map(Path, sys.argv[1:]):
        for line in path.read_text().splitlines():
            row = json.loads(line)
            modules[row["module"]].append(row)
    for module, rows in modules.items():
        real = [row for row in rows if not equivalent(row)]
        alive = [row for row in real if row["outcome"] == "survived"]
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
