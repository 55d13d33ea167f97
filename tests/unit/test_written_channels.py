"""Formats that keep a channel's number: what does not come back is counted. And MF4 that is cut."""

import gzip
from pathlib import Path

import pytest

from dbc.candump.grammar import Verdict
from dbc.frame import ERROR, FD, REMOTE, Frame
from dbc.frames import block_of
from dbc.logs.opening import open_reader
from gateway.cli import main
from gateway.logfiles.convert import frame_sink
from gateway.logfiles.frames import interface

T0 = 1_684_144_800_000_000_000
NUMBERED = [".asc", ".blf", ".trc", ".mf4"]
MOST = {".asc": 99_999, ".blf": 65_534, ".trc": 99_999, ".mf4": 255}


def there_and_back(path, names):
    """Channels of frames of every kind as candump text has them, and how many were counted."""
    kinds = [(0, b"\1"), (FD, bytes(12)), (REMOTE, b""), (ERROR, b"")]
    frames = [
        Frame(T0 + (4 * k + j) * 1_000_000, 0x181, data, flags, name)
        for k, name in enumerate(names)
        for j, (flags, data) in enumerate(kinds)
    ]
    sink = frame_sink(path, path.suffix)
    for k in range(0, len(frames), 4):
        sink.add(block_of(frames[k : k + 4]))
    sink.close()
    reader = open_reader(path, strict=True)
    found = sorted(f for block in reader.blocks() for f in block.frames())
    assert len(found) == len(frames)
    channels = [interface(f.channel) for f in found[::4]]
    return channels, sink.reduced["channel"]


@pytest.mark.parametrize("suffix", NUMBERED)
@pytest.mark.parametrize(
    ("names", "found", "lost"),
    [
        (["can0", "can1", "can0"], ["can0", "can1", "can0"], 0),
        (["vcan1", "can2", "3"], ["can1", "can2", "can3"], 0),
        (["", "can1"], ["can0", "can1"], 0),
        (["can0", "vcan0", "can0", "vcan0"], ["can0"] * 4, 2),
        (["slcan", "can0", "ecan1234567"], ["can0"] * 3, 2),
        (["", "vcan0"], ["can0"] * 2, 1),
        (["1", "can1", "vcan1"], ["can1"] * 3, 1),
    ],
)
def test_what_has_no_number_of_its_own_is_counted(tmp_path, suffix, names, found, lost):
    assert there_and_back(tmp_path / f"a{suffix}", names) == (found, 4 * lost)


@pytest.mark.parametrize("suffix", NUMBERED)
def test_the_largest_number_and_the_next(tmp_path, suffix):
    most = MOST[suffix]
    names = [f"can{most}", f"can{most + 1}", "can300" if suffix != ".mf4" else "can3"]
    found = [names[0], "can0", names[2]]
    assert there_and_back(tmp_path / f"a{suffix}", names) == (found, 4)


@pytest.mark.parametrize("suffix", NUMBERED)
def test_channels_of_a_log_that_are_not_written_do_not_count(tmp_path, suffix):
    """As with --log-channel: their names are still there."""
    block = block_of([Frame(T0, 1, b"", 0, "can0"), Frame(T0, 2, b"", 0, "vcan0")])
    sink = frame_sink(tmp_path / f"a{suffix}", suffix)
    sink.add(block.part(1, 2))
    sink.close()
    assert not sink.reduced["channel"]


@pytest.mark.parametrize("share", [99, 50, 2])
@pytest.mark.parametrize("zipped", [False, True])
def test_mf4_that_is_cut_says_so(tmp_path, capsys, share, zipped):
    log, path = tmp_path / "a.log", tmp_path / ("a.mf4.gz" if zipped else "a.mf4")
    log.write_text("".join(f"(1684144800.{k:06}) can0 123#{k:08X}\n" for k in range(500)))
    assert main(["convert", "--frames", str(log), str(tmp_path / "whole.mf4")]) == 0
    data = (tmp_path / "whole.mf4").read_bytes()
    data = data[: len(data) * share // 100]
    path.write_bytes(gzip.compress(data) if zipped else data)
    capsys.readouterr()
    assert main(["convert", str(path), str(tmp_path / "out.log")]) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert f"cannot be read: the file is cut: it has {len(data)} bytes" in told


def test_mf4_that_is_damaged_does_not_say_that_it_is_cut(tmp_path, capsys, refused):
    log, path = tmp_path / "a.log", tmp_path / "a.mf4"
    log.write_text("(1684144800.123456) can0 123#01\n")
    assert main(["convert", "--frames", str(log), str(path)]) == 0
    data = path.read_bytes()
    path.write_bytes(data.replace(b"##DG", b"##XX"))
    capsys.readouterr()
    assert "is cut" not in refused("convert", path, tmp_path / "out.log")


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
