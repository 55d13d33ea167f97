"""Accidents to real logs, DBCs and configurations; `make test-all` has 500 and 200 of them."""

from tests.foreign.mutated import campaign, faults_of


def test_logs():
    kinds, wrong = campaign(logs=120, configurations=0)
    assert len(kinds) == 9
    assert wrong == []


def test_dbcs_and_configurations():
    _, wrong = campaign(logs=0, configurations=3)
    assert wrong == []


def test_what_is_wrong_is_found(tmp_path):
    out = tmp_path / "out.log"
    out.write_text("(1.000000) can0 181#00\n")
    said = "lines: ok 2, malformed 1\nframes: read 2, written 1\n"
    faults = list(faults_of(0, said, "", out))
    assert any("left out" in text for text in faults)
    assert any("exit code 0 with 1 faults" in text for text in faults)
    assert list(faults_of(3, "", "Traceback", out))
