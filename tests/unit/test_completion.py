"""Completion by the shell itself, and `explain`: every code of the message set has its words."""

import re
import subprocess
import sys

import cantools
import pytest

from gateway.cli import VERBS, main
from gateway.core.codes import FaultClass, Health, Reason
from gateway.settings.config import shipped_dbc
from tests.docs.codes import PAGE, page
from tests.programs import gateway


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    path = tmp_path_factory.mktemp("shell") / "complete.sh"
    path.write_text(gateway("completion", "bash").stdout)
    return path


def completed(script, *words):
    """What bash offers for the last word."""
    function = re.search(r"complete .*-F (\w+) traction-gateway", script.read_text())
    assert function
    quoted = " ".join(f"'{word}'" for word in ("traction-gateway", *words))
    asked = (
        f"source {script}; COMP_WORDS=({quoted}); COMP_CWORD={len(words)}; "
        f'COMPREPLY=(); {function[1]}; printf "%s\\n" "${{COMPREPLY[@]}}"'
    )
    done = subprocess.run(
        ["bash", "-c", asked], capture_output=True, text=True, check=True, cwd=script.parent
    )
    return set(done.stdout.split())


def test_every_verb_is_offered(script):
    assert set(VERBS) <= completed(script, "")
    assert completed(script, "repl") == {"replay"}


def test_options_of_a_verb_are_offered_and_files_for_paths(script):
    assert completed(script, "replay", "--res") == {"--results"}
    assert completed(script, "hil", "--ju") == {"--junit"}
    assert "complete.sh" in completed(script, "replay", "comp")
    assert "complete.sh" in completed(script, "replay", "--results", "comp")
    assert completed(script, "keygen", "--no-such") == set()


@pytest.mark.parametrize("shell", ["zsh", "tcsh"])
def test_other_shells_have_one_too(shell, capsys):
    assert main(["completion", shell]) == 0
    said = capsys.readouterr().out
    assert "traction-gateway" in said
    assert "replay" in said


def test_without_shtab_it_says_what_to_install(monkeypatch, refused):
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert "needs shtab: pip install 'shtab" in refused("completion", "bash")


NOT_AVAILABLE = 15
"""All ones: the signal itself is not available, whatever it is."""


def said(capsys, *words, code=0):
    assert main(list(words)) == code
    return capsys.readouterr()


def test_every_code_of_the_message_set_is_explained(capsys):
    """The DBC's own value tables are what a person reads the codes in."""
    everything = said(capsys, "explain").out
    db = cantools.database.load_file(shipped_dbc("traction.dbc"))
    count = 0
    for message, signal in (
        ("Gateway_Adhesion", "Reason"), ("Drive1_Estimate", "Health"),
        ("Drive1_Thermal", "FaultClass"),
    ):  # fmt: skip
        choices = db.get_message_by_name(message).get_signal_by_name(signal).choices
        for number, name in choices.items():
            if number == NOT_AVAILABLE:
                continue
            assert f"{signal} {number} {name}: " in everything
            count += 1
    assert count == len(Reason) + len(Health) + len(FaultClass)


@pytest.mark.parametrize("word", ["8", "TooFewDrives", "toofewdrives", "TOO_FEW_DRIVES"])
def test_by_number_or_name(capsys, word):
    out = said(capsys, "explain", word).out
    assert out.startswith("Reason 8 TooFewDrives: too few drives")
    assert "\n  do       " in out
    assert ("FaultClass 8" in out) == (word == "8")


def test_what_there_is_not_is_refused(capsys):
    assert "did you mean 'TooFewDrives'?" in said(capsys, "explain", "TooFewDrive", code=2).err
    assert "no code '99'" in said(capsys, "explain", "8", "99", code=2).err


def test_the_page_is_what_is_printed():
    assert PAGE.read_text(encoding="utf-8") == page()


@pytest.mark.parametrize(("words", "name"), [((), "traction.dbc"), (("--fd",), "traction_fd.dbc")])
def test_the_message_set_as_a_file(capsys, tmp_path, words, name):
    path = tmp_path / "mine.dbc"
    assert "written" in said(capsys, "dbc", *words, "-o", str(path)).out
    assert path.read_bytes() == shipped_dbc(name).read_bytes()
    assert "already exists" in said(capsys, "dbc", "-o", str(path), code=2).err
    assert path.read_bytes() == shipped_dbc(name).read_bytes()
