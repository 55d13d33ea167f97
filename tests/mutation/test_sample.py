"""A sample of mutants of what decides a flag is still found; `make mutation` judges all of them."""

import json
import subprocess
import sys
import tomllib
from collections import Counter
from pathlib import Path

import pytest

from tests.mutation.sample import SAMPLE

ROOT = Path(__file__).parents[2]
PARTS = json.loads(SAMPLE.read_text())
PARTS_FILE, OUTCOMES = (Path(__file__).with_name(name) for name in ("parts.toml", "outcomes.json"))


def mutated(row):
    """The module with the line changed, or None where there is no such line any more."""
    lines = (ROOT / row["module"]).read_text().splitlines(keepends=True)
    same = [k for k, line in enumerate(lines) if line.strip() == row["before"]]
    if not same:
        return None
    at = min(same, key=lambda k: abs(k + 1 - row["line"]))
    lines[at] = lines[at].replace(row["before"], row["after"])
    return "".join(lines)


def test_what_is_kept_of_all_mutants_is_whole():
    """Of every module: 90 % and more of its mutants found, a row for each that was not."""
    told = json.loads(OUTCOMES.read_text())
    modules = {
        m for part in tomllib.loads(PARTS_FILE.read_text()).values() for m in part["modules"]
    }
    assert set(told) == modules
    for module, each in told.items():
        counts = Counter(each["outcomes"])
        assert set(counts) <= set("ktnS"), module
        assert counts["S"] == len(each["survivors"])
        assert counts["k"] + counts["t"] >= 0.9 * (counts.total() - counts["n"])


@pytest.mark.slow
@pytest.mark.parametrize("part", PARTS)
def test_mutants_of_a_sample_are_found(part, tmp_path):
    rows = [dict(row, code=mutated(row)) for row in PARTS[part]]
    gone = [f"{row['module']}: {row['before']}" for row in rows if row["code"] is None]
    assert not gone, f"these lines have changed: `make mutation PARTS={part}`, a new sample: {gone}"
    source, result = tmp_path / "mutants", tmp_path / "results"
    source.write_text("".join(json.dumps(row) + "\n" for row in rows))
    subprocess.run(
        [sys.executable, "-m", "tests.mutation.judge", part, source, result],
        cwd=ROOT, check=True,
    )  # fmt: skip
    judged = [json.loads(line) for line in result.read_text().splitlines()]
    assert [row for row in judged if row["outcome"] not in ("killed", "timeout")] == []
    assert len(judged) == len(rows)
