"""Completion by the shell itself: the script is sourced and asked, as a person's tab would."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

from gateway.cli import VERBS, main


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    path = tmp_path_factory.mktemp("shell") / "complete.sh"
    done = subprocess.run(
        [sys.executable, "-m", "gateway", "completion", "bash"], capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    path.write_text(done.stdout)
    return path


def completed(script, *words: str) -> set[str]:
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


def test_without_shtab_it_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert main(["completion", "bash"]) == 2
    assert "needs shtab: pip install 'shtab" in capsys.readouterr().err
