"""Replay: ticks, dropped and skipped time, whatever the size of the blocks."""

import numpy as np
import pytest

from dbc.candump.grammar import format_frame
from dbc.frame import MS, SECOND, Frame
from dbc.frames import in_blocks
from gateway.core.gateway import Gateway
from gateway.io.log_file import BadLogError, OneChannel, open_log
from gateway.io.replay import replay
from tests.sender import SteadyDrive, codec_for

CODEC = codec_for()
START = 1_700_000_000 * SECOND


def log(cycles=40, channel="can0"):
    motors = [SteadyDrive(CODEC, n, 80.0 * n, 15.0, theta=n) for n in (1, 2, 3)]
    sent = [f for k in range(cycles) for motor in motors for f in motor.frames(k)]
    return [f._replace(t_ns=f.t_ns + START, channel=channel) for f in sent]


def run(frames, size, wanted=None):
    from gateway.settings.config import parse

    config = parse({})
    said = []
    done = replay(
        OneChannel(in_blocks(frames, size), wanted),
        lambda start: Gateway(config, CODEC, start),
        10 * MS,
        lambda now, out, _view: said.append((now, out)),
    )
    return done, said


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
    with pytest.raises(BadLogError, match=r"plain\.log: no frame in the log"):
        list(open_log(path, strict=False).blocks)


def healthy(seconds=8.0, skip=()):
    """Frames of three drives from a scenario, as a list."""
    from sim.scenario import parse
    from sim.simulation import Simulation

    scenario = parse({"title": "t", "seed": 4, "duration_s": seconds, "drives": 3}, "t")
    simulation = Simulation(scenario, CODEC)
    frames = [f for k in range(round(100 * seconds)) for f in simulation.step((), k * 10 * MS)]
    return [f._replace(t_ns=f.t_ns + START, channel="can0") for f in frames]


@pytest.fixture(scope="module")
def drives():
    return healthy(3.0)


@pytest.fixture(scope="module")
def plain(drives):
    """The drives' replay as they are."""
    return run(drives, 10_000)


def in_turn(sizes, values):
    """Each size with every other value for a change, all of them before a release."""
    return [
        pytest.param(size, value, marks=[pytest.mark.thorough] * ((k + j) % 2))
        for k, size in enumerate(sizes)
        for j, value in enumerate(values)
    ]


def moved(frames, by_ns):
    return [f._replace(t_ns=f.t_ns + by_ns) for f in frames]


def flags_of(said):
    """(stamp, Adhesion1..3) of every flag frame that went out, in its order."""
    spec = next(m for m in CODEC.messages if m.name == "Gateway_Adhesion")
    rows = []
    for _, out in said:
        for frame in out:
            if frame.can_id == spec.can_id:
                values = CODEC.decode(spec, frame.data)
                rows.append((frame.t_ns, [values[f"Adhesion{n}"].raw for n in (1, 2, 3)]))
    return rows


def counts_of(done):
    return done.gateway.inbox.counts


@pytest.mark.parametrize(("size", "ahead_ns"), in_turn(
    (1, 64, 10_000), (200 * MS, 6 * SECOND, 3600 * SECOND, 80 * 365 * 86400 * SECOND)
))  # fmt: skip
def test_one_frame_from_the_future_costs_one_frame(drives, plain, ahead_ns, size):
    as_it_was, wanted = plain
    frames = list(drives)
    frames.insert(5000, frames[5000]._replace(t_ns=frames[5000].t_ns + ahead_ns, can_id=0x7F0))
    done, said = run(frames, size)
    assert counts_of(done)["time_back"] == done.dropped == 1
    assert counts_of(done)["decoded"] == counts_of(as_it_was)["decoded"]
    assert done.last_ns == as_it_was.last_ns
    assert [row[1] for row in flags_of(said)] == [row[1] for row in flags_of(wanted)]


