"""The filters equal the reference with any registers, and what they do with bad samples."""

from functools import partial
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from _traction_core import lib

from dbc.records import pointer
from estimators import filters
from estimators.models import pmsm
from estimators.models.pmsm import SUB_STEP_S, Noise, Pmsm
from tests.core_calls import filters as calls
from tests.reference import ekf, ukf
from tests.thorough import some
from tests.unit.test_est_ekf import bench
from tests.unit.test_est_truth import Rows, motor, sampled


class Case(NamedTuple):
    par: Pmsm
    noise: Noise
    rows: Rows
    x: np.ndarray
    P: np.ndarray
    lean: np.ndarray


def case(n=3, seed=1, ticks=1600, fastest=200.0):
    """Turning drives with lost samples; filters start near the truth, each motor different."""
    rng = np.random.default_rng(seed)
    par, noise = bench(n)
    par = par._replace(R_s=par.R_s * rng.uniform(0.9, 1.1, n), B=rng.uniform(0.0, 1e-3, n))
    w = rng.uniform(30.0, fastest, n) * rng.choice([-1.0, 1.0], n)
    theta = rng.uniform(-3.0, 3.0, n)
    truth = motor(w, theta, np.tile(w, (ticks, 1)), np.full((ticks, n), 8.0))
    x = np.stack([np.zeros(n), np.zeros(n), w, theta, np.zeros(n)], axis=1)
    P = np.tile(np.diag([1.0, 1.0, 25.0, 0.04, 400.0]), (n, 1, 1))
    rows = sampled(truth, 16, 2e-4, seed, lost=0.2)
    return Case(par, noise, rows, x, P, rng.uniform(-0.5, 0.5, n))


def sweep(kind, c, rows=None, bits=0):
    """(x, P, nis, ok)."""
    x, P = c.x.copy(), c.P.copy()
    samples = filters.sample_records(*(rows or c.rows)[:5])
    nis, ok = calls.sweep(kind, pmsm.table(c.par), c.noise, x, P, samples, SUB_STEP_S, c.lean, bits)
    return x, P, nis, ok


def twin(kind, c):
    x, P = c.x.copy(), c.P.copy()
    r = c.rows
    samples = (r.drive, r.u, r.y, r.n_sub, r.n_gap, SUB_STEP_S)
    prior = partial(ukf.predict, kappa=filters.KAPPA) if kind == "ukf" else None
    nis, ok = ekf.sweep(c.par, c.noise, x, P, *samples, lean=c.lean, prior=prior)
    return x, P, nis, ok


both = pytest.mark.parametrize("kind", ["ekf", "ukf"])


@both
@pytest.mark.parametrize(("seed", "fastest"), some([(1, 200.0), (3, 2500.0)], [(2, 200.0)]))
def test_it_equals_the_reference(kind, seed, fastest):
    """From 1400 rad/s on the voltage is held again: both do it."""
    c = case(seed=seed, fastest=fastest)
    assert (c.rows.n_gap > 0).any()
    x, P, nis, ok = sweep(kind, c)
    x_twin, P_twin, nis_twin, ok_twin = twin(kind, c)
    assert ok.all()
    assert ok_twin.all()
    assert x == pytest.approx(x_twin, rel=1e-9, abs=1e-9)
    assert pytest.approx(P_twin, rel=1e-9, abs=1e-9) == P
    assert nis == pytest.approx(nis_twin, rel=1e-7, abs=1e-7)


@both
def test_drives_do_not_meet(kind):
    """All drives together equal each alone, and order of drives within a tick is nothing."""
    c = case(n=4)
    x, P, nis, _ = sweep(kind, c)
    order = np.lexsort((-c.rows.drive, c.rows.tick))
    x_turned, P_turned, nis_turned, _ = sweep(kind, c, Rows(*(column[order] for column in c.rows)))
    assert (x_turned == x).all()
    assert (P_turned == P).all()
    assert (nis_turned == nis[order]).all()
    for d in range(4):
        mine = c.rows.drive == d
        x_alone, P_alone, nis_alone, _ = sweep(kind, c, Rows(*(column[mine] for column in c.rows)))
        assert (x_alone[d] == x[d]).all()
        assert (P_alone[d] == P[d]).all()
        assert (nis_alone == nis[mine]).all()


