"""A sample of mutants of what decides a flag is still found; `make mutation` judges all of them."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.mutation.sample import SAMPLE

ROOT = Path(__file__).parents[2]
PARTS = json.loads(SAMPLE.read_text())


def mutated(row):
    """The module with the line changed, or None where there is no such line any more."""
    lines = (ROOT / row["module"]).read_text().splitlines(keepends=True)
    same = [k for k, line in enumerate(lines) if line.strip() == row["before"]]
    if not same:
        return None
    at = min(same, key=lambda k: abs(k + 1 - row["line"]))
    lines[at] = lines[at].replace(row["before"], row["after"])
    return "".join(lines)


@pytest.mark.slow
@pytest.mark.parametrize("part", PARTS)
def test_mutants_of_a_sample_are_found(part, tmp_path):
    rows = [dict(row, code=mutated(row)) for row in PARTS[part]]
    known = [row for row in rows if row["code"] is not None]
    assert 2 * len(known) > len(rows), "the code has changed much: `make mutation`, a new sample"
    source, result = tmp_path / "mutants", tmp_path / "results"
    source.write_text("".join(json.dumps(row) + "\n" for row in known))
    subprocess.run(
        [sys.executable, "-m", "tests.mutation.judge", part, source, result],
        cwd=ROOT, env=os.environ | {"NUMBA_DISABLE_JIT": "1"}, check=True,
    )  # fmt: skip
    judged = [json.loads(line) for line in result.read_text().splitlines()]
    assert [row for row in judged if row["outcome"] not in ("killed", "timeout")] == []
    assert len(judged) == len(known)
