"""What share of the time flags knew; scenarios that would judge nothing are refused."""

import csv

import pytest

from dbc.frame import SECOND
from gateway.cli import main
from gateway.core.codes import Flag
from gateway.reports import known
from gateway.reports.expectations import judge
from sim.scenario import Expect, ScenarioError, parse


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("known") / "drive.log"
    assert main(["sim", "release", "-o", str(path), "--duration", "4"]) == 0
    return path


@pytest.fixture
def foreign(tmp_path):
    """A bus on which no drive of ours speaks."""
    path = tmp_path / "other.log"
    path.write_text("".join(f"({k / 100:.6f}) can0 123#00\n" for k in range(200)))
    return path


def replayed(capsys, *words):
    """Exit code, stdout, stderr."""
    code = main(["replay", *map(str, words)])
    return code, *capsys.readouterr()


def test_the_shares_are_those_of_the_table_of_flags(capsys, log, tmp_path):
    code, out, _ = replayed(capsys, log, "--results", tmp_path)
    assert code == 0
    with (tmp_path / "flags.csv").open() as file:
        rows = list(csv.DictReader(file))
    first = [row for row in rows if row["drive"] == "1"]
    share = 100.0 * sum(row["adhesion"] != "Unknown" for row in first) / len(first)
    line = next(line for line in out.splitlines() if line.startswith("known: adhesion "))
    assert float(line.split()[2]) == pytest.approx(share, abs=0.5)
    assert "thermal 0.0 % of the time" in line
    head = (tmp_path / "report.md").read_text().splitlines()[2]
    assert head.startswith("> **Adhesion, known for 9")
    assert "1 loss flagged. Thermal state was never known: there is no result.**" in head


def test_where_nothing_was_known_nothing_is_good(capsys, foreign, tmp_path):
    code, out, err = replayed(capsys, foreign, "--results", tmp_path)
    assert code == 0
    assert "known: adhesion 0.0 %; thermal 0.0 % of the time" in out
    assert "warning: adhesion was never known (Starting), so nothing was flagged; wrong" in err
    assert "run `traction-gateway check CONFIG --log " in err
    assert f"{foreign}`, or see `traction-gateway explain Starting`" in err
    assert "traction-gateway calibrate" in err
    head = (tmp_path / "report.md").read_text().splitlines()[2]
    assert head.startswith("> **Adhesion was never known: there is no result. Thermal")
    assert "good" not in head.lower()


@pytest.mark.parametrize(
    ("expected", "code"),
    [(("90",), 0), (("99.9",), 1), (("90", "thermal=1"), 1), (("adhesion=90", "thermal=0"), 0)],
)
def test_less_than_is_expected_is_a_failure(capsys, log, expected, code):
    words = [word for one in expected for word in ("--expect-known", one)]
    done, _, err = replayed(capsys, log, *words)
    assert done == code
    assert ("of the time, expected" in err) == bool(code)


def test_a_drive_that_is_not_in_the_log_is_named(capsys, log, tmp_path):
    config = tmp_path / "t.toml"
    config.write_text("".join(f"[[drive]]\nnode = {node}\n" for node in (1, 2, 9, 12)))
    code, _, err = replayed(capsys, log, "--config", config, "--results", tmp_path / "r")
    assert code == 0
    assert "warning: adhesion of drives 9, 12 was never known (Starting), so nothing was" in err
    assert "note: thermal was never known (Starting, Config)" in err
    head = (tmp_path / "r" / "report.md").read_text().splitlines()[2]
    assert "% of the time, never of drives 9, 12: 1 loss flagged" in head


def test_of_a_foreign_bus_nothing_is_known(capsys, foreign):
    code, _, err = replayed(capsys, foreign, "--expect-known", "0.1")
    assert code == 1
    assert err.count("was known for 0.0 % of the time, expected 0.1 %") == 3


def test_it_is_told_of_a_log_of_which_too_much_was_dropped_as_well(capsys, log, tmp_path):
    half = tmp_path / "half.log"
    half.write_text(log.read_text() + "no frame\n" * 2000)
    code, out, err = replayed(capsys, half)
    assert code == 1
    assert "known: adhesion 9" in out
    assert "warning" in err


@pytest.mark.parametrize(("word", "problem"), [
    ("sensor=90", "'sensor' is no flag: expected adhesion or thermal"),
    *((word, "is not a percentage") for word in ("101", "-1", "nan", "many", "=", "thermal=")),
])  # fmt: skip
def test_what_is_no_percentage_of_a_flag_is_refused(capsys, log, word, problem):
    with pytest.raises(SystemExit) as ended:
        replayed(capsys, log, f"--expect-known={word}")
    assert ended.value.code == 2
    assert problem in capsys.readouterr().err


def test_a_flag_that_knew_at_the_end_knew_until_the_end():
    rows = [(0, 1, "adhesion", "Unknown"), (40, 1, "adhesion", "Adhering"),
            (60, 1, "adhesion", "AdhesionLost"), (0, 2, "adhesion", "Unknown")]  # fmt: skip
    shares = known.shares(rows, (1, 2), 0, 100)
    assert shares == {"adhesion": {1: 60.0, 2: 0.0}, "thermal": {1: 0.0, 2: 0.0}}
    assert known.text(shares) == (
        "adhesion 60.0 % (drive 1), 0.0 % (drive 2); thermal 0.0 % of the time"
    )
    assert known.silent(shares) == {"adhesion": [2], "thermal": [1, 2]}


LOSS = {"at_s": 1.0, "drive": "all", "kind": "adhesion_loss", "depth": 0.5}
GOOD = {"flag": "adhesion", "is": "good", "after_s": 0.5}


def problems(expect, **changes):
    table = {"title": "a run", "duration_s": 2.0, "expect": [expect], **changes}
    with pytest.raises(ScenarioError) as error:
        parse(table)
    return "\n".join(error.value.problems)


def test_others_where_events_name_all_drives():
    assert "no others, because" in problems({**GOOD, "drive": "others"}, event=[LOSS])
    parse({"title": "a run", "duration_s": 2.0, "expect": [{**GOOD, "drive": "others"}],
           "event": [{**LOSS, "drive": 1}]})  # fmt: skip


def test_a_time_that_goes_beyond_the_end():
    assert "until 2.501 s, but the scenario ends at 2 s" in problems({**GOOD, "within_ms": 2001})
    parse({"title": "a run", "duration_s": 2.0, "expect": [{**GOOD, "within_ms": 1500}]})


def test_a_scenario_without_expectations_is_no_test(tmp_path, refused):
    path = tmp_path / "none.toml"
    path.write_text('title = "nothing"\nduration_s = 1.0\n')
    assert "no [[expect]]: nothing would be judged" in refused("hil", path)
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
