"""The Python API as a notebook uses it: `import gateway`, a log, tables."""

import csv

import duckdb
import pandas as pd
import pytest
from mypy import api as mypy

import gateway
from gateway.cli import main


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("api") / "drive.log"
    assert main(["sim", "release", "-o", str(path), "--duration", "3"]) == 0
    return path


@pytest.fixture(scope="module")
def run(log):
    return gateway.replay(log)


@pytest.fixture(scope="module")
def results(log):
    """The folder that the command leaves of the same log."""
    assert main(["replay", str(log), "--results", str(log.with_name("results"))]) == 0
    return log.with_name("results")


def test_its_tables_are_those_of_the_command(run, results):
    for name, table in (("flags", run.flags), ("estimates", run.estimates)):
        with (results / f"{name}.csv").open() as file:
            rows = list(csv.DictReader(file))
        assert table.schema.names == list(rows[0])
        assert table.num_rows == len(rows)
        for mine, theirs in zip(table.to_pylist(), rows, strict=True):
            for column, word in theirs.items():
                value = mine[column]
                if isinstance(value, float):
                    assert value == pytest.approx(float(word), abs=0.06), column
                else:
                    assert ("" if value is None else str(value)) == word, column


def test_events_are_the_changes_and_pandas_takes_them(run):
    events = run.events.to_pandas()
    assert list(events.columns) == ["t_s", "drive", "flag", "state"]
    assert (events["state"] == "AdhesionLost").sum() == 1
    frame = run.to_pandas()
    assert len(frame) == run.flags.num_rows
    assert {"adhesion", "load_nm"} <= set(frame.columns)


def test_the_options_of_the_page_keep_the_words_and_numbers_of_the_files(run, log, tmp_path):
    assert main(["replay", str(log), "--results", str(tmp_path)]) == 0
    kept = pd.read_csv(tmp_path / "flags.csv", keep_default_na=False, na_values=[""])
    words = run.flags.drop_columns(["t_s"]).to_pandas()
    assert (words == kept.drop(columns="t_s")).all(axis=None)
    assert "None" in set(kept["adhesion_reason"])
    # A column that is empty in more rows than DuckDB looks at.
    text = "t_s,mixed_c\n" + "1,\n" * 30_000 + "2,9.5\n3,10.5\n"
    (tmp_path / "late.csv").write_text(text)
    late = duckdb.read_csv(tmp_path / "late.csv", sample_size=-1)
    assert late.max("mixed_c").fetchall() == [(10.5,)]


def test_unknown_is_a_word_and_an_estimate_that_is_not_known_is_null(run):
    flags, estimates = run.flags, run.estimates
    assert estimates.num_rows == flags.num_rows
    assert not any(flags[name].null_count for name in flags.column_names)
    query = """
        SELECT count(*), count(load_nm), sum((adhesion = 'Unknown')::int)
        FROM flags JOIN estimates USING (t_s, drive) WHERE health = 'Unknown'
    """
    [(rows, loads, unknown)] = duckdb.sql(query).fetchall()
    assert rows == unknown > loads == 0
    assert duckdb.sql("FROM flags JOIN estimates USING (t_s, drive)").shape[0] == flags.num_rows


def test_what_was_known_stands_first(run):
    assert "known: adhesion 9" in repr(run)
    assert "thermal 0.0 % of the time" in repr(run)
    assert run.known["thermal"] == {1: 0.0, 2: 0.0, 3: 0.0}
    page = run._repr_html_()
    assert "AdhesionLost" in page
    assert "<script" not in page


def test_a_configuration_is_a_file_or_an_object(log, run, tmp_path):
    path = tmp_path / "train.toml"
    path.write_text('[adhesion]\ndetector = "vb"\n')
    by_file = gateway.replay(log, path)
    by_object = gateway.replay(log, gateway.Config(), detector="vb")
    assert by_file.config.adhesion.detector == by_object.config.adhesion.detector == "vb"
    assert by_file.flags.num_rows == run.flags.num_rows
    for config in (None, path, gateway.Config()):
        with pytest.raises(
            gateway.ConfigError, match=r"options: adhesion\.detector: .* got 'none'"
        ):
            gateway.replay(log, config, detector="none")


