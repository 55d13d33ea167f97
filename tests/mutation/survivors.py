"""What cosmic-ray's sessions have found: the score, and every survivor.

    python -m tests.mutation.survivors flags.sqlite ..

Annotations are never evaluated here (`from __future__ import annotations`), and `is` and `==` are
the same for the members of an enumeration: such mutants are no others, and are left out.
"""

from __future__ import annotations

import re
import sqlite3
import sys
from pathlib import Path

QUERY = """
select spec.module_path, spec.operator_name, spec.start_pos_row, result.test_outcome, result.diff
from mutation_specs spec join work_results result on spec.job_id = result.job_id
order by 1, 3
"""
SAME = re.compile(r"Comparison\w*_(Is|Eq|IsNot|NotEq)_(Is|Eq|IsNot|NotEq)$")
WORDS = re.compile(r"\b(Flag|Profile|SmState|Check|Reason|evidence|flag|found)\b")


def changed(diff: str) -> tuple[str, str]:
    """The line before and after."""
    lines = [line for line in diff.splitlines() if line[:3] not in ("---", "+++")]
    before = [line[1:].strip() for line in lines if line.startswith("-") and line[1:].strip()]
    after = [line[1:].strip() for line in lines if line.startswith("+") and line[1:].strip()]
    return (before or [""])[0], (after or [""])[0]


def equivalent(operator: str, before: str, after: str) -> bool:
    """Whether the mutant cannot behave otherwise."""
    if SAME.search(operator) and WORDS.search(before):
        return True
    signature = re.match(r"(async )?def |\w+(\.\w+)*: ", before)
    if "BinaryOperator_BitOr" not in operator or signature is None:
        return False
    # Only what stands behind a colon or an arrow, not a default value.
    return before.rsplit("=", 1)[-1] == after.rsplit("=", 1)[-1] or "=" not in before


def main() -> int:
    """Score and survivors of all sessions."""
    for path in map(Path, sys.argv[1:]):
        with sqlite3.connect(path) as session:
            rows = [row for row in session.execute(QUERY) if row[4]]
        real = [(*row, *changed(row[4])) for row in rows]
        real = [row for row in real if not equivalent(row[1].split("/")[-1], row[5], row[6])]
        alive = [row for row in real if "SURVIVED" in str(row[3])]
        print(f"{path.stem}: {len(real) - len(alive)} of {len(real)} mutants found"
              f" ({100.0 * (1.0 - len(alive) / max(len(real), 1)):.1f} %),"
              f" {len(rows) - len(real)} others are none")  # fmt: skip
        for module, _, line, _, _, before, after in alive:
            print(f"  {module}:{line}: {before}  ->  {after}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
