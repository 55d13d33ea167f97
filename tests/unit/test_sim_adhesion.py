import numpy as np
import pytest
from hypothesis import given, settings

from sim.physics.adhesion import (
    RAILS,
    SPEED_FLOOR_M_S,
    available,
    peak_creep,
    rail,
    traction_coefficient,
)
from sim.records import RAIL, ffi, lib
from tests.strategies import contacts

CREEP = np.linspace(0.0, 0.5, 2001)


@pytest.mark.parametrize("name", RAILS)
def test_curve_rises_to_one_peak_and_falls(name):
    ratio = traction_coefficient(RAILS[name], CREEP, 10.0)
    top = int(ratio.argmax())
    assert ratio[0] == 0.0
    assert np.all(np.diff(ratio[: top + 1]) > 0)
    assert np.all(np.diff(ratio[top:]) < 0)
    assert CREEP[top] == pytest.approx(peak_creep(RAILS[name], 10.0), abs=2e-3)


@pytest.mark.parametrize("name", RAILS)
@pytest.mark.parametrize("v", [-8.0, 0.0, 3.0])
def test_curve_is_odd_in_creep(name, v):
    curve = RAILS[name]
    forth = traction_coefficient(curve, CREEP, v)
    back = traction_coefficient(curve, -CREEP, v)
    np.testing.assert_array_equal(forth, -back)


def test_conditions_are_ordered_and_of_known_size():
    peaks = {name: available(curve, 10.0, 0.5) for name, curve in RAILS.items()}
    assert 0.35 < peaks["dry"] < 0.5
    assert 0.15 < peaks["wet"] < 0.3
    assert 0.04 < peaks["leaves"] < 0.08


def test_small_creep_slope_is_linear_theory():
    # F/Q -> (2/pi) (k_A + k_S) k_c s: Kalker's linear range, friction cancels.
    for curve in RAILS.values():
        s = np.array([1e-7])
        slope = traction_coefficient(curve, s, 5.0)[0] / s[0]
        assert slope == pytest.approx(2 / np.pi * (curve.k_A + curve.k_S) * curve.k_c, rel=1e-4)


def test_falls_with_sliding_speed():
    slow = traction_coefficient(RAILS["dry"], np.array([0.2]), 2.0)
    fast = traction_coefficient(RAILS["dry"], np.array([0.2]), 20.0)
    assert fast < slow


@settings(deadline=None)
@given(contacts())
def test_the_torque_is_that_of_the_curve(contact):
    name, v, slide, load_nm = contact
    curve = RAILS[name]
    creep = slide / max(abs(v), SPEED_FLOOR_M_S)
    plain = load_nm * traction_coefficient(curve, np.array([creep]), v)[0]
    contact = ffi.new("struct sim_contact *", {
        "rail": curve, "v_m_s": v, "weight_nm": load_nm, "speed_floor_m_s": SPEED_FLOOR_M_S,
    })  # fmt: skip
    assert lib.sim_creep_torque(contact, slide) == pytest.approx(plain, abs=1e-9)


def test_a_rail_has_the_fields_of_its_record():
    assert RAIL.names == RAILS["dry"]._fields


def test_available_is_bounded_by_the_creep_allowed():
    wet = RAILS["wet"]
    assert available(wet, 5.0, 0.01) < available(wet, 5.0, 0.05) < available(wet, 5.0, 0.5)


def test_condition_by_number_or_name():
    assert rail("wet") is RAILS["wet"]
    assert rail(0.4).mu_0 == 0.4
    assert rail(0.4).k_A == RAILS["dry"].k_A
    assert rail(0.1).k_A == RAILS["wet"].k_A
    with pytest.raises(ValueError, match="unknown rail condition 'ice'"):
        rail("ice")
    with pytest.raises(ValueError, match="outside"):
        rail(1.5)
