"""Mutants of the compiled core are found; `make mutation` judges all of them."""

import json
from collections import Counter

import pytest

from core_build import SOURCES
from tests.mutation import core

KEPT = json.loads(core.KEPT.read_text())
JUDGED = sorted(KEPT["digests"])


def test_every_source_is_judged_or_named_as_not_yet_judged():
    compiled_again = {source for source in SOURCES if "simd_avx" in source}  # filter_simd.c
    assert set(core.TESTS) == set(SOURCES) - compiled_again
    assert set(JUDGED) == set(core.TESTS) - set(core.NOT_YET)


@pytest.mark.parametrize("source", JUDGED)
def test_what_is_kept_is_of_this_source_and_enough_were_found(source):
    """94 % and more; of every one that was not, why it need not be.

    One that cannot be told from the original by anything it does, as its reason says, is no mutant.
    """
    assert KEPT["digests"][source] == core.digest(source), "run `python -m tests.mutation.core`"
    rows = [row for row in KEPT["mutants"] if row[0] == source]
    # Small sources are judged completely, others by a sample that their name is the seed of.
    judged = sorted(core.Mutant(*row[:4]) for row in rows)
    assert judged in (sorted(core.mutants(source)), sorted(core.sample(source)))
    counts = Counter(row[4] for row in rows)
    assert set(counts) <= {"killed", "survived", "none"}
    alive = [row for row in rows if row[4] == "survived"]
    assert all(len(row) == 6 for row in alive), "no reason"
    other = [row for row in alive if not row[5].startswith("equivalent: ")]
    assert counts["killed"] >= 0.94 * (counts["killed"] + len(other))


@pytest.mark.slow
@pytest.mark.thorough
def test_a_sample_of_those_that_were_found_still_is(monkeypatch):
    monkeypatch.setattr("sys.argv", ["core", "--sample", "6", "--seed", "5"])
    assert core.main() == 0