def test_one_error_covers_all_bad_input_and_names_no_option_of_a_command(log, tmp_path):
    two = tmp_path / "two.log"
    two.write_text("(1.000000) can0 181#00\n(1.000000) can1 181#00\n")
    text = tmp_path / "text.log"
    text.write_text("nothing\n")
    path = tmp_path / "train.toml"
    path.write_text('[dbc]\nfile = "none.dbc"\n')
    for arguments in ((two,), (text,), (tmp_path / "none.log",), (log, path)):
        with pytest.raises(gateway.InputError) as caught:
            gateway.replay(*arguments)
        assert "--log-channel" not in str(caught.value)
    with pytest.raises(gateway.InputError, match="name one with channel="):
        gateway.replay(two)
    with pytest.raises(gateway.InputError, match="no such file or scenario"):
        gateway.scenario("none")


def test_all_files_of_a_configuration_are_checked_before_it_is_refused(log, tmp_path):
    path = tmp_path / "train.toml"
    inverter = '[[drive]]\nnode = 1\n[drive.signals]\ndbc = "theirs.dbc"\n[drive.signals.use]\n'
    inverter += 'TorqueCommand = "M.S"\n'
    own, theirs, calibration = (
        f"{name}: no such file" for name in ("none.dbc", "theirs.dbc", "cal.toml")
    )
    for dbc, expected in (("none.dbc", own), ("traction.dbc", "theirs.dbc")):
        path.write_text(f'[dbc]\nfile = "{dbc}"\n[thermal]\ncalibration = "cal.toml"\n{inverter}')
        with pytest.raises(gateway.InputError) as caught:
            gateway.replay(log, path)
        assert all(part in str(caught.value) for part in (expected, theirs, calibration))


def test_a_scenario_is_judged():
    run = gateway.scenario("silent").run()
    assert run.passed
    assert run.verdicts
    assert run.flags.num_rows
    assert run.frames


def test_a_report_is_that_of_the_command(run, results, tmp_path):
    mine = run.report(tmp_path / "mine")
    assert mine.is_file()
    for name in ("flags.csv", "estimates.csv", "drive1.svg"):
        assert (tmp_path / "mine" / name).read_bytes() == (results / name).read_bytes()
    judged = gateway.scenario("silent").run()
    assert "expectations held" in judged.report(tmp_path / "hil").read_text()


def test_names_are_public():
    """Their signatures: `tests/docs/test_reference.py`; that they are right: `make lint`."""
    assert {"replay", "scenario", "Config", "Gateway", "detectors"} <= set(dir(gateway))
    assert "switching" in gateway.detectors
    with pytest.raises(AttributeError, match="nothing"):
        _ = gateway.nothing


@pytest.mark.thorough  # mypy reads the whole package anew
def test_a_type_checker_knows_them(tmp_path):
    program = tmp_path / "program.py"
    program.write_text("import gateway\nreveal_type(gateway.replay('x').report('y'))\n"
                       "gateway.replay(7)\ngateway.scenario('x').walk()\n")  # fmt: skip
    words = ["--config-file=", "--follow-imports=silent", "--cache-dir", str(tmp_path)]
    shown, _, code = mypy.run([*words, str(program)])
    assert code == 1
    assert 'Revealed type is "pathlib.Path"' in shown
    assert '"Scenario" has no attribute "walk"' in shown
    assert 'Argument 1 to "replay" has incompatible type "int"' in shown


def test_without_its_libraries_it_names_both_and_their_command(run, monkeypatch):
    monkeypatch.setattr("gateway.io.extras.find_spec", lambda _name: None)
    monkeypatch.setattr("gateway.io.extras.how_to_install", "pip install '.[{}]'".format)
    with pytest.raises(gateway.ConfigError) as caught:
        run.to_pandas()
    assert str(caught.value) == "to_pandas: needs pandas, pyarrow: pip install '.[pandas]'"
