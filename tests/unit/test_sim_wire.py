"""The simulated bus and its sensors: times on the wire, blocks of frames, noise and faults."""

from itertools import pairwise

import numpy as np
import pytest

from dbc.frame import BRS, FD, Frame
from sim.bus_arbiter import Arbiter, bits, duration_ns
from sim.ecu import FAST
from sim.physics.sensors import BEYOND, CurrentSensors, Hold, TemperatureSensors
from tests.reference import codec as reference
from tests.simrun import FD_FILE, codec

MBIT = (1_000_000, 5_000_000)


def frame(t_ns, can_id, length=8, flags=0):
    return Frame(t_ns, can_id, bytes(length), flags)


def test_frame_times_lie_between_no_stuffing_and_the_worst_case():
    for length in range(9):
        plain = 47 + 8 * length
        assert plain <= bits(length) <= plain + (33 + 8 * length) // 4
    assert duration_ns(8, 0, *MBIT) == bits(8) * 1000
    assert 100_000 < duration_ns(64, FD | BRS, *MBIT) < 220_000


def test_lowest_identifier_first_and_stamps_at_the_end():
    bus = Arbiter(*MBIT)
    bus.offer([frame(0, 0x300), frame(0, 0x100), frame(0, 0x200)])
    out = bus.drain(10_000_000)
    assert [f.can_id for f in out] == [0x100, 0x200, 0x300]
    took = bits(8) * 1000
    assert [f.t_ns for f in out] == [took, 2 * took, 3 * took]


def test_a_frame_on_the_wire_is_not_pre_empted():
    bus = Arbiter(*MBIT)
    bus.offer([frame(0, 0x300), frame(1000, 0x100)])
    assert [f.can_id for f in bus.drain(10_000_000)] == [0x300, 0x100]


def test_an_identifier_has_one_mailbox():
    bus = Arbiter(*MBIT)
    bus.offer([frame(0, 0x001), frame(10, 0x200, 1), frame(20, 0x200, 2)])
    out = bus.drain(10_000_000)
    assert [(f.can_id, len(f.data)) for f in out] == [(0x001, 8), (0x200, 2)]


