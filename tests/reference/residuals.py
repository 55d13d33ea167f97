"""Residuals of one motor in NumPy, which `estimators/thermal/residuals.c` is compared with.

The model's step has a law of its own (`test_a_step_is_backward_euler`); here it is the product's.
"""

from __future__ import annotations

import math

import numpy as np

from estimators.thermal import model
from tests.reference import step_detector
from tests.thermal_core import step

ENDS = (model.K_D, model.F_D, model.B_D), (model.K_N, model.F_N, model.B_N)


def start(p, speed, air, reading):
    """Lumps (5,) degC: an end gains k (frame - end) + f speed and loses b (end - air), balanced."""
    seen = reading - p[model.OFFSETS]
    frames = []
    for own, (k, f, b) in zip(seen[1:], ENDS, strict=True):
        balanced = own + (p[b] * (own - air) - p[f] * speed) / p[k]
        frames += [max(balanced, min(own, air))] if math.isfinite(own) else []
    frame = float(np.mean(frames)) if frames else 0.5 * (seen[0] + air)
    ends = [(p[k] * frame + p[f] * speed + p[b] * air) / (p[k] + p[b]) for k, f, b in ENDS]
    winding, drive, other = np.where(np.isfinite(seen), seen, [frame, *ends])
    return np.array([winding, 0.5 * (winding + frame), frame, drive, other])


class Motor:
    """What is remembered of a motor with parameters p (18,)."""

    def __init__(self, p, centre, config):
        self.p, self.centre, self.config = p, centre, config
        self.unknown_s = 0.0
        self.reset()

    def reset(self):
        """Nothing is known; its step detectors look at no readings yet."""
        self.lumps, self.span, self.half = None, 0.0, np.zeros((2, 6))
        self.window = np.full((3, self.config.window), np.nan)
        self.steps = np.empty((3, step_detector.STATE))
        for state in self.steps:
            step_detector.start(state)

    def add(self, k, reading, square, speed, air, cut_out=False):
        """The k-th sample of a block: residuals (3,) K with and without steps."""
        c, p, nothing = self.config, self.p, np.full(3, np.nan)
        since = c.dt_s + self.unknown_s
        known = bool(np.isfinite([square, speed, air]).all())
        self.unknown_s = 0.0 if known else since
        self.lost = cut_out or (self.lumps is not None and self.unknown_s > c.gap_s)
        if self.lost:
            self.reset()
        if self.lost or not known:
            return nothing, nothing
        if self.lumps is None:
            if not np.isfinite(reading).any():
                return nothing, nothing
            self.lumps, since = start(p, speed, air, reading - self.centre), c.dt_s
            self.span = self.lumps[0] - self.lumps[2]
        step(p, square, speed, air, np.zeros(5), since, self.lumps)
        rise = max(self.lumps[2] - air, 3.0)
        copper = p[model.A] * square * (1.0 + 0.0039 * (self.lumps[0] - 60.0))
        sums = square, speed, (p[model.H_0] + p[model.H_1] * speed) * rise, copper, rise, 1.0
        self.half[int(k >= c.block / 2)] += sums
        raw = reading - p[model.OFFSETS] - self.centre - self.lumps[list(model.MEASURED)]
        return raw, np.array([self._less_step(*pair) for pair in enumerate(raw)])

    def _less_step(self, q, residual):
        c, state = self.config, self.steps[q]
        if c.step_k > 0.0:
            self.window[q] = *self.window[q, 1:], residual
            step_detector.one(
                self.window[q], state, c.before, c.after, c.step_k, c.back_k, c.drift_k
            )
        settled = state[step_detector.SINCE] < 0
        return residual - state[step_detector.OFF] if settled else np.nan