@both
def test_permuted_drives_give_permuted_results(kind):
    c = case(n=4)
    x, P, _, _ = sweep(kind, c)
    order = np.array([2, 0, 3, 1])
    place = np.argsort(order).astype(np.int32)
    permuted = Case(
        Pmsm(*(value[order] for value in c.par)),
        Noise(*(value[order] for value in c.noise)),
        c.rows._replace(drive=place[c.rows.drive]),
        c.x[order],
        c.P[order],
        c.lean[order],
    )
    x_permuted, P_permuted, _, _ = sweep(kind, permuted)
    assert (x_permuted == x[order]).all()
    assert (P_permuted == P[order]).all()


@both
@pytest.mark.parametrize("field", ["u", "y"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e308])
def test_a_bad_number_stops_its_drive_only(kind, field, bad):
    c = case(n=3, ticks=480)
    x_good, _, _, _ = sweep(kind, c)
    values = getattr(c.rows, field).copy()
    rows_of_1 = np.flatnonzero(c.rows.drive == 1)
    at = rows_of_1[5]
    values[at, 0] = bad
    before = np.arange(len(c.rows.drive)) < at
    x_before, P_before, _, _ = sweep(kind, c, Rows(*(column[before] for column in c.rows)))
    x, P, nis, ok = sweep(kind, c, c.rows._replace(**{field: values}))
    assert ok.tolist() == [True, False, True]
    assert (x[[0, 2]] == x_good[[0, 2]]).all()
    assert (x[1] == x_before[1]).all()
    assert (P[1] == P_before[1]).all()
    assert np.isnan(nis[rows_of_1[5:]]).all()
    assert np.isfinite(nis[rows_of_1[:5]]).all()
    bad_twin = twin(kind, c._replace(rows=c.rows._replace(**{field: values})))
    assert bad_twin[3].tolist() == [True, False, True]
    assert bad_twin[0] == pytest.approx(x, rel=1e-9, abs=1e-9)


@both
def test_a_broken_start_is_told_not_raised(kind):
    c = case(n=3)
    P = c.P.copy()
    P[2] = np.diag([1.0, 1.0, 1.0, -50.0, 1.0])
    P[0] = np.nan
    _, _, _, ok = sweep(kind, c._replace(P=P))
    assert not ok[0]
    assert ok[1]
    # The EKF may carry a small negative variance to positive again; not one of this size.
    assert not ok[2]


def test_a_covariance_that_rounding_broke_is_repaired_among_sound_ones():
    """All lanes are done again, with repair; the sound ones do not notice."""
    c = case(n=11, ticks=320)
    x_sound, P_sound, _, _ = sweep("ukf", c)
    P = c.P.copy()
    P[4, 0, 1] = P[4, 1, 0] = np.sqrt(P[4, 0, 0] * P[4, 1, 1]) * (1.0 + 1e-8)
    broken = c._replace(P=P)
    x, P, nis, ok = sweep("ukf", broken)
    x_twin, P_twin, nis_twin, _ = twin("ukf", broken)
    assert ok.all()
    others = np.arange(11) != 4
    assert (x[others] == x_sound[others]).all()
    assert (P[others] == P_sound[others]).all()
    assert (x[4] != x_sound[4]).any()
    # What is nearly singular is as ill conditioned in both.
    assert x == pytest.approx(x_twin, rel=1e-6, abs=1e-6)
    assert pytest.approx(P_twin, rel=1e-5, abs=1e-6) == P
    assert np.isfinite(nis).all()
    assert np.isfinite(nis_twin).all()


