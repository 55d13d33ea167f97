"""A CANedge's file, which it never closes, cut where the power went."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest

from dbc.candump.grammar import Verdict
from dbc.logs.opening import open_reader

FILE = Path(__file__).parents[1] / "data" / "logs" / "css_FCBF0606.MF4"


def read(path):
    reader = open_reader(path, strict=False)
    frames = list(reader)
    return frames, reader


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    frames, reader = read(FILE)
    assert not reader.truncated
    assert not reader.counts[Verdict.CUT]
    return frames


@pytest.mark.parametrize("zipped", [False, True])
@pytest.mark.parametrize("less", [1, 3, 7, 11, 12, 13, 14, 20, 1000, 20_003])
def test_frames_up_to_the_cut_and_the_word_for_it(tmp_path, whole, less, zipped):
    data = FILE.read_bytes()[:-less]
    path = tmp_path / ("a.mf4.gz" if zipped else "a.mf4")
    path.write_bytes(gzip.compress(data) if zipped else data)
    frames, reader = read(path)
    assert frames == whole[: len(frames)]
    assert len(whole) - len(frames) <= 1 + less // 10
    assert reader.counts[Verdict.CUT] == ("middle of a record" in reader.truncated)
    if less in (1, 3, 7):
        assert reader.counts[Verdict.CUT] == 1


def test_one_without_an_ending_in_its_name_is_recognised(tmp_path, whole):
    path = tmp_path / "log"
    path.write_bytes(FILE.read_bytes())
    assert read(path)[0] == whole
