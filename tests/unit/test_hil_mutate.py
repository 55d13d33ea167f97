"""`hil --mutate`: gateways with a fault, and whether scenarios notice them."""

import random
from functools import cache, partial

import pytest

from dbc.e2e import crc_ok
from gateway import cli
from gateway.core.codes import Flag
from gateway.hil.fitting import fitting
from gateway.hil.mutants import KINDS, decoded, encoded, mutants
from gateway.hil.mutating import judged, record
from sim.scenario import builtin

SUITE = ("wet_one", "release", "silent")


@cache
def run(name):
    scenario = builtin(name)
    return record(name, scenario, *fitting(None, scenario))


def suite(*names):
    return [run(name) for name in names]


def values(sent, name):
    return [one.values[name] for one in sent if name in one.values]


def test_frames_that_nobody_alters_are_the_gateways_to_the_byte():
    one = run("wet_one")
    again = encoded(one.codec, one.sent)
    assert decoded(one.codec, again) == one.sent
    assert len(again) > 800
    assert all(crc_ok(one.codec.by_id[frame.can_id], frame.data) for frame in again)
    assert one.passed


def name_of(kind):
    return kind.keywords["what"] if isinstance(kind, partial) else kind.__name__.strip("_")


@pytest.mark.parametrize("kind", KINDS, ids=name_of)
def test_each_kind_alters_some_run_and_is_noticed_by_some_or_is_known_to_slip_through(kind):
    found = [judged(kind(random.Random(seed)), suite(*SUITE)) for seed in range(8)]
    assert any(result.alters for result in found)
    if name_of(kind) != "lost":  # up to two frames in a row may be lost: the protection's own rule
        assert any(result.noticed_by for result in found)


def test_a_mutant_does_what_it_says():
    one = run("wet_one")
    for mutant in mutants(200, 5):
        altered = mutant.alter(one.sent, one.nodes)
        if mutant.text == "adhesion of drive 2 is never bad":
            assert Flag.BAD not in values(altered, "Adhesion2")
            assert values(altered, "Adhesion1") == values(one.sent, "Adhesion1")
        elif mutant.text == "flags 80 ms late":
            shift = {b.t_ns - a.t_ns for a, b in zip(one.sent, altered, strict=True)}
            assert shift == {80_000_000}
        elif mutant.text == "adhesion of drives 2 and 3 is swapped":
            assert values(altered, "Adhesion3") == values(one.sent, "Adhesion2")
        elif mutant.text == "one flag frame in 10 lost":
            assert len(altered) == len(one.sent) - len(one.sent) // 10
    assert len(mutants(200, 5)) > 60


def test_the_same_seed_gives_the_same_mutants():
    assert [one.text for one in mutants(20, 3)] == [one.text for one in mutants(20, 3)]
    assert [one.text for one in mutants(20, 3)] != [one.text for one in mutants(20, 4)]


def test_a_suite_without_a_scenario_notices_less():
    chosen = mutants(20, 1)

    def noticed(*names):
        return {m.text for m in chosen if judged(m, suite(*names)).noticed_by}

    whole = noticed(*SUITE)
    for left_out in SUITE:
        assert noticed(*(name for name in SUITE if name != left_out)) <= whole
    assert noticed("silent") < whole


def test_the_command_names_what_slips_through_and_who_would_have_seen_it(capsys):
    words = ["hil", "release", "--mutate", "3", "--mutate-seed", "2"]
    assert cli.main(words) == 0
    out = capsys.readouterr().out
    assert out.count("\n") >= 5
    assert "of 3 mutants noticed" in out
    assert "would have noticed: " in out
    assert cli.main([*words, "--expect-noticed", "100"]) == 1


def test_a_suite_that_fails_as_it_is_is_not_judged(tmp_path, capsys):
    text = (
        'title = "Never"\nseed = 1\nduration_s = 2\ndrives = 3\n'
        '[[expect]]\nflag = "adhesion"\nis = "bad"\ndrive = 1\nafter_s = 1.0\nwithin_ms = 100\n'
    )
    (tmp_path / "never.toml").write_text(text)
    assert cli.main(["hil", str(tmp_path / "never.toml"), "--mutate", "3"]) == 1
    assert "without a mutant" in capsys.readouterr().out


def test_a_bus_and_mutants_do_not_go_together(capsys):
    words = ["hil", "wet_one", "--mutate", "3", "-i", "virtual", "-c", "x"]
    assert cli.main(words) == 2
    assert "virtual clock" in capsys.readouterr().err
