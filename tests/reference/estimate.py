"""The estimates of a tick in Python, which `gateway/core/estimate.c` is compared with.

What learns from samples (calibration, chords, filters, adaptation) is that of the core, each
compared with a reference of its own; here is what becomes of the filters, and what is known.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from _traction_core import lib

from dbc.records import Columns, Records, pointer
from estimators import filters
from gateway.core.codes import Health, Reason
from gateway.core.estimate import Bank, estimates
from tests.core_calls import acquisition, adaptation, current_calibration
from tests.core_calls.acquisition import Consistency
from tests.sample_rows import Samples

LONGEST_GAP: Final = 64
DISAGREE_TICKS: Final = 3
DIVERGED_NS: Final = 100_000_000
SETTLE_STEPS: Final = 480
SIGMA_LIMIT: Final = 2.0
SIGMA_RISE: Final = 1.01
MOVING: Final = 0.07
MEDIAN_CHANGE: Final = 0.954
LASTING: Final = 0.005
FLUX_TAU_S: Final = 0.5
FLUX_SURE: Final = 0.03
RESISTANCE_SURE: Final = 0.25
INVALID: Final = (Reason.CORRUPTED, Reason.SEQUENCE, Reason.RANGE, Reason.NOT_AVAILABLE)
W_E, T_L = 2, 4


class Estimates:
    """N drives; one `tick` after the other."""

    def __init__(self, bank: Bank, tick_s: float) -> None:
        """With the constants of a bank."""
        n = len(bank.motors)
        self.n, self.tick_s, self.motors, self.noise = n, tick_s, bank.motors, bank.noise
        self.rated_a, self.rated_nm = bank.rated_a, bank.rated_nm
        self.limits, self.settings = bank.record["limits"], bank.record["settings"]
        self.filters, self.chords = filters.unstarted(n), acquisition.start(n)
        self.sensors, self.out = current_calibration.start(n), estimates(n)
        self.disagree, self.diverged_ns = [0] * n, [-1] * n
        self.best, self.silent = [math.inf] * n, [False] * n
        self.load, self.change = [0.0] * n, [0.0] * n
        self.spread, self.learnt, self.unsure = [1.0] * n, [0] * n, [0.0] * n

    def tick(
        self, samples: Samples, restarts: set[int], inputs: Records, now: int
    ) -> tuple[Columns, Records]:
        """Samples with their innovations, and the estimates."""
        for k in restarts:
            self._forget(k)
            acquisition.restart(self.chords, k)
            current_calibration.restart(self.sensors, k)
            self.out["flux_ratio"][k], self.unsure[k] = math.nan, 0.0
        for k, steps, gap in zip(samples.drive, samples.steps, samples.gap, strict=True):
            if gap > max(steps, LONGEST_GAP):
                self._forget(k)
        done = filters.sample_records(*samples)
        self._run(done)
        for k in range(self.n):
            if not self.filters.is_finite[k]:
                active = bool(self.filters.active[k])
                self._drop(k)
                self.filters.steps[k] = -1 if active else 0
        for k in range(self.n):
            self._note(k, k not in samples.drive)
            self._flux(k)
            if self.filters.active[k] and self.chords.pairs[k] < acquisition.PAIRS:
                self._forget(k)
        agrees = acquisition.check(self.chords, self.filters)
        for k in range(self.n):
            self.out["health"][k] = self._judge(k, inputs[k], agrees[k], now)
        return done, self.out

    def _run(self, samples: Columns) -> None:
        dt = self.settings["dt"].item()
        current_calibration.calibrate(samples, self.sensors, self.chords, self.rated_a, dt)
        acquisition.add(samples, self.motors, self.chords, self.limits, dt)
        filters.run(samples, self.motors, self.noise, self.filters, self.settings)
        adaptation.adapt(samples, self.filters, self.chords, self.motors, self.rated_a, dt)

    def _forget(self, k: int) -> None:
        mine = self.filters
        mine.active[k], mine.steps[k] = 0, 0
        mine.x[k], mine.P[k] = 0.0, np.eye(5)
        self.disagree[k] = 0

    def _drop(self, k: int) -> None:
        self._forget(k)
        self.filters.v_q_bias[k] = 0.0

    def _note(self, k: int, silent: bool) -> None:
        self.silent[k] = silent
        if not silent:
            load = self.filters.x.item(k, T_L)
            self.change[k], self.load[k] = abs(load - self.load[k]), load
            self._learn(k)

    def _learn(self, k: int) -> None:
        """Half of the changes of a settled load are larger than the median."""
        if not self.filters.active[k] or self.filters.steps[k] < SETTLE_STEPS:
            return
        step = max(0.03, 0.5 / (2 + self.learnt[k]))
        sigma = self.spread[k] * math.sqrt(self.filters.P.item(k, T_L, T_L))
        more = self.change[k] > MEDIAN_CHANGE * sigma
        self.spread[k] *= 1.0 + step if more else 1.0 / (1.0 + step)
        self.spread[k] = min(max(self.spread[k], 0.01), 4.0)
        self.learnt[k] += 1

    def _flux(self, k: int) -> None:
        a, flux = self.chords[k], self.out["flux_ratio"]
        psi_f, resistance = self.motors.item(k, 2), self.motors.item(k, 0)
        if not a.ready or not math.isfinite(a.psi) or a.w == 0.0:
            return
        length = math.sqrt(a.i_last.real**2 + a.i_last.imag**2)
        sure = FLUX_SURE * psi_f + RESISTANCE_SURE * resistance * length / abs(a.w)
        more = math.copysign(max(abs(a.psi - psi_f) - sure, 0.0), a.psi - psi_f) / psi_f
        within = min(abs(a.psi - psi_f), sure) / psi_f
        self.unsure[k] += self.tick_s / FLUX_TAU_S * (within - self.unsure[k])
        before = more if math.isnan(flux[k]) else flux[k] - 1.0
        flux[k] = 1.0 + before + self.tick_s / FLUX_TAU_S * (more - before)

    def _judge(self, k: int, come: Records, agrees: Consistency, now: int) -> Health:
        mine, out = self.filters, self.out
        for name in ("speed_rad_s", "load_nm", "load_sigma_nm", "nis"):
            out[name][k] = math.nan
        steps = mine.steps.item(k)
        if steps < 0:
            mine.steps[k], self.diverged_ns[k] = 0, now
        if agrees is Consistency.INCONSISTENT and mine.active[k]:
            self.disagree[k] += 1
            if self.disagree[k] >= DISAGREE_TICKS:
                self._drop(k)
                if steps >= SETTLE_STEPS:
                    self.diverged_ns[k] = now
        else:
            self.disagree[k] = 0
        if self.diverged_ns[k] >= 0 and now - self.diverged_ns[k] < DIVERGED_NS:
            return Health.DIVERGED
        a, fresh = self.chords[k], bool(come["sample_fresh"])
        if fresh and a.ready and a.age < 2.0 * a.span and not mine.active[k]:
            self._start(k)
            agrees = Consistency.CONSISTENT
        return self._describe(k, come["reason"], fresh, agrees)

    def _start(self, k: int) -> None:
        mine = self.filters
        rated = self.rated_nm.item(k)
        acquisition.start_filter(self.chords, k, self.motors, self.noise.R, rated, mine)
        mine.active[k], mine.steps[k], mine.nis[k] = 1, 0, 2.0
        self.diverged_ns[k], self.disagree[k] = -1, 0
        self.spread[k], self.learnt[k] = 1.0, 0
        if mine.v_q_bias[k] == 0.0:
            mine.v_q_bias[k] = lib.first_q_bias(
                pointer("struct acquisition", self.chords[k:]),
                pointer("struct pmsm", self.motors[k:]), self.rated_a.item(k),
            )  # fmt: skip

    def _describe(self, k: int, cause: int, fresh: bool, agrees: Consistency) -> Health:
        mine, out = self.filters, self.out
        if cause in INVALID:
            return Health.INPUT_INVALID
        if self.silent[k] and self.change[k] > MOVING * self.rated_nm[k]:
            fresh = False
        if not mine.active[k]:
            return Health.CONVERGING if fresh else Health.UNKNOWN
        sigma = math.sqrt(mine.P.item(k, T_L, T_L))
        flux = 1.0 if math.isnan(out["flux_ratio"][k]) else out["flux_ratio"][k]
        out["speed_rad_s"][k] = mine.x[k, W_E] / self.motors[k, 3]
        load = mine.x.item(k, T_L)
        out["load_nm"][k] = load * flux
        scatter, lasting = self.spread[k] * sigma, (LASTING + self.unsure[k]) * load
        out["load_sigma_nm"][k] = math.sqrt(scatter * scatter + lasting * lasting) * flux
        out["nis"][k] = mine.nis[k]
        if not fresh:
            return Health.PREDICTING
        if mine.steps[k] < SETTLE_STEPS or agrees is not Consistency.CONSISTENT:
            return Health.CONVERGING
        self.best[k] = min(SIGMA_RISE * self.best[k], sigma)
        settled = sigma <= SIGMA_LIMIT * self.best[k]
        return Health.TRACKING if settled else Health.CONVERGING
