"""Files are short, and the few long ones say why at their top."""

import statistics
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDERS = ("gateway", "dbc", "sim", "estimators")
MOST, USUAL, TOP = 400, 150, 20


def lines():
    paths = [p for folder in FOLDERS for p in (ROOT / folder).rglob("*.*")]
    return {p: p.read_text().splitlines() for p in paths if p.suffix in (".py", ".c", ".h")}


def test_a_long_file_says_why():
    long = {p: text for p, text in lines().items() if len(text) > MOST}
    assert len(long) < 5
    silent = [p for p, text in long.items() if "Longer than other" not in " ".join(text[:TOP])]
    assert not silent


def test_the_usual_file_is_short():
    sizes = [len(text) for text in lines().values()]
    assert len(sizes) > 200
    assert statistics.median(sizes) <= USUAL
