"""Scenarios that would judge nothing are refused, and what could not be seen is no success."""

from __future__ import annotations

import pytest

from dbc.frame import SECOND
from gateway.cli import main
from gateway.core.codes import Flag
from gateway.reports.expectations import judge
from sim.scenario import Expect, ScenarioError, parse

LOSS = {"at_s": 1.0, "drive": "all", "kind": "adhesion_loss", "depth": 0.5}
GOOD = {"flag": "adhesion", "is": "good", "after_s": 0.5}


def problems(expect, **changes):
    table = {"title": "a run", "duration_s": 2.0, "expect": [expect], **changes}
    with pytest.raises(ScenarioError) as error:
        parse(table)
    return "\n".join(error.value.problems)


def test_others_where_events_name_all_drives():
    assert "no others" in problems({**GOOD, "drive": "others"}, event=[LOSS])
    parse({"title": "a run", "duration_s": 2.0, "expect": [{**GOOD, "drive": "others"}],
           "event": [{**LOSS, "drive": 1}]})  # fmt: skip


def test_a_time_that_goes_beyond_the_end():
    assert "until 2.501 s, but the scenario ends at 2 s" in problems({**GOOD, "within_ms": 2001})
    parse({"title": "a run", "duration_s": 2.0, "expect": [{**GOOD, "within_ms": 1500}]})


def test_a_scenario_without_expectations_is_no_test(tmp_path, capsys):
    path = tmp_path / "none.toml"
    path.write_text('title = "nothing"\nduration_s = 1.0\n')
    assert main(["hil", str(path)]) == 2
    assert "no [[expect]]: nothing would be judged" in capsys.readouterr().err
    assert main(["sim", str(path), "-o", str(tmp_path / "a.log")]) == 0


class Track:
    """Flags as they were seen, one drive."""

    nodes = (1,)

    def __init__(self, seen):
        self.seen = {("adhesion", 1): seen}


def never_bad(seen, after_s=1.0):
    expect = Expect.model_validate(
        {"flag": "adhesion", "is": "bad", "never": True, "after_s": after_s}
    )
    (verdict,) = judge([expect], Track(seen), set(), 0)
    return verdict


def test_never_needs_frames_of_its_time():
    assert not never_bad([(0, Flag.GOOD), (SECOND // 2, Flag.GOOD)]).passed
    assert never_bad([(0, Flag.BAD), (SECOND, Flag.GOOD)]).detail == "held"


def test_never_says_for_how_much_of_its_time_the_flag_was_known():
    seen = [(SECOND, Flag.GOOD)] + [(SECOND + k, Flag.UNKNOWN) for k in range(1, 4)]
    assert never_bad(seen).detail == "held; the flag was known for 25% of that time"
