"""Replay: ticks, dropped and skipped time, whatever the size of the blocks."""

import io

import pytest

from dbc.block import in_blocks
from dbc.candump import Reader, format_frame
from dbc.frame import MS, SECOND, Frame
from gateway.core import Gateway
from gateway.drivers.replay import BadLogError, OneChannel, open_log, replay
from tests.sender import SteadyDrive, codec_for

CODEC = codec_for()
START = 1_700_000_000 * SECOND


def log(cycles=40, channel="can0"):
    motors = [SteadyDrive(CODEC, n, 80.0 * n, 15.0, theta=n) for n in (1, 2, 3)]
    sent = [f for k in range(cycles) for motor in motors for f in motor.frames(k)]
    return [f._replace(t_ns=f.t_ns + START, channel=channel) for f in sent]


def run(frames, size, wanted=None):
    from gateway.config import parse

    config = parse({})
    said = []
    done = replay(
        OneChannel(in_blocks(frames, size), wanted),
        lambda start: Gateway(config, CODEC, start),
        10 * MS,
        lambda now, out, _view: said.append((now, out)),
    )
    return done, said


@pytest.mark.parametrize("size", [1, 7, 33])
def test_the_size_of_blocks_changes_nothing(size):
    frames = log()
    frames[50:50] = [frames[20], frames[3]._replace(t_ns=START - SECOND)]
    whole, wanted = run(frames, 10_000)
    done, said = run(frames, size)
    assert said == wanted
    assert done[:5] == whole[:5]
    assert done.gateway.inbox.counts == whole.gateway.inbox.counts
    assert whole.gateway.inbox.counts["time_back"] == 2
    assert whole.frames == whole.gateway.inbox.counts["received"] == len(frames)


def test_ticks_are_on_the_grid_of_the_first_frame_to_the_first_after_the_last():
    frames = log()
    _, said = run(frames, 100)
    stamps = [now for now, _ in said]
    assert stamps == list(range(frames[0].t_ns, frames[-1].t_ns + 10 * MS, 10 * MS))
    assert stamps[-2] < frames[-1].t_ns <= stamps[-1]


@pytest.mark.parametrize("size", [1, 1000])
def test_a_long_hole_is_skipped_on_the_grid_once_nothing_is_good(size):
    frames = log(20)
    late = [f._replace(t_ns=f.t_ns + 3600 * SECOND + 3 * MS) for f in log(20)]
    done, said = run(frames + late, size)
    stamps = [now for now, _ in said]
    assert len(stamps) < 40
    assert all((t - stamps[0]) % (10 * MS) == 0 for t in stamps)
    assert stamps[-1] >= late[-1].t_ns
    assert done.ticks == len(stamps)


def test_a_hole_of_seconds_is_ticked_through():
    frames = [log(1)[0], log(1)[0]._replace(t_ns=START + 5 * SECOND)]
    done, _ = run(frames, 10)
    assert done.ticks in (500, 501)


def test_several_channels_must_be_named():
    frames = [f for pair in zip(log(5), log(5, "can1"), strict=True) for f in pair]
    with pytest.raises(BadLogError, match="several channels \\(can0, can1"):
        run(frames, 4)
    done, said = run(frames, 4, "can1")
    assert (done.channel, done.frames) == ("can1", len(frames) // 2)
    assert said == run(log(5), 4)[1]


def test_a_log_without_frames_is_refused():
    with pytest.raises(BadLogError, match="no frame"):
        run([], 10)
    with pytest.raises(BadLogError, match="no channel can9 in the log; it has can0, can1"):
        run([Frame(START, 1, channel=name) for name in ("can1", "can0")], 10, "can9")


def test_a_file_that_is_no_log_is_told_by_its_first_line(tmp_path):
    path = tmp_path / "plain.log"
    path.write_text("  can0  181   [8]  00 01 02 03 04 05 06 07\n" * 3)
    with pytest.raises(BadLogError, match=r"not one of its 3 lines .* malformed: can0  181"):
        list(open_log(path, strict=False).blocks)
    path.write_text("")
    assert list(open_log(path, strict=False).blocks) == []


def test_text_and_frames_give_the_same():
    frames = log()
    text = b"".join(format_frame(f) + b"\n" for f in frames)
    from gateway.config import parse

    config = parse({})
    said = []
    replay(
        Reader(io.BytesIO(text)).blocks(),
        lambda start: Gateway(config, CODEC, start),
        10 * MS,
        lambda now, out, _view: said.append((now, out)),
    )
    assert said == run(frames, 10_000)[1]