@pytest.mark.parametrize("step", [7_000, 50_000, 1_000_000, 30_000_000])
def test_how_time_is_cut_changes_nothing(step):
    offers = [
        frame(k * 37_000 % 900_000 + (k // 25) * 1_000_000, 0x100 + k % 13) for k in range(90)
    ]
    whole = Arbiter(*MBIT)
    whole.offer(offers)
    expected = whole.drain(40_000_000)
    cut, out, done = Arbiter(*MBIT), [], 0
    for now in range(step, 40_000_000 + step, step):
        cut.offer([f for f in offers if done < f.t_ns + 1 <= now + 1])
        done = now + 1
        got = cut.drain(now)
        assert all(f.t_ns <= now for f in got)
        out += got
    assert out == expected
    assert all(a.t_ns < b.t_ns for a, b in pairwise(out))


def test_a_bus_without_bit_rate_delivers_at_once():
    bus = Arbiter(0, 1)
    bus.offer([frame(5, 0x300), frame(5, 0x100), frame(9, 0x050)])
    assert [(f.t_ns, f.can_id) for f in bus.drain(8)] == [(5, 0x100), (5, 0x300)]
    assert [f.can_id for f in bus.drain(9)] == [0x050]


@pytest.mark.parametrize("kind", FAST)
def test_blocks_of_fast_messages_equal_the_reference_on_every_byte(kind):
    c = codec(path=FD_FILE) if kind == "Samples" else codec()
    spec, names = c.by_name[f"Drive2_{kind}"], FAST[kind]
    rng = np.random.default_rng(1)
    rows = rng.normal(0.0, 1.0, (400, len(names))) * rng.choice([1, 50, 1e3, 1e5, 1e9], (400, 1))
    rows[rng.random(rows.shape) < 0.05] = np.nan
    rows[rng.random(rows.shape) < 0.02] = np.inf
    # Halfway between two codes, where rounding could differ.
    scale = np.array([spec.signals[spec.column(n)].scale for n in names])
    rows[:50] = (rng.integers(-300, 300, (50, len(names))) + 0.5) * scale
    for row, payload in zip(rows, c.encode_rows(spec, names, rows), strict=True):
        assert payload == reference.encode(spec, dict(zip(names, row.tolist(), strict=True)))


def test_signals_left_out_keep_their_start_value():
    spec = codec().by_name["Drive1_StatorVoltages"]
    payloads = codec().encode_rows(spec, ["Ubeta"], np.array([[12.3]]))
    assert payloads == [codec().encode(spec, {"Ubeta": 12.3})]


def test_phases_are_the_projections_of_the_vector():
    sensors = CurrentSensors(1, 1, 0.0, 0.0, 1.0, 600.0)
    angle = np.linspace(0, 2 * np.pi, 50)
    i_ab = 10 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)[:, None, :]
    phases = sensors.read(i_ab)[:, 0]
    for k in range(3):
        np.testing.assert_allclose(phases[:, k], 10 * np.cos(angle - k * 2 * np.pi / 3), atol=1e-9)


def test_noise_has_the_variance_asked_for_and_is_white():
    noise = CurrentSensors(7, 2, 2e-4, 0.0, 1.0, 600.0).read(np.zeros((20000, 2, 2)))
    assert noise.var() == pytest.approx(2e-4, rel=0.03)
    flat = noise.reshape(20000, 6)
    corr = np.corrcoef(flat.T) - np.eye(6)
    assert np.abs(corr).max() < 0.03
    assert abs(np.corrcoef(flat[1:, 0], flat[:-1, 0])[0, 1]) < 0.03


def test_block_size_does_not_change_the_noise():
    whole = CurrentSensors(7, 2, 2e-4, 0.0, 1.0, 600.0).read(np.zeros((12, 2, 2)))
    piecewise = CurrentSensors(7, 2, 2e-4, 0.0, 1.0, 600.0)
    parts = [piecewise.read(np.zeros((n, 2, 2))) for n in (1, 4, 7)]
    np.testing.assert_array_equal(whole, np.concatenate(parts))


def test_offset_gain_and_range():
    sensors = CurrentSensors(1, 1, 0.0, 0.5, 1.1, 20.0)
    reading = sensors.read(np.array([[[10.0, 0.0]], [[-40.0, 0.0]]]))[:, 0, 0]
    assert reading[0] == pytest.approx(11.5)
    assert reading[1] == -BEYOND


def test_temperature_offsets_belong_to_the_train_noise_to_the_run():
    true = np.full((3, 4), 50.0)
    one, two = (TemperatureSensors(seed, 1, 3, 0.15, 0.3) for seed in (1, 2))
    np.testing.assert_array_equal(one.offset, two.offset)
    assert not np.allclose(one.read(true), two.read(true))
    many = np.stack([one.read(true) for _ in range(2000)])
    np.testing.assert_allclose(many.mean(axis=0), 50.0 + one.offset, atol=0.02)
    assert many.std(axis=0).mean() == pytest.approx(0.15, rel=0.03)
    assert np.abs(one.offset).max() < 0.8


def test_hold_freezes_from_onset_and_lets_go():
    hold = Hold((2,))
    off, on = np.array([False, False]), np.array([True, False])
    assert hold.apply(np.array([1.0, 2.0]), off).tolist() == [1.0, 2.0]
    assert hold.apply(np.array([3.0, 4.0]), on).tolist() == [3.0, 4.0]
    assert hold.apply(np.array([5.0, 6.0]), on).tolist() == [3.0, 6.0]
    assert hold.apply(np.array([7.0, 8.0]), off).tolist() == [7.0, 8.0]
    assert hold.apply(np.array([9.0, 8.0]), on).tolist() == [9.0, 8.0]
