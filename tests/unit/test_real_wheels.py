"""Recordings of a robot's wheels: what docs/real_wheels.md says of them."""

from pathlib import Path

import numpy as np
import pytest

from bench.real_wheels import (
    SKIP_S,
    drives_straight,
    groups,
    judge,
    on_drag,
    runs,
    terrain,
    terrain_line,
)
from gateway.core.codes import Flag

UNLIKE = ("table_exp28", "table_exp40")
"""One wheel of the first was lost for good, against a demand that none carried."""


def share(flags, flag):
    return float(np.mean(flags[round(100 * SKIP_S) :] == flag))


@pytest.mark.parametrize("name", UNLIKE)
def test_wheels_that_never_turn_alike_are_compared_with_nobody(name):
    assert not runs()[name].straight
    flags = judge(runs()[name])
    assert not np.isin(flags, (Flag.BAD, Flag.GOOD)).any()


@pytest.mark.parametrize("name", groups()["table, straight"])
def test_no_wheel_that_grips_is_called_lost(name):
    flags = judge(runs()[name])
    assert share(flags, Flag.BAD) == 0.0
    assert share(flags, Flag.GOOD) > 0.8


@pytest.mark.parametrize("name", groups()["onto another floor"])
def test_no_wheel_is_called_lost_before_the_floor_changes(name):
    flags, drag = judge(runs()[name]), on_drag(runs()[name])
    assert not (
        flags[round(100 * SKIP_S) :][~drag[round(100 * SKIP_S) :].any(axis=1)] == Flag.BAD
    ).any()


def test_what_is_in_the_recordings():
    """Wheels drag only where they come to the other floor, and then one before the other."""
    kinds = groups()
    assert [len(names) for names in kinds.values()] == [12, 6, 6]
    for names in list(kinds.values())[:2]:
        assert not any(on_drag(runs()[name])[150:].any() for name in names)
    crossing = [on_drag(runs()[name]) for name in kinds["onto another floor"]]
    assert all(drag.all(axis=1).any() for drag in crossing)
    assert any((drag.any(axis=1) & ~drag.all(axis=1)).any() for drag in crossing)


def test_what_is_in_the_recordings_of_the_vehicle():
    """Both sides turn alike on asphalt for minutes, and never carry alike: nothing slips there."""
    found = terrain()
    assert sorted(found) == ["ASPHALT_pro_00", "ASPHALT_pro_01", "ICE_pro_00", "ICE_pro_01"]
    run = found["ASPHALT_pro_01"]
    straight = drives_straight(run)
    assert 120.0 < straight.sum() / 100.0 < 180.0
    at = np.searchsorted(run.t_s, 0.01 * np.flatnonzero(straight)) - 1
    left, right = run.current[at].T
    assert 0.5 < np.median(left) / np.median(right) < 0.7


def test_the_documented_flags_of_the_vehicle():
    page = (Path(__file__).parents[2] / "docs" / "real_wheels.md").read_text().splitlines()
    assert terrain_line("ASPHALT_pro_00") in page
