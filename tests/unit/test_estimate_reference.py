"""`estimate.c` against Python: true motors whose samples are spoilt, missing, or start anew."""

import copy

import numpy as np
import pytest

from gateway.core import inputs
from gateway.core.codes import Health, Reason
from gateway.settings.config import BENCH_MOTOR
from gateway.settings.sections import Estimator
from tests.receivers import Received
from tests.reference import estimate as reference
from tests.same import same_numbers
from tests.sample_rows import Samples
from tests.stations import Bank
from tests.unit.test_bank_hostile import MADE, SECOND_TICKS, loop, ticks_of

N = 6
TICK_NS = 10_000_000
SHEETS = [
    BENCH_MOTOR.model_copy(update={"psi_pm": BENCH_MOTOR.psi_pm * psi})
    for psi in (1.0, 0.8, 1.25, 1.0, 1.0, 1.0)
]
REASONS = [Reason.NONE] * 12 + [Reason.STALE, Reason.STARTING, *reference.INVALID]


class Both:
    """Estimates and their reference on the same ticks."""

    def __init__(self, kind):
        self.bank = Bank(SHEETS, Estimator(kind=kind), 0.02, TICK_NS)
        self.plain = reference.Estimates(self.bank, TICK_NS / 1e9)
        self.box, self.come = Received(N, rows=128), inputs.statuses(N)

    def tick(self, samples, restarts, now):
        m = len(samples.drive)
        for mine, given in zip(self.box.samples, samples, strict=True):
            mine[:m] = given
        self.box.pointer.tick.samples = m
        self.box.drives["restart"] = [k in restarts for k in range(N)]
        self.bank.reserve(m)
        self.bank.run(self.box.pointer, self.come, now)
        done, out = self.plain.tick(samples, restarts, self.come, now)
        same_numbers(self.bank.samples.nis[:m], done.nis)
        same_numbers(self.bank.estimates, out)
        for mine, wanted in (
            (self.bank.filters, self.plain.filters), (self.bank.chords, self.plain.chords),
            (self.bank.sensors, self.plain.sensors),
            (self.bank.tracks.load_change_nm, self.plain.change),
            (self.bank.tracks.best_sigma_nm, self.plain.best),
            (self.bank.tracks.spread, self.plain.spread),
            (self.bank.tracks.flux_unsure, self.plain.unsure),
            (self.bank.tracks.disagree_ticks, self.plain.disagree),
            (self.bank.tracks.diverged_ns, self.plain.diverged_ns),
        ):  # fmt: skip
            same_numbers(np.asarray(mine), np.asarray(wanted))


def spoilt(rng, samples, mode, held):
    """Samples of drives with a mode are made to be something else, or do not come."""
    drive, u, y, steps, gap = (column.copy() for column in samples)
    names = list(MADE)
    for d in np.flatnonzero(mode >= 0):
        mine = drive == d
        if mode[d] < len(names):
            with np.errstate(all="ignore"):
                y[mine] = MADE[names[mode[d]]](rng, y[mine])
        elif mode[d] == len(names):
            held[d] += steps[mine].sum()
            drive, u, y, steps, gap = (part[~mine] for part in (drive, u, y, steps, gap))
    for d in np.flatnonzero((mode != len(names)) & (held > 0)):
        first = np.flatnonzero(drive == d)[:1]
        gap[first] += held[d]
        held[d] = 0
    return Samples(drive, u, y, steps, gap)


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
@pytest.mark.filterwarnings("ignore:.*encountered:RuntimeWarning")
def test_any_course_of_samples(kind):
    rng, both = np.random.default_rng(4), Both(kind)
    seconds, met, reasons = ticks_of(loop(N, every=16)), set(), set()
    mode, until, held = np.full(N, -1), np.zeros(N, dtype=int), np.zeros(N, dtype=int)
    for tick in range(1500):
        for d in np.flatnonzero(until <= tick):
            until[d] = tick + rng.integers(1, 80)
            mode[d] = rng.integers(len(MADE) + 1) if rng.random() < 0.4 else -1
        samples = spoilt(rng, seconds[tick % SECOND_TICKS], mode, held)
        both.come["sample_fresh"] = rng.random(N) < 0.97
        both.come["reason"] = rng.choice(REASONS, N)
        restarts = {int(rng.integers(N))} if rng.random() < 0.01 else set()
        if rng.random() < 0.05:
            # A filter that is on its way somewhere else.
            d, column = rng.integers(N), rng.choice([2, 3, 4])
            by = rng.choice([2.5, -400.0, 60.0])
            for filters in (both.bank.filters, both.plain.filters):
                filters.x[d, column] += by
        both.tick(samples, restarts, tick * TICK_NS)
        met |= set(both.bank.estimates["health"].tolist())
        reasons |= set(both.come["reason"].tolist())
    assert met == set(Health) == {*met}
    assert set(reference.INVALID) <= reasons
    ratio = both.bank.estimates["flux_ratio"]
    assert ratio[1] > 1.1 > 1.0 > ratio[2]


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_samples_that_stay_away_and_chords_that_start_anew(kind):
    """Holes of every length, many of them short: the chords lose their memory."""
    rng, both = np.random.default_rng(9), Both(kind)
    seconds, held = ticks_of(loop(N, every=16)), np.zeros(N, dtype=int)
    both.come["sample_fresh"], both.come["reason"] = 1, Reason.NONE
    for tick in range(600):
        samples = seconds[tick % SECOND_TICKS]
        lost = np.zeros(len(samples.drive), dtype=bool)
        if tick % 200 > 80:
            lost = (samples.drive % 2 == 0) & (rng.random(len(lost)) < 0.5)
        gap = samples.gap.copy()
        for k, d in enumerate(samples.drive):
            if lost[k]:
                held[d] += samples.steps[k] + gap[k]
            else:
                gap[k] += held[d]
                held[d] = 0
        kept = Samples(*(part[~lost] for part in samples._replace(gap=gap)))
        both.tick(kept, set(), tick * TICK_NS)
    assert (both.bank.estimates["health"][1::2] == Health.TRACKING).all()


