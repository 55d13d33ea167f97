"""`gateway/core/sample_clock.c` equals the reference, sample by sample, from any sender."""

import cmath

import numpy as np
import pytest
from _traction_core import ffi, lib

from tests.reference.sample_clock import SampleClock

PERIOD_NS, MAX_GAP_NS = 2_000_000, 200_000_000
NUMBERS = ("late_ns", "mean_ns", "usual_ns")


class Both:
    """The core's clock and the reference, which get the same samples."""

    def __init__(self, u=100.0 + 0.0j, period_ns=PERIOD_NS):
        self.u, self.period_ns = u, period_ns
        self.clock = ffi.new("struct sample_clock *")
        lib.start_sample_clock(self.clock, [u.real, u.imag], period_ns)
        self.plain = SampleClock(0, u, period_ns, MAX_GAP_NS)
        self.same()

    def step(self, passed_ns, cycles, turn):
        """A sample whose voltage has turned so far; returns periods left out."""
        self.u *= cmath.exp(1j * turn)
        u = [self.u.real, self.u.imag]
        got = lib.step_sample_clock(
            self.clock, u, passed_ns, cycles, self.period_ns, MAX_GAP_NS
        )  # fmt: skip
        assert got == self.plain.step(passed_ns, self.u, cycles)
        self.same()
        return got

    def same(self):
        clock, plain = self.clock, self.plain
        assert [getattr(clock, name) for name in NUMBERS] == [plain.late, plain.mean, plain.usual]
        assert clock.samples == min(plain.seen, 16)
        assert complex(*clock.u) == plain.u
        assert complex(*clock.turn) == pytest.approx(plain.turn, rel=1e-12, abs=1e-9)


def steady(samples=40, each=0.3, **options):
    """A sender that keeps its period."""
    both = Both(**options)
    for _ in range(samples):
        assert both.step(both.period_ns, 1, each) == 0
    return both


@pytest.mark.parametrize("seed", range(40))
def test_it_equals_the_reference(seed):
    """Delays, bursts, gaps, samples that nobody counted, periods that are not the DBC's."""
    rng = np.random.default_rng(seed)
    both = Both()
    each = float(rng.choice([0.02, 0.06, -0.3, 0.5, 1.0]))
    real_ns = PERIOD_NS * float(rng.choice([1.0, 1.0, 1.0 + 1e-4, 0.999, 1.1, 1.126, 0.874]))
    often, jitter_ns, late_ns = rng.choice([0.0, 0.05]), rng.choice([0.0, 1e4, 4e5]), 0.0
    for _ in range(1500):
        cycles = int(rng.integers(1, 10)) if rng.random() < 0.05 else 1
        missing = int(rng.integers(1, 9)) if rng.random() < often else 0
        was_ns, late_ns = late_ns, abs(rng.normal(0.0, jitter_ns))
        if rng.random() < 0.02:
            late_ns += rng.uniform(0.0, 6.0) * PERIOD_NS
        if rng.random() < 0.002:
            late_ns += 1.5 * MAX_GAP_NS
        passed = (cycles + missing) * real_ns + late_ns - was_ns
        turned = (cycles + missing) * each * (1.0 if rng.random() < 0.9 else 1.3)
        both.step(int(passed), cycles, turned + rng.normal(0.0, 0.01))
    assert both.clock.samples == 16


@pytest.mark.parametrize("cycles", [1, 2, 3, 7, 8])
@pytest.mark.parametrize("missing", [1, 2, 3, 6, 7, 8])
@pytest.mark.parametrize("each", [0.3, -0.3])
def test_what_is_left_out_is_found_up_to_eight_periods_in_all(cycles, missing, each):
    both = steady(each=each)
    wanted = missing if cycles + missing <= 8 else 0
    periods = cycles + missing
    assert both.step(periods * PERIOD_NS, cycles, periods * each) == wanted


def test_what_is_only_delayed_is_not_left_out():
    both = steady()
    assert both.step(3 * PERIOD_NS, 1, 0.3) == 0


@pytest.mark.parametrize("samples", [14, 15, 16, 17])
def test_nothing_is_left_out_before_sixteen_samples_have_come(samples):
    both = steady(samples)
    assert both.step(2 * PERIOD_NS, 1, 0.6) == (samples >= 16)


@pytest.mark.parametrize("beyond_ns", [-1, 0, 1])
@pytest.mark.parametrize("periods", [1, 2])
def test_a_sample_is_late_from_three_quarters_of_a_period(beyond_ns, periods):
    both = steady()
    late_ns = (4 * periods - 1) * PERIOD_NS // 4 + beyond_ns
    turned = periods + (beyond_ns >= 0)
    both.step(PERIOD_NS + late_ns, 1, turned * 0.3)


@pytest.mark.parametrize("each", [0.0499, 0.0501])
def test_a_rotor_that_hardly_turns_says_nothing(each):
    both = steady(200, each)
    assert both.step(2 * PERIOD_NS, 1, 2 * each) == (each > 0.05)


@pytest.mark.parametrize(("part", "wanted"), [(0.34, 1), (0.36, 0), (-0.34, 1), (-0.36, 0)])
def test_a_turn_fits_to_a_third_of_itself(part, wanted):
    both = steady(200)
    assert both.step(2 * PERIOD_NS, 1, (2 + part) * 0.3) == wanted


@pytest.mark.parametrize("off_ns", range(-3, 4))
@pytest.mark.parametrize("side", [-1, 1])
def test_a_sender_of_another_period_has_no_lateness(side, off_ns):
    """From an eighth of the DBC's on."""
    both = steady()
    both.clock.mean_ns = both.plain.mean = PERIOD_NS + side * PERIOD_NS // 8 + off_ns
    for _ in range(3):
        both.step(both.clock.mean_ns + 300_000, 1, 0.3)


def test_no_sample_is_later_than_the_longest_gap_or_before_it_was_due():
    both = steady()
    for passed_ns in (MAX_GAP_NS, MAX_GAP_NS, 5 * PERIOD_NS, 0, 0, PERIOD_NS - 1, -(10**12)):
        both.step(passed_ns, 1, 0.3)
        assert 0 <= both.clock.late_ns <= MAX_GAP_NS


def test_a_period_of_a_nanosecond_and_numbers_that_are_none():
    both = steady(period_ns=1)
    both.step(10**9, 1, 0.3)
    clock = both.clock
    for bad in (float("nan"), float("inf")):
        assert lib.step_sample_clock(clock, [bad, bad], 3 * PERIOD_NS, 1, PERIOD_NS, 10**9) == 0
