"""Rows of ticks that the core keeps; tables that it writes, with the bytes of Python's numbers."""

from __future__ import annotations

import io
import math
from copy import deepcopy

import numpy as np
import pytest
from _traction_core import ffi, lib

from dbc.records import pointer
from gateway.core.codes import Flag
from gateway.core.gateway import Gateway
from gateway.reports.record import ADHESION, Coded, Table, by_code
from gateway.reports.ticks import TickLog
from tests.stations import temperatures_of
from tests.storm.train import TICK, train
from tests.unit.test_ticks import FIRST, config_of, stormy

NODES = (1, 3)
HEADER = ("t_s", "drive", *(f"c{k}" for k in range(10)))
DECIMALS = (4, 4, 4, 4, 3, 2, 3, 4, 4, 1)
"""Of the numbers of a table, one after the other."""


def written(t_ns, columns, nodes=NODES):
    stream = io.BytesIO()
    Table(stream, HEADER, nodes).write_rows(np.array(t_ns), columns)
    return stream.getvalue().decode().splitlines()[1:]


def expected(t_ns, columns, nodes=NODES):
    lines = []
    for row in range(len(t_ns) * len(nodes)):
        tick, drive = divmod(row, len(nodes))
        seconds, ns = divmod(t_ns[tick], 10**9)
        numbers = (f"{c[row]:.{d}f}" for c, d in zip(columns, DECIMALS, strict=True))
        fields = ("" if text == "nan" else text for text in numbers)
        lines.append(",".join([f"{seconds}.{ns:09d}", str(nodes[drive]), *fields]))
    return lines


HARD = [math.nan, 0.0, -0.0, -1e-9, 0.00005, 0.00015, 0.125, 0.375, 2.5, 0.05, 0.25, 0.45, -0.35,
        0.0625, 1e-300, 5e-324, 0.99995, 9.99995, 999.9995, 1e9 + 0.03125, 123456789.00005, 2.0**37,
        4503599627370.4955, math.inf, -math.inf, 2.0**52, -(2.0**60), 1e300]  # fmt: skip
"""Halves that a double holds exactly and those that it does not, signs, and what is too large."""


def test_numbers_are_written_as_python_writes_them():
    values = np.array([*HARD, *HARD])
    columns = [np.roll(values, k) for k in range(10)]
    t_ns = [k * 10_000_000 + 7 for k in range(len(HARD))]
    assert written(t_ns, columns) == expected(t_ns, columns)


@pytest.mark.parametrize("seed", range(4))
def test_any_numbers_are_written_as_python_writes_them(seed):
    rng = np.random.default_rng(seed)
    rows = 2 * 2000
    columns = [np.round(rng.normal(size=rows) * 10.0 ** rng.integers(-6, 11, rows), 5)
               for _ in range(10)]  # fmt: skip
    columns[3][:] = rng.integers(-(10**6), 10**6, rows) / 2.0**5  # many exact halves
    t_ns = (10**18 + 10_000_000 * np.arange(2000)).tolist()
    assert written(t_ns, columns) == expected(t_ns, columns)


def test_words_stand_for_codes_and_a_time_before_zero_is_written():
    codes = np.array([Flag.GOOD, Flag.BAD, Flag.UNKNOWN, Flag.GOOD], np.uint8)
    lines = written([-1, 2], [Coded(codes, by_code(ADHESION)), np.array([1.0, 2.0, 3.0, 4.0])])
    assert lines == [
        "-1.999999999,1,Adhering,1.0000", "-1.999999999,3,AdhesionLost,2.0000",
        "0.000000002,1,Unknown,3.0000", "0.000000002,3,Adhering,4.0000",
    ]  # fmt: skip


LINE = lib.TABLE_MAX_HEAD + lib.TABLE_MAX_FIELD


@pytest.mark.parametrize(("t_ns", "number", "size", "rows"), [
    (0, 1.0, LINE, 1), (0, 1.0, LINE - 1, 0), (-1, 1.0, LINE, 0), (0, 450359962737049.5, LINE, 1),
    (0, 450359962737049.6, LINE, 0),
])  # fmt: skip
def test_the_core_leaves_only_what_it_cannot_write(t_ns, number, size, rows):
    """A row that does not fit, a time before 0, and 2^52 tenths."""
    times, numbers, nodes = np.array([t_ns]), np.array([number]), np.array([1], np.int32)
    column = ffi.new("struct table_column *", {"value": pointer("double", numbers), "decimals": 1})
    table = ffi.new("struct table *", (
        pointer("int64_t", times), pointer("int32_t", nodes), column, 1, 1,
    ))  # fmt: skip
    text, filled = ffi.new("uint8_t[]", size), ffi.new("int64_t *")
    assert lib.table_write(table, 0, 1, text, size, filled) == rows
    assert (filled[0] > 0) == rows


