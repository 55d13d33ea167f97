"""What `calibrate` says of its own models: how far off they are, and where they do not hold."""

import numpy as np
import pytest

from estimators.thermal.model import TYPICAL, Inputs, predict
from estimators.thermal.monitor import Known
from estimators.thermal.record import Record
from gateway.study.calibration_fit import draw, fits, lines

N, NODES, NOISE_K = 1200, (4, 7), 0.05
PARAMETERS = np.tile(TYPICAL, (2, 1))
KNOWN = Known(PARAMETERS, np.zeros((2, 3)), np.ones((2, 3)), 1.0, np.ones(4))


@pytest.fixture(scope="module")
def record():
    """As the model has it, with noise."""
    rng = np.random.default_rng(3)
    square = np.repeat(rng.uniform(0.0, 250.0, (N // 60, 1)), 60, axis=0) * np.ones(2)
    speed, ambient, at = np.full(N, 150.0), np.full(N, 15.0), np.arange(N)
    start = np.tile([30.0, 25.0, 25.0], (2, 1))
    truth = predict(PARAMETERS, Inputs(square, speed, ambient, at, 1.0), start)
    readings = truth + rng.normal(0.0, NOISE_K, truth.shape)
    readings[0] = start
    return Record(readings, at, square, speed, ambient, 1.0)


def test_a_model_that_holds_is_off_by_the_noise_of_the_sensors(record):
    found = fits(KNOWN, record, NODES)
    assert [fit.node for fit in found] == [4, 7]
    for fit in found:
        np.testing.assert_allclose(fit.error_k, NOISE_K, rtol=0.2)
        assert (np.abs(fit.inside - 0.95) < 0.03).all()
        assert fit.explained
    text = lines(found)
    assert text[0].startswith("On 0.33 h")
    assert text[1].startswith("drive 4: stator 0.05 K, 9")
    assert len(text) == 3


def test_a_motor_that_drifts_away_later_is_named(record):
    temperature = record.temperature.copy()
    temperature[:, 1, 0] += np.linspace(0.0, 3.0, N)
    found = fits(KNOWN, record._replace(temperature=temperature), NODES)
    assert found[0].explained
    assert not found[1].explained
    assert "does not explain drive 7" in lines(found)[-1]


def test_a_sensor_that_is_not_there_is_not_judged(record, tmp_path):
    temperature = record.temperature.copy()
    temperature[:, 0, 2] = np.nan
    found = fits(KNOWN, record._replace(temperature=temperature), NODES)
    assert np.isnan(found[0].error_k[2])
    assert found[0].explained
    assert "non-drive end" not in lines(found)[1]
    paths = draw(tmp_path / "pictures", found)
    assert [path.name for path in paths] == ["drive4.svg", "drive7.svg"]
    text = paths[0].read_text(encoding="utf-8")
    assert "drive end" in text
    assert "non-drive end" not in text
