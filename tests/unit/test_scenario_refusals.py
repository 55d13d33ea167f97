"""What a scenario file must not contain, and how `hil` says it: line, key, value, cure."""

import pytest

from dbc.frame import SECOND
from gateway.cli import main
from gateway.core.codes import Flag
from gateway.reports.expectations import judge
from sim.scenario import Expect

HEAD = 'title = "t"\nduration_s = 3\n'
BAD = '[[expect]]\nflag = "adhesion"\nis = "bad"\n'
LOSS = '[[event]]\nat_s = 2.0\nkind = "adhesion_loss"\n'
SILENT = '[[event]]\nkind = "silent"\n'


@pytest.fixture
def refused(tmp_path, capsys):
    def run(text):
        path = tmp_path / "a.toml"
        path.write_text(HEAD + text)
        assert main(["hil", str(path)]) == 2
        out, err = capsys.readouterr()
        assert not out
        assert err.startswith(f"traction-gateway: {path}: line ")
        return err.partition("a.toml: ")[2].strip()

    return run


@pytest.mark.parametrize(
    ("text", "message"),
    [
        # Expectations that cannot fail, or check less than they state.
        (
            '[[expect]]\nflag = "thermal"\nis = "unknown"\nwithin_ms = 100\n',
            "line 3: expect[0].after_s: every flag is unknown at the start, so this always "
            "holds: expected 0.1 s or more, after the flag should have become known",
        ),
        (
            BAD + "never = true\nafter_s = 2.9999\n",
            "line 7: expect[0].after_s: 2.9999 s is not a tick (0.01 s) before the end at 3 s: "
            "it would have no effect",
        ),
        (
            '[[expect]]\nflag = "common_mode"\nis = "bad"\ndrive = 2\n',
            "line 6: expect[0].drive: common_mode is a flag of the whole train: leave drive "
            "out, or expect adhesion or thermal of a drive",
        ),
        (
            'traffic = "slow"\n' + BAD + "never = true\n",
            "line 5: expect[0].flag: adhesion stays unknown with traffic = 'slow'",
        ),
        # Events without effect, or with less than they state.
        (
            LOSS + "depth = 0.0\n" + BAD,
            "line 6: event[0].depth: 0 has no effect: expected more than 0, up to 1",
        ),
        (
            '[[event]]\nat_s = 1\nkind = "overheating"\nvalue = 0\n' + BAD,
            "line 6: event[0].value: 0 has no effect",
        ),
        (
            SILENT + "at_s = 2.995\n" + BAD,
            "line 5: event[0].at_s: 2.995 s is not a tick (0.01 s) before the end at 3 s: it "
            "would have no effect",
        ),
        (
            "[[load.curve]]\ndrive = 1\nat_s = 3.5\nfor_s = 1\namount = 0.1\n" + BAD,
            "line 5: load.curve[0].at_s: 3.5 s is not a tick (0.01 s) before the end at 3 s: it "
            "would have no effect",
        ),
        (
            '[load]\nkind = "preset"\n[[load.disturbance]]\ndrive = 1\nat_s = 3\nfor_s = 1\n'
            "amplitude_nm = 1\n" + BAD,
            "line 7: load.disturbance[0].at_s: 3 s is not a tick (0.01 s) before the end at 3 s: "
            "it would have no effect",
        ),
        # Values of another type or size.
        (
            'motor = "nosuch"\n' + BAD,
            "line 3: motor: expected [motor] name = \"..\", one of bench, large, "
            "traction_350kw; got motor = 'nosuch'",
        ),
        (
            '[motor]\nname = "nosuch"\n' + BAD,
            "line 4: motor.name: unknown motor 'nosuch': one of bench, large, traction_350kw; "
            "for another give its parameters",
        ),
        (
            SILENT + 'at_s = "2 s"\n' + BAD,
            "line 5: event[0].at_s: expected a number of seconds, got '2 s': write it without "
            "quotes and unit",
        ),
        (SILENT + BAD, "line 3: event[0].at_s: expected, but missing"),
        (
            LOSS + "depth = 90\n" + BAD,
            "line 6: event[0].depth: expected 0 to 1, got 90.0: a fraction: 90 % is 0.9",
        ),
        (
            '[[event]]\nat_s = 1\nkind = "rail"\nvalue = "icy"\n' + BAD,
            "line 6: event[0].value: unknown rail condition 'icy': one of dry, wet, leaves or a "
            "number",
        ),
        (
            BAD + 'drive = "two"\n',
            "line 6: expect[0].drive: expected a whole number, or 'all' or 'others', got 'two'",
        ),
        ("drives = 1.5\n" + BAD, "line 3: drives: expected a whole number, got 1.5"),
        ("drives = 17\n" + BAD, "line 3: drives: expected at most 16, got 17"),
        (
            "load = 3\n" + BAD,
            "line 3: load: expected a table, got 3: write [load], and its keys below",
        ),
        (
            '[load]\nrail = "ice"\n' + BAD,
            "line 4: load.rail: unknown rail condition 'ice': one of dry, wet, leaves or a number",
        ),
        (BAD + 'never = "perhaps"\n', "line 6: expect[0].never: expected true or false, got "
         "'perhaps'"),
        ("event = 3\n" + BAD, "line 3: event: expected a list, got 3: write it in [ ], or "
         "[[event]]"),
    ],
)  # fmt: skip
def test_one_line_names_the_key_the_value_and_the_cure(refused, text, message):
    assert refused(text) == message


def test_a_file_that_is_not_there(tmp_path, capsys):
    assert main(["hil", str(tmp_path / "nosuchfile.toml")]) == 2
    assert "nosuchfile.toml: no such file; there are bearing, " in capsys.readouterr().err


class Track:
    nodes = (1,)

    def __init__(self, states):
        seen = [(k * SECOND, state) for k, state in enumerate(states)]
        self.seen = {("adhesion", 1): seen}


UNKNOWN, GOOD = Flag.UNKNOWN, Flag.GOOD


@pytest.mark.parametrize(
    ("state", "states", "passed"),
    [
        ("bad", [UNKNOWN, UNKNOWN, UNKNOWN], False),
        ("bad", [GOOD, UNKNOWN, UNKNOWN], False),
        ("bad", [UNKNOWN, UNKNOWN, GOOD], True),
        # During a slide the flag may become unknown, but must not become good.
        ("good", [GOOD, UNKNOWN, UNKNOWN], True),
        ("good", [UNKNOWN, UNKNOWN, UNKNOWN], False),
        ("unknown", [UNKNOWN, GOOD, GOOD], True),
    ],
)
def test_never_proves_nothing_about_a_flag_that_was_unknown(state, states, passed):
    given = {"flag": "adhesion", "is": state, "never": True, "after_s": 1.0}
    (verdict,) = judge([Expect.model_validate(given)], Track(states), set(), 0)
    assert verdict.passed is passed
    if not passed:
        assert verdict.detail == (
            "not seen, but the flag was unknown for all that time, which proves nothing"
        )


def test_hil_fails_on_a_thermal_flag_without_calibration(tmp_path, capsys):
    config, path = tmp_path / "train.toml", tmp_path / "a.toml"
    config.write_text("".join(f'[[drive]]\nnode = {n}\nmotor = "bench"\n' for n in (1, 2)))
    path.write_text(
        'title = "t"\nduration_s = 1\ndrives = 2\n'
        '[[expect]]\nflag = "thermal"\nis = "bad"\nnever = true\n'
    )
    assert main(["hil", str(path), "--config", str(config)]) == 1
    text = capsys.readouterr().out
    assert text.count("which proves nothing") == 2
    assert "ok  " not in text
