"""What `calibrate` says of logs that give no thermal model: what lacks, by drive and signal."""

from __future__ import annotations

import numpy as np
import pytest

from gateway.study.calibrating import Learner, Sample


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
    assert line.startswith("210 s of a run"), "the rest of it is to fit"
    (line,) = learner(1200, square=np.full(2, 4.0)).lacks()
    assert "record a changing duty" in line
