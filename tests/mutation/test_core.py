"""Mutants of the compiled core are found; `make mutation` judges all of them."""

import json
from collections import Counter

import pytest

from tests.mutation import core


def test_what_is_kept_is_of_this_core_and_enough_were_found():
    """94 % and more; of every one that was not, why it need not be."""
    kept = json.loads(core.KEPT.read_text())
    assert kept["digest"] == core.digest(), "run `python -m tests.mutation.core`"
    assert [tuple(row[:4]) for row in kept["mutants"]] == [tuple(m) for m in core.mutants()]
    counts = Counter(row[4] for row in kept["mutants"])
    assert set(counts) <= {"killed", "survived", "none"}
    assert counts["killed"] >= 0.94 * (counts["killed"] + counts["survived"])
    unexplained = [row for row in kept["mutants"] if row[4] == "survived" and len(row) < 6]
    assert not unexplained


@pytest.mark.slow
def test_a_sample_of_those_that_were_found_still_is(monkeypatch):
    monkeypatch.setattr("sys.argv", ["core", "--sample", "6", "--seed", "5"])
    assert core.main() == 0
