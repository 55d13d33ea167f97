"""Offsets and unlike gains of current sensors: found from whole revolutions, nothing else is."""

import numpy as np
import pytest

from dbc.records import FILTER_SAMPLE, zeros
from tests.core_calls import acquisition, current_calibration
from tests.core_calls.current_calibration import restart, start
from tests.reference.current_calibration import IMAGE_MAX, OFFSET_MAX, Sensors

RATED = np.array([25.0])
STEP_S = 2e-3
SUB_S = 125e-6


def currents(seconds, w, amps, *, offset=0j, image=0j, noise=0.0, seed=1):
    """(M,) z = i + n conj(i) + o of one drive; `w` and `amps` numbers or (M,)."""
    m = round(seconds / STEP_S)
    angle = 0.3 + np.cumsum(np.broadcast_to(w, m)) * STEP_S
    i = np.broadcast_to(amps, m) * np.exp(1j * angle)
    rng = np.random.default_rng(seed)
    white = rng.normal(size=(m, 2)) @ np.array([1.0, 1j])
    return i, i + image * i.conj() + offset + np.sqrt(noise) * white


def feed(state, z, w, *, gap=None, rated=RATED, drive=None, ready=True):
    """What comes out, (M,) complex, of one sample after the other."""
    m = len(z)
    made = zeros(m, FILTER_SAMPLE)
    made.drive = 0 if drive is None else drive
    made.steps, made.gap, made.i = 16, 0 if gap is None else gap, z
    chords = acquisition.start(len(rated))
    chords.ready = ready
    for k, speed in enumerate(np.broadcast_to(w, m).tolist()):
        chords.w = speed
        current_calibration.calibrate(made[k : k + 1], state, chords, rated, SUB_S)
    return made.i.copy()


def finite(state):
    """All numbers of all records."""
    return all(np.isfinite(np.array(state[name].tolist(), dtype=complex)).all()
               for name in state.dtype.names)  # fmt: skip


@pytest.mark.parametrize("w", [30.0, -95.0, 250.0, 310.0])
@pytest.mark.parametrize(("offset", "image"), [(0.5 - 0.3j, 0j), (0j, 0.05 * np.exp(0.5j)),
                                               (0.4 + 0.4j, -0.03 + 0.04j)])  # fmt: skip
def test_offset_and_image_are_found_and_taken_off(w, offset, image):
    seconds = 25 * 2.0 * np.pi / abs(w)
    i, z = currents(seconds, w, 12.0, offset=offset, image=image, noise=2e-4)
    state = start(1)
    out = feed(state, z, w)
    assert state.turns[0] == 16
    assert state.offset[0] == pytest.approx(offset, abs=0.03)
    assert state.image[0] == pytest.approx(image, abs=0.003)
    left = np.abs(out - i)[-100:]
    assert left.max() < 0.12, "3 sigma of the noise, and what is left"
    assert np.abs(z - i)[-100:].max() > 0.4


def test_good_sensors_stay_what_they_are():
    _, z = currents(5.0, 120.0, 12.0, noise=1e-2)
    state = start(1)
    feed(state, z, 120.0)
    assert abs(state.offset[0]) < 0.03
    assert abs(state.image[0]) < 0.003


def test_two_sensors_with_unlike_gains_make_the_image_of_the_docstring():
    """CAN FD: beta is made of Ia and Ib."""
    i, _ = currents(3.0, 100.0, 15.0)
    a, b = i.real, 0.5 * (np.sqrt(3.0) * i.imag - i.real)
    d = 0.1
    a, b = a * (1.0 + d / 2), b * (1.0 - d / 2)
    state = start(1)
    feed(state, a + 1j * (a + 2.0 * b) / np.sqrt(3.0), 100.0)
    assert abs(state.image[0]) == pytest.approx(d / np.sqrt(3.0), rel=0.05)
    assert np.angle(state.image[0]) == pytest.approx(np.pi / 6.0, abs=0.05)


@pytest.mark.parametrize(("offset", "image"), [(2.0 * OFFSET_MAX * 25.0, 0.0),
                                               (0.0, 2.0 * IMAGE_MAX)])  # fmt: skip
