"""What `calibrate` says of logs and its models: what lacks, how far off they are, who echoes."""

import numpy as np
import pytest

from estimators.thermal.model import TYPICAL, Inputs, predict
from estimators.thermal.monitor import MOST_FALSE, Coverage, Known
from estimators.thermal.record import Record
from gateway.mapping.command_fit import Commanded, crossed, fell_alone, repeats_torque
from gateway.study.calibrating import Learner, Sample
from gateway.study.calibration_fit import draw, filter_lines, fits, lines

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


def test_how_far_the_filters_hold_is_printed_and_who_will_be_unknown():
    covered = np.array([(0.951, 0.9), (0.97, 0.5)])
    text = filter_lines(Coverage(np.array([1.0, 1.5]), covered, np.zeros(2), np.zeros(2)), NODES)
    assert "drive 4: filters widened 1.00 times" in text[0]
    assert "95 % of the blocks with low and 90 %" in text[0]
    assert "drive 7 will be Unknown with reason Config: the filters do not fit it" in text[-1]
    false = filter_lines(
        Coverage(np.ones(2), np.full((2, 2), 0.95), np.zeros(2), np.array([0.25, MOST_FALSE])),
        NODES,
    )
    assert "drive 4 will be Unknown with reason Config: it seems faulty for 25 %" in false[-1]
    assert "drive 7 will be" not in "".join(false)


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


def learner(seconds, **changes):
    """After one log of so many seconds; changes: of each second, whole columns."""
    made = Learner((4, 7), 3.0)
    made.begin()
    rng = np.random.default_rng(1)
    for _ in range(seconds):
        known = {
            "temperature": rng.normal(60.0, 1.0, (2, 3)), "square": rng.uniform(1.0, 9.0, 2),
            "speed": np.full(2, 20.0), "ambient": np.full(2, 25.0),
        }  # fmt: skip
        made.seconds[-1].append(Sample(**{**known, **changes}))
    return made


@pytest.mark.parametrize(
    ("name", "what"), [("square", "Irms"), ("speed", "Motion"), ("ambient", "Temperatures")]
)
def test_a_signal_that_never_came_is_named_with_its_drive(name, what):
    (line,) = learner(600, **{name: np.array([5.0, np.nan])}).lacks()
    assert line.startswith("drive 7: ")
    assert what in line


def test_each_drive_and_signal_has_its_line():
    nothing = np.full(2, np.nan)
    assert len(learner(600, square=nothing, speed=nothing).lacks()) == 4


def test_too_short_a_log_and_a_duty_that_never_changes():
    assert learner(0).lacks() == ["no second with temperatures"]
    (line,) = learner(700).lacks()
    assert "for 210 s of the shortest run, at least 300 s are needed" in line, (
        "the rest of it is to fit"
    )
    (line,) = learner(1200, square=np.full(2, 4.0)).lacks()
    assert "record a changing duty" in line


def test_a_motor_of_one_duty_is_named_and_nothing_is_learnt():
    """The others' duty, and the noise of its own current, show nothing of its time constants."""
    made, rng = learner(1200), np.random.default_rng(2)
    steady = rng.normal(9.0, 0.5, len(made.seconds[0]))
    for second, square in zip(made.seconds[0], steady.tolist(), strict=True):
        second.square[1] = square
    (line,) = made.lacks()
    assert line.startswith("drive 7: the current never varied")
    made.means[0], made.samples = [np.array([s.temperature for s in made.seconds[0]])], 1200
    assert made.finish(1.0).heat is None


T = np.arange(100) * 0.1
RATED_NM = 30.0


def demand(t=T):
    """Up, steady, down, in steps of 0.1 Nm."""
    return np.round(np.interp(t, [0.0, 2.0, 7.0, 9.0], [0.0, 20.0, 20.0, 5.0]), 1)


def noisy(course, seed=1):
    return np.round(course + np.random.default_rng(seed).normal(0.0, 0.8, len(course)), 1)


def drive(command, torque, node=1):
    return Commanded(node, T, command, torque, RATED_NM)


def test_a_command_with_the_noise_of_the_torque_is_found():
    torque = noisy(demand())
    (found,) = repeats_torque(drive(torque, torque))
    assert found.fits is False
    assert "repeats Torque" in found.text


@pytest.mark.parametrize("torque", [noisy(demand()), demand(), np.full(100, np.nan)],
                         ids=["noise", "none", "unknown"])  # fmt: skip
def test_a_command_that_is_asked_for_is_not(torque):
    assert not list(repeats_torque(drive(demand(), torque)))


def test_too_few_commands_say_nothing():
    torque = noisy(demand())[:20]
    assert not list(repeats_torque(Commanded(1, T[:20], torque, torque, RATED_NM)))


def test_a_command_that_falls_alone_with_its_torque_is_named():
    fallen = demand() - 15.0 * ((T > 4.0) & (T < 5.0))
    drives = [drive(demand(), noisy(demand()), 1), drive(fallen, noisy(fallen), 2),
              drive(demand(), noisy(demand(), 3), 3)]  # fmt: skip
    found = fell_alone(drives)
    assert list(found) == [2]
    assert found[2].fits is None
    assert "TorqueCommand fell, 3." in found[2].text
    assert "from 20 to 5 Nm" in found[2].text
    backwards = [one._replace(command=-one.command, torque=-one.torque) for one in drives]
    assert list(fell_alone(backwards)) == [2]
    assert fell_alone(drives[1:]) == {}


def test_commands_that_fall_together_and_a_torque_that_falls_alone_are_fine():
    fallen = demand() - 15.0 * ((T > 4.0) & (T < 5.0))
    assert fell_alone([drive(fallen, noisy(fallen), n) for n in (1, 2, 3)]) == {}
    drives = [drive(demand(), noisy(fallen if n == 2 else demand()), n) for n in (1, 2, 3)]
    assert fell_alone(drives) == {}
    silent = [one._replace(t=T[:0], command=T[:0], torque=T[:0]) for one in drives]
    assert fell_alone(silent) == {}


def test_commands_of_two_drives_that_are_crossed_are_named():
    fallen = demand() - 15.0 * ((T > 4.0) & (T < 5.0))
    right = [drive(demand(), noisy(demand()), 1), drive(fallen, noisy(fallen), 2),
             drive(demand(), noisy(demand(), 3), 3)]  # fmt: skip
    assert crossed(right) == {}
    wrong = [drive(fallen, noisy(demand()), 1), drive(demand(), noisy(fallen), 2), right[2]]
    found = crossed(wrong)
    assert set(found) == {1, 2}
    assert found[1].fits is False
    assert "the TorqueCommand of drive 2" in found[1].text
    backwards = [one._replace(command=-one.command, torque=-one.torque) for one in wrong]
    assert set(crossed(backwards)) == {1, 2}


def test_where_commands_do_not_differ_for_long_nothing_shows_that_they_are_crossed():
    fallen = demand() - 15.0 * ((T > 4.0) & (T < 4.3))
    assert crossed([drive(fallen, noisy(demand()), 1), drive(demand(), noisy(fallen), 2)]) == {}
    slips = [drive(demand(), noisy(fallen), 1), drive(demand(), noisy(demand()), 2)]
    assert crossed(slips) == {}
    silent = [one._replace(t=T[:0], command=T[:0], torque=T[:0]) for one in slips]
    assert crossed(silent) == {}
