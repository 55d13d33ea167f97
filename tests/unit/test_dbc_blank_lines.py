"""Blank lines go, every other line stays, wherever the pieces end that are read at once."""

from __future__ import annotations

import gzip
import io
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dbc import blank_lines
from dbc.blank_lines import without_blank_lines
from dbc.python_can_logs import read_any

LINES = st.lists(st.sampled_from(["", " ", "x", "é", "a longer line"]), max_size=40)


@given(LINES, st.lists(st.sampled_from(["\n", "\r\n", "\r"]), min_size=1), st.integers(1, 9))
def test_lines_are_those_that_are_not_blank(lines: list[str], ends: list[str], piece: int) -> None:
    text = "".join(line + ends[k % len(ends)] for k, line in enumerate(lines))
    file = io.TextIOWrapper(io.BytesIO(text.encode()), encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(blank_lines, "_PIECE", piece)
        read = without_blank_lines(file).read().splitlines()
    assert read == [line for line in lines if line]


def test_the_last_line_keeps_that_it_has_no_end() -> None:
    file = io.TextIOWrapper(io.BytesIO(b"a\n\n\nb"), encoding="utf-8")
    assert without_blank_lines(file).read() == "a\nb"


@pytest.mark.timeout(60)  # of minutes where python-can looks at every line
@pytest.mark.parametrize("suffix", [".asc", ".trc", ".asc.gz"])
def test_readers_of_others_are_given_none(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"log{suffix}"
    text = b"\n" * (200 << 20)
    path.write_bytes(gzip.compress(text, 1) if suffix.endswith(".gz") else text)
    assert list(read_any(path)) == []
