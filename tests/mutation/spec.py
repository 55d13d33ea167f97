"""Mutants of `dbc/spec.py`, the Python that decides a flag, and what its tests make of them.

    python -m tests.mutation.spec mutants.jsonl   # all that mutants.py has made; five minutes

Each is judged by a pytest of its own, in which it takes the place of the module. `outcomes.json`
keeps a letter of each in cosmic-ray's order (k: killed, t: longer than a minute, S: survived),
every survivor, and the hash of what was mutated; `sample.json` a few that were killed, for CI.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from tests.provenance import commit_of

ROOT = Path(__file__).parents[2]
NAME, MODULE, TESTS = "dbc.spec", "dbc/spec.py", ("tests/unit/test_dbc_spec.py",)
OUTCOMES, SAMPLE = (Path(__file__).with_name(name) for name in ("outcomes.json", "sample.json"))
LIMIT_S = 60
COUNT = 4
KILLED, LATE, SURVIVED = "ktS"


def source() -> str:
    """What is mutated."""
    return (ROOT / MODULE).read_text(encoding="utf-8")


def digest() -> str:
    """Of the source as it is now."""
    return hashlib.sha256(source().encode()).hexdigest()[:12]


def judged(code: str) -> str:
    """What its tests make of this code in place of the module: a letter."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "tests.mutation.instead"]
    command += ["-p", "no:cacheprovider", "-p", "no:xdist", "-W", "ignore::RuntimeWarning", *TESTS]
    with tempfile.NamedTemporaryFile("w", suffix=".py") as file:
        file.write(code)
        file.flush()
        try:
            done = subprocess.run(
                command, cwd=ROOT, env={**os.environ, "INSTEAD": file.name}, check=False,
                capture_output=True, timeout=LIMIT_S,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return LATE
    return KILLED if done.returncode else SURVIVED


def changed(code: str) -> tuple[str, str]:
    """The first line that differs, before and after."""
    old, new = source().splitlines(), code.splitlines()
    at = next((k for k, (x, y) in enumerate(zip(old, new, strict=False)) if x != y), len(new) - 1)
    return old[at].strip(), new[at].strip()


def mutated(row: dict[str, Any]) -> str:
    """The source with the line of a row of the sample changed; fails if there is no such line."""
    lines = source().splitlines(keepends=True)
    same = [k for k, line in enumerate(lines) if line.strip() == row["before"]]
    assert same, f"this line has changed: `make mutation`: {row['before']}"
    at = min(same, key=lambda k: abs(k + 1 - row["line"]))
    lines[at] = lines[at].replace(row["before"], row["after"])
    return "".join(lines)


def main() -> int:
    """Judge all, print who survives, write both files."""
    if judged(source()) != SURVIVED:
        print("the tests do not pass with nothing changed")
        return 1
    letters, survivors, single = "", [], []
    for line in Path(sys.argv[1]).read_text().splitlines():
        mutant = json.loads(line)
        before, after = changed(mutant["code"])
        row = {key: mutant[key] for key in ("line", "operator")} | {
            "before": before,
            "after": after,
        }
        letters += judged(mutant["code"])
        if letters[-1] == SURVIVED:
            survivors.append(row)
            print(f"  {row['line']}: {before}  ->  {after}", flush=True)
        elif letters[-1] == KILLED and before and mutated(row) == mutant["code"]:
            single.append(row)
    print(f"{MODULE}: {len(letters) - len(survivors)} of {len(letters)} found")
    kept = {"commit": commit_of(OUTCOMES.parent), "code": digest()}
    kept |= {"outcomes": letters, "survivors": survivors}
    OUTCOMES.write_text(json.dumps({MODULE: kept}, indent=1) + "\n")
    SAMPLE.write_text(json.dumps(random.Random(1).sample(single, COUNT), indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
