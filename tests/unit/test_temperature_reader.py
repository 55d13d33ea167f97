"""`calibrate` reads temperatures alone: the same as the whole gateway, for what the frames cost."""

import numpy as np
import pytest
from _traction_core import lib

from dbc.candump.reader import Reader
from dbc.e2e import protect
from dbc.frames import Block
from dbc.records import pointer
from gateway.cli import main
from gateway.core.gateway import Gateway
from gateway.io.log_file import OneChannel, open_log
from gateway.io.prepare import prepare
from gateway.io.replay import Briefly, replay
from gateway.study.temperature_reader import CycleLog, TemperatureReader
from tests import slow_record
from tests.simrun import log_of


def whole(log, config, codec):
    """Cycles as the monitor of the whole gateway has them, tick by tick."""
    rows, seen = [], [0]

    def note(now, _, gateway):
        side = gateway.thermal
        if side.record["cycles"].item() == seen[0]:
            return
        seen[0], sensor = side.record["cycles"].item(), side.sensors.drives["sensor"]
        columns = (
            side.record["second_complete"][0], sensor["value_c"], side.window.mean,
            side.window.known, now - sensor["changed_ns"], side.motors["mean"],
        )  # fmt: skip
        rows.append([np.array(column) for column in columns])

    def make(start):
        return Gateway(config, codec, start)

    blocks = OneChannel(open_log(log, strict=False).blocks, None)
    replay(blocks, make, config.loop.period_ns, note)
    return [np.array(column) for column in zip(*rows, strict=True)]


def alone(log, config, codec):
    """Cycles as `calibrate` reads them."""
    parts = []
    blocks = OneChannel(open_log(log, strict=False).blocks, None)
    done = replay(
        blocks, lambda start: TemperatureReader(config, codec, start), config.loop.period_ns,
        Briefly(lambda _: None, lambda gateway: parts.append(gateway.log.drain())),
    )  # fmt: skip
    parts.append(done.gateway.log.drain())
    return [np.concatenate(column) for column in zip(*parts, strict=True)]


def assert_same(log, config_path):
    config, codec = prepare(config_path)
    for one, other in zip(whole(log, config, codec), alone(log, config, codec), strict=True):
        assert len(one) > 0
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("cycle_ms", [100, 1000])
def test_a_slow_record_reads_as_the_whole_gateway_reads_it(tmp_path, cycle_ms):
    config = slow_record.config(tmp_path, 3, cycle_ms)
    log = tmp_path / "slow.log"
    slow_record.write(log, config, 300, cycle_ms=cycle_ms, without=[(2, "ElectricalAngle")])
    assert_same(log, config)


@pytest.mark.parametrize("signal", ["TorqueCommand", "State", "FaultCode"])
def test_the_current_is_known_without_another_signal(tmp_path, signal):
    config, log = slow_record.config(tmp_path, 2), tmp_path / "slow.log"
    slow_record.write(log, config, 60, without=[(1, signal), (2, signal)])
    second = alone(log, *prepare(config))[-1]
    assert np.isfinite(second[3:, :, lib.THERMAL_CURRENT_SQUARE]).all()


NO_COMMAND = {4: 0x01, 5: 0x80}
"""Bytes of `Status` with a torque command out of its range."""
NOTHING = {2: 0xFF, 3: 0xFF, 4: 0xFF, 5: 0x7F}
"""Neither the current nor the command is available."""


@pytest.mark.parametrize(
    ("changed", "protected", "known"),
    [(NO_COMMAND, True, True), (NOTHING, True, False), (NO_COMMAND, False, False)],
    ids=["command out of range", "nothing available", "wrong checksum"],
)
def test_a_current_is_known_as_long_as_its_own_frames_are_good(tmp_path, changed, protected, known):
    config, log = slow_record.config(tmp_path, 2), tmp_path / "slow.log"
    slow_record.write(log, config, 60)
    codec = prepare(config)[1]
    frames, spec = list(Reader(log)), codec.by_name["Drive1_Status"]
    for k in [k for k, frame in enumerate(frames) if frame.can_id == spec.can_id][30:]:
        data = bytearray(frames[k].data)
        for at, byte in changed.items():
            data[at] = byte
        if protected:
            protect(spec, data, data[1] & 15)
        frames[k] = frames[k]._replace(data=bytes(data))
    log_of(log, frames)
    current = alone(log, *prepare(config))[-1][3:, :, lib.THERMAL_CURRENT_SQUARE]
    assert np.isfinite(current[:, 1]).all()
    assert np.isfinite(current[:25, 0]).all()
    assert (np.isfinite(current[29:, 0]) == known).all()


def test_slower_than_the_dbc_says_and_with_holes(tmp_path):
    """1 Hz with a DBC of 10 and 100 ms: most of the time each message is stale."""
    config = slow_record.config(tmp_path, 2)
    log = tmp_path / "slow.log"
    slow_record.write(log, config, 200)
    lines = log.read_text().splitlines(keepends=True)
    log.write_text("".join(lines[k] for k in range(len(lines)) if k % 97 or k < 30))
    assert_same(log, slow_record.config(tmp_path, 2, 100))


def test_samples_beside_the_slow_messages_change_nothing(tmp_path):
    log = tmp_path / "full.log"
    scenario = tmp_path / "s.toml"
    scenario.write_text('title = "t"\nseed = 1\nduration_s = 4\ndrives = 3\n')
    assert main(["sim", str(scenario), "-o", str(log)]) == 0
    assert_same(log, None)


def test_after_a_hole_the_log_goes_on(tmp_path):
    config_path = slow_record.config(tmp_path, 2)
    config, codec = prepare(config_path)
    log = tmp_path / "slow.log"
    slow_record.write(log, config_path, 120)
    lines = log.read_text().splitlines(keepends=True)
    log.write_text("".join([*lines[:240], *lines[480:]]))
    known = alone(log, config, codec)[3]
    assert 80 <= known.all(axis=(1, 2)).sum() <= 90, "40 s of the 120 s are missing"


def test_a_log_that_is_full_ends_a_call(tmp_path):
    config_path = slow_record.config(tmp_path, 2, 100)
    config, codec = prepare(config_path)
    log = tmp_path / "slow.log"
    slow_record.write(log, config_path, 30, cycle_ms=100)
    (block,) = open_log(log, strict=False).blocks
    assert isinstance(block, Block)
    reader = TemperatureReader(config, codec, int(block.t_ns[0]))
    reader.log = CycleLog(2, 5)
    ends = np.arange(len(block.t_ns) // 10)
    done, _ = reader.run(block, np.minimum(ends, block.size), int(block.t_ns[0]))
    assert reader.changed
    assert done < len(ends)
    now = block.t_ns[0] + (done - 1) * config.loop.period_ns
    assert reader.inbox.counts["received"] == np.count_nonzero(block.t_ns <= now), "each once"
    assert len(reader.log.drain().second) == 5


def test_frames_that_are_not_in_order_end_a_call(tmp_path):
    """`TemperatureReader` sorts them first."""
    config_path = slow_record.config(tmp_path, 2)
    config, codec = prepare(config_path)
    log = tmp_path / "slow.log"
    slow_record.write(log, config_path, 2)
    (block,) = open_log(log, strict=False).blocks
    assert isinstance(block, Block)
    block.t_ns[:] = block.t_ns[::-1].copy()
    now = int(block.t_ns.max())
    reader = TemperatureReader(config, codec, now)
    ends = pointer("int64_t", np.array([block.size]))
    assert lib.run_temperatures(
        reader.pointer, reader.log.pointer, block.columns(), ends, 1, now
    ) == 0  # fmt: skip