def test_a_load_that_moved_is_not_held_and_one_badly_known_is_no_evidence():
    both, seconds = fed(60)
    assert (both.bank.estimates["health"] == Health.TRACKING).all()
    both.bank.tracks.best_sigma_nm[0] *= 0.4
    both.plain.best[0] *= 0.4
    both.tick(seconds[60], set(), 60 * TICK_NS)
    assert both.bank.estimates["health"][0] == Health.CONVERGING
    both.bank.tracks.load_change_nm[1] += 4.0
    both.plain.change[1] += 4.0
    both.tick(Samples(*(part[:0] for part in seconds[61])), set(), 61 * TICK_NS)
    assert both.bank.estimates["health"][1] == Health.PREDICTING


def test_a_start_that_does_not_settle_is_no_divergence():
    both = Both("ekf")
    both.come["sample_fresh"], both.come["reason"] = 1, Reason.NONE
    seconds, met = ticks_of(loop(N, every=16)), []
    for tick in range(30):
        both.tick(seconds[tick], set(), tick * TICK_NS)
        if both.bank.filters.active[0] and len(met) < 4:
            both.bank.x[0, 3] += 2.5
            both.plain.filters.x[0, 3] += 2.5
            met.append(both.bank.filters.steps.item(0))
    assert met == [0, 80, 160, 0], "dropped in the third tick, and started again"
    assert (both.bank.estimates["health"] == Health.TRACKING).all()


def fed(count):
    """EKFs that so many ticks with good samples have gone through, and the samples."""
    both = Both("ekf")
    both.come["sample_fresh"], both.come["reason"] = 1, Reason.NONE
    seconds = ticks_of(loop(N, every=16))
    for tick in range(count):
        both.tick(seconds[tick], set(), tick * TICK_NS)
    return both, seconds


def test_a_flux_that_is_not_known_changes_no_load():
    """Of chords that say nothing, whatever the reason."""
    both, seconds = fed(30)
    for chords, out in (
        (both.bank.chords, both.bank.estimates), (both.plain.chords, both.plain.out),
    ):  # fmt: skip
        chords.psi[0], chords.w[1] = np.nan, 0.0
        out["flux_ratio"][:2] = np.nan
    both.tick(Samples(*(part[:0] for part in seconds[30])), set(), 30 * TICK_NS)
    known = both.bank.estimates
    assert np.isnan(known["flux_ratio"][:2]).all()
    np.testing.assert_array_equal(known["load_nm"][:2], both.bank.x[:2, 4])


def test_a_copy_goes_on_alone():
    both, seconds = fed(30)
    twin = copy.deepcopy(both.bank)
    both.tick(seconds[30], set(), 30 * TICK_NS)
    twin.run(both.box.pointer, both.come, 30 * TICK_NS)
    same_numbers(twin.estimates, both.bank.estimates)
    twin.estimates["health"], twin.filters.x[0, 0] = Health.UNKNOWN, 99.0
    assert (twin.told.health == Health.UNKNOWN).all()
    assert (both.bank.told.health == Health.TRACKING).any() or both.bank.x[0, 0] != 99.0
