"""`explain` and `dbc`: what codes mean, and the message set, out of the installed package."""

from __future__ import annotations

import cantools
import pytest

from gateway.cli import main
from gateway.core.codes import FaultClass, Health, Reason
from gateway.settings.config import shipped_dbc
from tests.docs.codes import PAGE, page

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
    assert out.startswith("Reason 8 TooFewDrives: too few drives are known")
    assert "\n  do       " in out
    assert ("FaultClass 8" in out) == (word == "8")


def test_what_there_is_not_is_refused(capsys):
    assert "did you mean TooFewDrives?" in said(capsys, "explain", "TooFewDrive", code=2).err
    assert "no code 99" in said(capsys, "explain", "8", "99", code=2).err


def test_the_page_is_what_is_printed():
    assert PAGE.read_text(encoding="utf-8") == page()


@pytest.mark.parametrize(("words", "name"), [((), "traction.dbc"), (("--fd",), "traction_fd.dbc")])
def test_the_message_set_as_a_file(capsys, tmp_path, words, name):
    path = tmp_path / "mine.dbc"
    assert "written" in said(capsys, "dbc", *words, "-o", str(path)).out
    assert path.read_bytes() == shipped_dbc(name).read_bytes()
    assert "is there already" in said(capsys, "dbc", "-o", str(path), code=2).err
    assert path.read_bytes() == shipped_dbc(name).read_bytes()