def test_what_is_larger_is_a_fault_and_is_not_learnt(offset, image):
    _, z = currents(3.0, 100.0, 15.0, offset=offset, image=image)
    state = start(1)
    out = feed(state, z, 100.0)
    assert state.turns[0] == 0
    np.testing.assert_allclose(out, z)


def test_an_open_phase_is_not_learnt():
    i, _ = currents(3.0, 100.0, 15.0)
    state = start(1)
    feed(state, 1j * i.imag, 100.0)
    assert state.turns[0] == 0


@pytest.mark.parametrize("w", [250.0, -320.0, 560.0, 880.0, -1250.0])
def test_a_current_on_one_line_is_told_from_one_that_turns_within_two_ticks(w):
    i, _ = currents(1.0, w, 15.0, noise=1e-2)
    state = start(1)
    feed(state, i, w)
    assert not current_calibration.is_single_axis(state, 0, w)
    opened = np.exp(0.7j) * (np.exp(-0.7j) * i).real
    feed(state, opened[:10], w)
    assert current_calibration.is_single_axis(state, 0, w)
    feed(state, opened, w)
    assert current_calibration.is_single_axis(state, 0, w)
    assert current_calibration.is_single_axis(state, 0, 50.0), "too slow to tell: as before"
    feed(state, i[:25], w)
    assert not current_calibration.is_single_axis(state, 0, w)


def test_on_its_limits_a_line_is_told_from_a_circle():
    """Three quarters of the samples with a current; half of the length, and 30 % of it."""
    state = start(3)
    state.seen, state.line, state.single_axis = [0.75, 1.0, 1.0], [0.6, 0.5j, -0.3], [0, 0, 1]
    found = [current_calibration.is_single_axis(state, k, 400.0) for k in range(3)]
    assert found == [True, False, False]