def noted(gateway, blocks, most):
    """Ticks one by one; and what each left, as objects."""
    found, plain = [], []
    log = TickLog([found.append], most)
    for k, block in enumerate(blocks):
        gateway.step(block, (k + FIRST) * TICK)
        log.append(gateway)
        celsius = np.full((len(gateway.nodes), 4), np.nan)
        for reading in temperatures_of(gateway.inbox):
            celsius[reading.drive] = reading.celsius
        wear = [[math.nan if v is None else v for v in each[:3]] for each in gateway.thermal.wear]
        load = gateway.load.percent(gateway.now_ns)
        plain.append((
            gateway.now_ns, repr(gateway.status.drives.tolist()),
            repr(gateway.status.train[0].item()),
            math.nan if load is None else load, wear, celsius,
        ))  # fmt: skip
    log.flush()
    return found, plain


def rows(found):
    for ticks in found:
        for k in range(len(ticks.t_ns)):
            yield (
                ticks.t_ns.item(k), repr(ticks.drives[k].tolist()), repr(ticks.train[k].item()),
                ticks.bus_load_percent.item(k), ticks.wear[k], ticks.celsius[k],
            )  # fmt: skip


def assert_same(one, other):
    one, other = list(one), list(other)
    assert len(one) == len(other) > 0
    for mine, theirs in zip(one, other, strict=True):
        assert mine[:3] == theirs[:3]
        for a, b in zip(mine[3:], theirs[3:], strict=True):
            np.testing.assert_array_equal(a, b)


def logged(config, blocks, most):
    return noted(Gateway(config, train().codec, 0), blocks, most)


@pytest.mark.parametrize(("method", "ticks"), [("maisd", 400), ("model", 2500)])
def test_a_log_of_ticks_is_what_each_tick_says(method, ticks):
    blocks, _, _ = stormy(train(), 4, ticks, 120.0)
    found, plain = logged(config_of(method=method), blocks, 7)
    assert_same(rows(found), plain)
    assert {len(ticks.t_ns) for ticks in found[:-1]} == {7}
    assert any(np.isfinite(row[5]).any() for row in plain), "no temperature ever came"


def test_many_ticks_in_a_call_leave_the_same_rows_and_none_too_many():
    config, most = config_of(), 64
    blocks, whole, ends = stormy(train(), 4, 600, 120.0)
    wanted, _ = logged(config, blocks, most)
    gateway, found, done, calls = Gateway(config, train().codec, 0), [], 0, []
    log = TickLog([found.append], most)
    while done < len(ends):
        first = int(ends[done - 1]) if done else 0
        last = done + (200 if log.follows else 1)
        part = whole.part(first, int(ends[:last][-1]))
        ticks, _ = gateway.run(part, ends[done:last] - first, (done + FIRST) * TICK)
        log.follow(gateway)
        done += ticks
        calls.append(ticks)
    log.flush()
    assert_same(rows(found), list(rows(wanted)))
    assert 1 < max(calls) <= most


def test_a_full_log_takes_no_tick_and_its_memory_outlives_who_reads_it():
    blocks, _, _ = stormy(train(), 4, 20, 1e9)
    gateway = Gateway(config_of(), train().codec, 0)
    log = TickLog([], 4)
    gateway.step(blocks[0], FIRST * TICK)
    log.follow(gateway)
    held = gateway.pointer.log
    del log
    for k, block in enumerate(blocks[1:], FIRST + 1):
        gateway.step(block, k * TICK)
    assert held.count == held.capacity == 4
    assert [held.ticks[k].t_ns for k in range(4)] == [(FIRST + k) * TICK for k in range(4)]


def test_a_copy_keeps_no_ticks():
    gateway = Gateway(config_of(), train().codec, 0)
    gateway.step([], TICK)
    TickLog([], 4).follow(gateway)
    assert gateway.pointer.log != ffi.NULL
    assert deepcopy(gateway).pointer.log == ffi.NULL


def test_the_degradation_of_a_motor_is_logged_with_its_time_to_the_limit():
    gateway = Gateway(config_of(method="model"), train().codec, 0)
    found = []
    log = TickLog([found.append], 4)
    gateway.step([], TICK)
    motors = gateway.thermal.motors
    motors["fresh"], motors["trend"]["observed_h"] = [1, 1, 0], 2.0
    motors["trend"]["level_k"], motors["trend"]["rate_k_h"] = 4.0, [0.5, -0.5, 0.5]
    motors["trend"]["cov"][:, 1, 1] = 0.01
    log.append(gateway)
    log.flush()
    nan = math.nan
    wanted = [[0.5, 0.1, 12.0], [-0.5, 0.1, nan], [nan, nan, nan]]
    np.testing.assert_allclose(found[0].wear[0], wanted, rtol=1e-12)
