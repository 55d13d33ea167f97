"""The examples that ship do what they promise: CI, container, Robot Framework."""

import json
import os
import re
import shlex
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
import yaml

from gateway import cli
from tests.programs import ended

ROOT = Path(__file__).parents[2]


@pytest.fixture
def examples(tmp_path, monkeypatch, capsys):
    """As the verb writes them; the folder of work."""
    monkeypatch.chdir(tmp_path)
    assert cli.main(["examples", "-o", "examples"]) == 0
    assert "written: examples/train.toml" in capsys.readouterr().out
    return tmp_path / "examples"


def test_what_is_written_is_what_ships_and_nothing_is_overwritten(examples, refused):
    for path in (ROOT / "examples").rglob("*.*"):
        if "__pycache__" not in path.parts:
            copied = examples / path.relative_to(ROOT / "examples")
            assert copied.read_bytes() == path.read_bytes()
    (examples / "train.toml").write_text("mine")
    assert "already exists" in refused("examples", "-o", "examples")
    assert (examples / "train.toml").read_text() == "mine"


def test_the_steps_of_the_workflow_run_and_make_its_artefacts(examples):
    workflow = yaml.safe_load((examples / "ci" / "github.yml").read_text())
    steps = workflow["jobs"]["test"]["steps"]
    runs = [shlex.split(step["run"]) for step in steps if "run" in step]
    assert runs[0][:2] == ["pip", "install"]
    assert runs[1] == ["traction-gateway", "examples", "-o", "examples"]
    for words in runs[2:]:
        module = ["gateway"] if words[0] == "traction-gateway" else ["pytest", "-c", "/dev/null"]
        done = ended(
            "-m", *module, *words[1 if module == ["gateway"] else 3 :], folder=examples.parent
        )
        assert done.returncode == 0, done.stdout + done.stderr
    for name in steps[-1]["with"]["path"].split():
        assert (examples.parent / name).exists()
    names = {case.get("name") for case in ET.parse("report.xml").iter("testcase")}
    assert {"0-adhesion-3-bad", "1-adhesion-others-never-bad"} <= names
    assert len(names) == 6


def test_the_commands_of_the_container_are_ours(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "examples" / "container" / "Containerfile").read_text()
    lines = re.findall(r"^#   docker run .* traction-gateway (.*)$", text, re.MULTILINE)
    assert len(lines) == 3
    for line in map(shlex.split, lines):
        cli._parser(line).parse_args(line)
        if line[0] != "run":
            assert cli.main(line) == 0
    assert (tmp_path / "results" / "report.html").exists()
    assert 'ENTRYPOINT ["traction-gateway"]' in text
    # The wheels of both processors are there; the one of this machine is installed, with extras.
    command = re.search(r"^RUN pip install (.*)$", text, re.MULTILINE)[1].replace("/wheels", ".")
    for machine in ("x86_64", "aarch64"):
        (tmp_path / f"traction_gateway-0.1.0-cp311-abi3-manylinux2014_{machine}.whl").touch()
    shown = subprocess.run(
        ["sh", "-c", f"echo {command}"], capture_output=True, text=True, check=True
    )
    name = f"./traction_gateway-0.1.0-cp311-abi3-manylinux2014_{os.uname().machine}.whl"
    assert shown.stdout.split()[1:] == [f"{name}[pictures,mcap]"]


def test_the_robot_suite_passes_and_one_that_is_wrong_fails(examples):
    words = ("robot", "--outputdir", "out", "--xunit", "report.xml", "examples/robot")
    done = ended("-m", *words, folder=examples.parent)
    assert done.returncode == 0, done.stdout
    assert "2 tests, 2 passed" in done.stdout
    suite = examples / "robot" / "traction.robot"
    text = suite.read_text()
    suite.write_text(
        text.replace("after_s=3.0", "after_s=4.0").replace("Known    90", "Known    101")
    )
    done = ended("-m", *words, folder=examples.parent)
    assert "2 tests, 0 passed, 2 failed" in done.stdout


@pytest.mark.parametrize("name", ["replay", "detector"])
def test_a_notebook_runs_from_its_first_cell_to_its_last(name, examples, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    notebook = json.loads((examples / "notebooks" / f"{name}.ipynb").read_text())
    names = {}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)
            assert cell["outputs"] == [], "no result of somebody's machine ships"
    if name == "detector":
        events = names["own"].events.to_pandas()
        lost = events[events["state"] == "AdhesionLost"]
        assert set(lost["drive"]) == {1}
    else:
        assert set(names["losses"]["drive"]) == {1}
        assert all(len(part) >= 3 for part in names["changes"].values())
        assert names["report"].is_file()
        assert names["axis"].get_ylabel() == "load / Nm"
