"""A sample of mutants of `dbc/spec.py` is still found; `make mutation` judges all of them."""

import json

import pytest

from tests.mutation import spec


def test_what_is_kept_of_all_mutants_is_whole():
    """Of the module as it is: 90 % and more of its mutants found, a row for each that was not."""
    told = json.loads(spec.OUTCOMES.read_text())[spec.MODULE]
    assert told["code"] == spec.digest()
    assert set(told["outcomes"]) <= {spec.KILLED, spec.LATE, spec.SURVIVED}
    assert told["outcomes"].count(spec.SURVIVED) == len(told["survivors"])
    assert len(told["survivors"]) <= 0.1 * len(told["outcomes"])


@pytest.mark.slow
def test_mutants_of_a_sample_are_found_and_the_module_itself_is_none():
    assert spec.judged(spec.source()) == spec.SURVIVED
    for row in json.loads(spec.SAMPLE.read_text()):
        assert spec.judged(spec.mutated(row)) == spec.KILLED, row