@pytest.mark.parametrize(
    ("size", "by_ns"),
    in_turn((1, 97, 10_000), (-3600 * SECOND, -SECOND, 3600 * SECOND, 5 * SECOND)),
)
def test_a_clock_that_is_set_costs_no_frame_and_no_flag_is_good_across_it(drives, by_ns, size):
    half = len(drives) // 2
    frames = drives[:half] + moved(drives[half:], by_ns)
    done, said = run(frames, size)
    assert counts_of(done)["time_back"] == 0
    assert counts_of(done)["received"] == len(frames)
    flags = flags_of(said)
    at, after = drives[half].t_ns, drives[half].t_ns + by_ns
    step = next(k for k, (t_ns, _) in enumerate(flags) if k > 150 and abs(t_ns - after) <= 10 * MS)
    assert flags[100][1] == [1, 1, 1]
    # Unknown is what was said last on the old time, and what is said first on the new one.
    assert abs(flags[step - 1][0] - at) < max(abs(by_ns), SECOND)
    assert flags[step - 1][1] == flags[step][1] == [0, 0, 0]
    assert flags[-1][1] == [1, 1, 1]
    assert abs(flags[-1][0] - frames[-1].t_ns) <= 10 * MS, "on the log's own time"
    assert all((t_ns - frames[0].t_ns) % (10 * MS) == 0 for t_ns, _ in flags)
    nows = [now for now, _ in said]
    assert nows == sorted(nows)
    assert len(said) < 1000
    assert (done.clock.steps, len(done.clock.backs)) == ((1, 1) if by_ns < 0 else (0, 0))


@pytest.mark.parametrize("count", [1, 4])
def test_a_few_frames_on_another_time_are_dropped(drives, plain, count):
    stray = moved(drives[:count], -86400 * SECOND)
    done, said = run(drives[:4000] + stray + drives[4000:], 100)
    assert counts_of(done)["time_back"] == count
    assert flags_of(said) == flags_of(plain[1])


def test_stamps_that_agree_on_nothing_are_dropped_and_time_stands_still(drives):
    rng = np.random.default_rng(3)
    noise = [f._replace(t_ns=int(t)) for f, t in zip(
        drives[3000:], rng.integers(0, START - SECOND, len(drives)), strict=False)]  # fmt: skip
    done, said = run(drives[:3000] + noise, 512)
    assert counts_of(done)["time_back"] > 0.95 * len(noise)
    assert counts_of(done)["received"] == len(drives)
    assert len(said) < 2000


@pytest.mark.parametrize("period_s", [0.15, 1.0, 60.0])
def test_a_slow_log_is_no_clock_that_is_set(period_s):
    frames = [f._replace(t_ns=START + round(k * period_s * SECOND)) for k, f in enumerate(log(40))]
    done, _ = run(frames, 7)
    assert counts_of(done)["time_back"] == 0
    assert done.last_ns == frames[-1].t_ns


def wild(seed, count=600):
    """A log whose clock is set, runs ahead, stands still and has odd stamps."""
    rng = np.random.default_rng(seed)
    frames, shift = [], 0
    for f in log(count // 6):
        if rng.random() < 0.01:
            shift += int(rng.choice([-3600, -20, -2, -0.05, 0.05, 2, 20, 3600]) * SECOND)
        odd = int(rng.normal(0, 30) * SECOND) if rng.random() < 0.02 else 0
        frames.append(f._replace(t_ns=max(0, f.t_ns + shift + odd)))
    return frames


@pytest.mark.parametrize("seed", range(6))
def test_a_wild_clock_gives_the_same_however_the_log_is_cut_and_ticked(seed, tmp_path):
    """Blocks of any size, text, gzip, and many ticks at once: the same bytes, the same counts."""
    from dbc.candump.writer import Writer
    from dbc.frames import block_of
    from gateway.io.replay import Briefly
    from gateway.settings.config import parse

    frames = wild(seed)
    whole, said = run(frames, 10_000)
    wanted = [format_frame(f, "can0") for _, out in said for f in out]
    counts = counts_of(whole)
    assert counts["received"] == len(frames)
    for size in (1, 2, 13, 100):
        done, again = run(frames, size)
        assert again == said
        assert counts_of(done) == counts
    for name in ("a.log", "a.log.gz"):
        with Writer(tmp_path / name) as writer:
            writer.write_block(block_of(frames))
        given = []
        done = replay(
            OneChannel(open_log(tmp_path / name, strict=True).blocks, None),
            lambda start: Gateway(parse({}), CODEC, start),
            10 * MS,
            Briefly(lambda out, kept=given: kept.extend(out.frames()), lambda _gateway: None),
        )
        assert [format_frame(f, "can0") for f in given] == wanted
        assert counts_of(done) == counts
        assert done.clock.backs == whole.clock.backs


def test_a_clock_that_goes_to_the_end_of_time_and_back_is_no_overflow():
    end, frames = (1 << 62) - SECOND, log(30)
    for k in range(6):
        frames += moved(log(3), end - START if k % 2 else 0)
    done, said = run(frames, 50)
    assert counts_of(done)["received"] == len(frames)
    assert all(now < 1 << 62 for now, _ in said)