def test_steps_and_errors_of_sensors_are_no_line():
    """Neither a current that comes or reverses at once, nor what is learnt as unbalance."""
    for w in (260.0, 400.0, 880.0):
        m = round(1.0 / STEP_S)
        amps = np.array([1.0, 20.0, -20.0, 3.0])[np.arange(m) // 25 % 4]
        image, offset = 0.9 * IMAGE_MAX, 0.4 * OFFSET_MAX * RATED[0]
        _, z = currents(1.0, w, amps, image=image, offset=offset)
        state = start(1)
        for one in z:
            feed(state, np.array([one]), w)
            assert not current_calibration.is_single_axis(state, 0, w), w


def test_too_little_current_and_too_few_samples_are_not_judged():
    for w, amps in ((400.0, 1.0), (1500.0, 15.0), (100.0, 15.0)):
        i, _ = currents(1.0, w, amps)
        state = start(1)
        feed(state, i.real + 0j, w)
        assert not current_calibration.is_single_axis(state, 0, w)


def test_standstill_small_currents_and_too_few_samples_teach_nothing():
    for w, amps in ((0.0, 15.0), (100.0, 2.0), (400.0, 15.0)):
        _, z = currents(3.0, w, amps, offset=0.5)
        state = start(1)
        feed(state, z, w)
        assert state.turns[0] == 0, (w, amps)


def test_a_current_that_does_not_turn_with_its_rotor_is_no_offset():
    """Samples that are held."""
    state = start(1)
    feed(state, np.full(300, 15.0 - 3.0j), 100.0)
    assert state.turns[0] == 0


def test_a_load_that_steps_is_no_offset():
    w = 2.0 * np.pi * 10.0
    m = round(4.0 / STEP_S)
    amps = np.where(np.arange(m) // 135 % 2 == 0, 6.0, 20.0)
    _, z = currents(4.0, w, amps)
    state = start(1)
    feed(state, z, w)
    assert abs(state.offset[0]) < 0.2
    assert abs(state.image[0]) < 0.01


def test_a_current_that_grows_evenly_is_no_offset():
    """A mean over one revolution alone would make 0.25 A of it."""
    _, z = currents(3.0, 60.0, np.linspace(8.0, 20.0, 1500))
    state = start(1)
    feed(state, z, 60.0)
    assert state.turns[0] > 5
    assert abs(state.offset[0]) < 0.03
    assert abs(state.image[0]) < 0.001


def test_what_is_taken_off_follows_smoothly():
    i, z = currents(2.0, 100.0, 15.0, offset=0.5)
    taken = z - feed(start(1), z, 100.0)
    assert taken[-1] == pytest.approx(0.5, abs=0.02)
    assert np.abs(np.diff(taken)).max() < 0.05 * 0.5
    assert abs(i[-1] - (z - taken)[-1]) < 0.02


def test_a_speed_that_is_not_known_teaches_nothing():
    _, z = currents(3.0, 100.0, 15.0, offset=0.5)
    state = start(1)
    out = feed(state, z, 100.0, ready=False)
    assert state.turns[0] == 0
    np.testing.assert_allclose(out, z)


def test_a_hole_or_no_number_begins_the_revolution_anew():
    _, z = currents(3.0, 100.0, 15.0, offset=0.5)
    state = start(1)
    gap = (np.arange(len(z)) % 30 == 0).astype(np.int64)
    feed(state, z, 100.0, gap=gap)
    assert state.turns[0] == 0, "no revolution without a hole"
    z[::30] = complex(np.nan, 1.0)
    out = feed(state, z, 100.0)
    assert state.turns[0] == 0
    assert np.isfinite(out[1:29]).all()
    assert finite(state)


def test_drives_do_not_mix_and_one_can_be_restarted():
    _, first = currents(3.0, 100.0, 15.0, offset=0.5, image=0.03)
    _, second = currents(3.0, 100.0, 8.0, offset=-0.3j)
    both = np.stack([first, second], axis=1).reshape(-1)
    drive = np.tile(np.array([0, 1], dtype=np.int32), len(first))
    state, alone = start(2), start(1)
    feed(state, both, 100.0, rated=np.array([25.0, 25.0]), drive=drive)
    feed(alone, first, 100.0)
    assert state.offset[0] == alone.offset[0]
    assert state.image[0] == alone.image[0]
    assert state.offset[1] == pytest.approx(-0.3j, abs=0.02)
    restart(state, 0)
    assert state[0].tobytes() == start(1)[0].tobytes()
    assert state.turns[1] == 16


@pytest.mark.parametrize("seed", range(4))
def test_it_equals_the_reference(seed):
    """Any speeds, gaps, implausible samples, errors that are learnt and some that are too large."""
    rng = np.random.default_rng(seed)
    seconds = 6.0
    m = round(seconds / STEP_S)
    w = rng.choice([-300.0, -40.0, 60.0, 110.0, 300.0], 20).repeat(m // 20)
    offset, image = 0.7 * (seed + 1) * 0.02j * 25.0, 0.03 * seed + 0.01j
    _, z = currents(seconds, w, 12.0, offset=offset, image=image, noise=1e-2, seed=seed)
    z[m // 2 : m // 2 + 200].imag = 0.0
    z[rng.integers(0, m, 6)] = [np.nan, np.inf, 1e5, -3e5j, 1e300, 0.0]
    gap = rng.choice([0, 32], m, p=[0.999, 0.001])
    state, plain = start(1), Sensors(25.0)
    for k in range(m):
        one = feed(state, z[k : k + 1], w[k], gap=gap[k : k + 1])[0]
        want = plain.add(complex(z[k]), 16 * SUB_S, gap[k] * SUB_S, w[k])
        assert np.isfinite(one) == np.isfinite(want)
        assert not np.isfinite(want) or abs(one - want) <= 1e-9 * (1.0 + abs(want)), k
        is_single_axis = current_calibration.is_single_axis(state, 0, w[k])
        assert is_single_axis == plain.is_single_axis(w[k]), k
    assert state.turns[0] == plain.turns
    assert state.offset[0] == pytest.approx(plain.offset, abs=1e-9)
    assert state.image[0] == pytest.approx(plain.image, abs=1e-9)
    assert state.line[0] == pytest.approx(plain.line, abs=1e-9)
    assert finite(state)
