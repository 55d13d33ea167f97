"""`hil --mutate`: gateways with a fault, and whether scenarios notice them."""

import random
from functools import cache, partial

import pytest

from dbc.e2e import crc_ok
from gateway import cli
from gateway.core.codes import Flag
from gateway.hil.fitting import fitting
from gateway.hil.mutants import KINDS, Altered, decoded, encoded, mutants
from gateway.hil.mutants import altered as whole
from gateway.hil.mutating import judged, record
from gateway.hil.pytest.bench import HilBench
from sim.scenario import builtin
from tests.unit.test_testing import run_pytest

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


@pytest.mark.parametrize("kind", [k for k in KINDS if name_of(k) != "thresholds"], ids=name_of)
def test_each_kind_alters_some_run_and_is_noticed_by_some_or_is_known_to_slip_through(kind):
    found = (judged(kind(random.Random(seed)), suite(*SUITE)) for seed in range(8))
    if name_of(kind) != "lost":  # up to two frames in a row may be lost: the protection's own rule
        assert any(result.noticed_by for result in found)
    else:
        assert any(result.alters for result in found)


def test_a_mutant_does_what_it_says():
    one = run("wet_one")
    for mutant in mutants(200, 5):
        altered = whole(mutant, one.sent, one.nodes)
        if mutant.text == "adhesion of the second drive is never bad":
            assert Flag.BAD not in values(altered, "Adhesion2")
            assert values(altered, "Adhesion1") == values(one.sent, "Adhesion1")
        elif mutant.text == "flags 80 ms late":
            shift = {b.t_ns - a.t_ns for a, b in zip(one.sent, altered, strict=True)}
            assert shift == {80_000_000}
        elif mutant.text == "adhesion of the second and the third drive is swapped":
            assert values(altered, "Adhesion3") == values(one.sent, "Adhesion2")
        elif mutant.text == "one flag frame in 10 lost":
            assert len(altered) == len(one.sent) - len(one.sent) // 10
    assert len(mutants(200, 5)) > 60


def test_tick_by_tick_the_frames_are_those_of_the_whole_run():
    one = run("wet_one")
    frames = encoded(one.codec, one.sent)
    last = frames[-1].t_ns + 1_000_000_000
    for mutant in mutants(30, 4):
        device, out = Altered(mutant, one.codec, one.nodes), []
        for frame in frames:
            out += device([frame], frame.t_ns)
        out += device([], last)
        assert sorted(out) == sorted(encoded(one.codec, whole(mutant, one.sent, one.nodes)))


def test_a_gateway_that_waits_longer_or_is_surer_than_its_settings_say_may_be_noticed():
    texts = {
        result.mutant.text: result.noticed_by
        for result in (
            judged(one, suite("wet_one"))
            for one in mutants(400, 7)
            if one.settings and "10 times" in one.text
        )
    }
    assert texts == {
        "a loss is raised after 10 times the time": "wet_one",
        "adhesion is good again after 10 times the time": None,
        "thermal fault comes and goes after 10 times the time": None,
        "a loss is raised with 10 times less doubt": None,
    }


def test_the_same_seed_gives_the_same_mutants():
    assert [one.text for one in mutants(20, 3)] == [one.text for one in mutants(20, 3)]
    assert [one.text for one in mutants(20, 3)] != [one.text for one in mutants(20, 4)]


def test_a_suite_without_half_of_its_expectations_scores_lower_in_each_of_twenty_trials():
    chosen = [one for one in mutants(30, 0) if not one.settings]
    noticed = []
    for name in SUITE:
        for expect in run(name).scenario.expect:
            alone = run(name).scenario.model_copy(update={"expect": [expect]})
            part = [run(name)._replace(scenario=alone)]
            noticed.append({one.text for one in chosen if judged(one, part).noticed_by})
    whole = {one.text for one in chosen if judged(one, suite(*SUITE)).noticed_by}
    assert set().union(*noticed) == whole
    for seed in range(20):
        kept = random.Random(seed).sample(noticed, len(noticed) // 2)
        assert len(set().union(*kept)) < len(whole), seed


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


def test_a_bus_and_mutants_do_not_go_together(refused):
    words = ["hil", "wet_one", "--mutate", "3", "-i", "virtual", "-c", "x"]
    assert "virtual clock" in refused(*words)


TESTS = """
def test_a_lost_wheel_is_flagged(inverter, gateway_flags):
    inverter.lose_adhesion(drive=2, for_s=1.0)
    gateway_flags.expect_lost(drive=2, within_ms=60)
    gateway_flags.expect_never_lost(drive=1, for_ms=300)


def test_a_silent_drive_is_unknown(inverter, gateway_flags):
    inverter.silence(drive=1)
    gateway_flags.expect_unknown(drive=1, within_ms=60)
"""


def test_tests_for_pytest_are_run_with_each_mutant(tmp_path, capsys):
    (tmp_path / "test_own.py").write_text(TESTS)
    assert cli.main(["hil", str(tmp_path), "--mutate", "2", "--mutate-seed", "2"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "test_a_silent_drive_is_unknown adhesion of the first drive is good where it should be "
        "unknown",
        "test_a_lost_wheel_is_flagged flags 80 ms late",
        "2 of 2 mutants noticed (100 %)",
    ]


def test_tests_that_fail_or_are_none_are_not_judged(tmp_path, capsys, refused):
    path = tmp_path / "test_own.py"
    path.write_text("def test_never(gateway_flags):\n    assert False\n")
    assert cli.main(["hil", str(path), "--mutate", "2"]) == 1
    assert "FAIL without a mutant: test_never" in capsys.readouterr().out
    path.write_text("")
    assert "no tests ran" in refused("hil", path, "--mutate", "2")
    assert "run tests with `pytest`" in refused("hil", path)


def test_a_fault_that_does_not_exist_is_refused(tmp_path):
    for word in ("0", "two", "1:x", "100000"):
        done = run_pytest(tmp_path, f"--hil-mutant={word}")
        assert done.returncode == pytest.ExitCode.USAGE_ERROR
        assert f"--hil-mutant {word}: expected NUMBER" in done.stderr


def test_the_drives_of_a_test_receive_the_altered_frames():
    scenario = builtin("wet_one")
    accused = next(
        one for one in mutants(400, 1)
        if one.text == "adhesion of the first drive is bad where it should be good"
    )  # fmt: skip
    heard = []
    for mutant in (None, accused):
        config, codec = fitting(None, scenario)
        bench = HilBench(scenario, config, codec, None, mutant)
        bench.run(1.5)
        spec = codec.by_name["Drive1_Status"]
        values = [codec.decode(spec, f.data) for f in bench.frames if f.can_id == spec.can_id]
        heard.append(values[-1]["TorqueCommand"].value)
    assert abs(heard[1]) < abs(heard[0])
