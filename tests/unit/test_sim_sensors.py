import numpy as np
import pytest

from sim.physics.sensors import BEYOND, CurrentSensors, Hold, TemperatureSensors


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
