"""`python -m bench.ablation`: what is removed is there, acts, and stands in the page."""

from functools import partial

import pytest

from bench.ablation import PAGE, REMOVALS, without
from gateway.study.evaluation_runs import Plan, fitted, judge, recorded
from tests.mutation.core import libraries


@pytest.mark.parametrize("removal", REMOVALS, ids=lambda removal: removal.name)
def test_a_part_that_is_removed_is_one_line_of_its_source(removal):
    assert removal.mutant().before == removal.line
    assert removal.without not in ("", removal.line)


def test_the_page_has_every_part():
    rows = [line.split("|")[1].strip() for line in PAGE.read_text().splitlines() if "|" in line]
    assert [name for name in rows if name in {removal.name for removal in REMOVALS}] == [
        removal.name for removal in REMOVALS
    ]


def test_without_the_loss_of_all_drives_at_once_it_is_missed(tmp_path):
    [removal] = [r for r in REMOVALS if r.name == "loss of all drives at once"]
    [library] = libraries(removal.source, [removal.mutant()], tmp_path)
    plan = Plan(("all_together",), ("switching",), (0,))
    recording = recorded(plan, "all_together", 0)
    work = partial(judge, recording, *fitted(plan, "switching", recording.scenario))
    found = [without(changed, work).flags for changed in (None, library)]
    assert found[0].f1 > 0.9
    assert found[1].f1 < 0.5
    assert work().flags.f1 == found[0].f1, "only the process of its own is changed"