@both
def test_no_rows_is_no_change(kind):
    c = case()
    x, P, nis, ok = sweep(kind, c, Rows(*(column[:0] for column in c.rows)))
    assert (x == c.x).all()
    assert (P == c.P).all()
    assert nis.shape == (0,)
    assert ok.all()


@both
@pytest.mark.parametrize("n", [1, 2, 3, 5, 8, 13])
def test_any_registers_give_the_same_bytes(kind, n):
    """Also where lanes are empty, samples are of different lengths and some are no numbers."""
    c = case(n=n, ticks=800)
    rng = np.random.default_rng(n)
    y, n_sub = c.rows.y.copy(), rng.choice([1, 16], len(c.rows.drive), p=[0.2, 0.8])
    y[rng.integers(0, len(y))] = np.nan
    P = c.P.copy()
    P[0, 0, 1] = P[0, 1, 0] = np.sqrt(P[0, 0, 0] * P[0, 1, 1]) * (1.0 + 1e-8)
    odd = c._replace(rows=c.rows._replace(y=y, n_sub=n_sub), P=P)
    wanted = [column.tobytes() for column in sweep(kind, odd, bits=128)]
    for bits in (0, *widths() - {128}):
        found = sweep(kind, odd, bits=bits)
        assert [column.tobytes() for column in found] == wanted, bits


def widths():
    """Registers, in bits, of the filters' builds that this processor can run, as Linux lists it."""
    flags = set(Path("/proc/cpuinfo").read_text().split())
    found = {128}
    if "avx2" in flags:
        found.add(256)
        if {"avx512f", "avx512dq", "avx512vl"} <= flags:
            found.add(512)
    return found


@pytest.mark.parametrize("bits", [64, 128, 256, 512, 1024])
def test_registers_that_the_processor_has_are_used_and_others_are_refused(bits):
    if bits in widths():
        assert sweep("ekf", case(ticks=32), bits=bits)[3].all()
    else:
        with pytest.raises(ValueError, match=f"{bits} bits"):
            sweep("ekf", case(ticks=32), bits=bits)


def subsets(bits):
    """All sums of these bits, of which each counts once."""
    return [sum(1 << bit for bit in some) for n in range(len(bits) + 1)
            for some in combinations(bits, n)]  # fmt: skip


def test_registers_are_used_that_processor_and_system_both_have():
    """By Intel's manual: CPUID leaf 7, EBX bit 5 AVX2, 16, 17 and 31 AVX-512 F, DQ and VL; XCR0
    bits 1 and 2 the registers of AVX, 5 to 7 those of AVX-512. Bits beside them say nothing."""
    for ebx in subsets((4, 5, 6, 15, 16, 17, 18, 30, 31)):
        for saved in subsets((0, 1, 2, 3, 4, 5, 6, 7)):
            avx2 = ebx >> 5 & 1 and saved >> 1 & 3 == 3
            avx512 = ebx >> 16 & 3 == 3 and ebx >> 31 and saved >> 5 & 7 == 7
            assert lib.filter_widest(ebx, saved) == bool(avx2) + bool(avx2 and avx512)


def test_what_the_system_saves_can_be_read_where_osxsave_says_so():
    for ecx in subsets((0, 26, 27, 28, 31)):
        assert lib.filter_registers_are_readable(ecx) == ecx >> 27 & 1


def test_a_filter_that_is_reset_knows_nothing():
    two = filters.unstarted(2)
    two.x, two.P, two.steps, two.active = 7.0, 3.0, 9, 1
    lib.filter_reset(pointer("struct filter", two))
    assert (two.x == [[0.0] * 5, [7.0] * 5]).all()
    assert ([np.eye(5), np.full((5, 5), 3.0)] == two.P).all()
    assert two.steps.tolist() == [0, 9]
    assert two.active.tolist() == [0, 1]
