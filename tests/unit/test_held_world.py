"""A world that detectors were not tuned on: its runs, through the same scorer as ours."""

import pytest

from gateway.cli import main
from gateway.study.evaluation_runs import Plan, evaluate


def test_loss_in_a_train_of_held_speed_is_found_without_commands():
    plan = Plan(("one_mute",), ("switching",), (0, 1), world="held")
    (line,) = evaluate(plan)
    assert line.total.flags.losses == 2
    assert line.total.flags.missed == 0
    assert line.total.flags.alarms == 0


def test_family_of_another_world_is_refused_and_the_known_are_listed(capsys):
    assert main(["evaluate", "--world", "held", "--family", "crawl"]) == 2
    assert "one_mute" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "known"), [(["thermal", "--world", "held"], "ours, other"),
                         (["--world", "other"], "ours, held, roller")],
)  # fmt: skip
def test_a_world_of_the_other_side_is_refused(words, known, capsys):
    assert main(["evaluate", *words, "--seeds", "0-0"]) == 2
    assert f"known: {known}" in capsys.readouterr().err
