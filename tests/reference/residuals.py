"""Residuals of the motors in NumPy, which `estimators/thermal/residuals.c` is compared with.

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
    """What is remembered of a motor with parameters p (18,).

    peers (3,) K: the others' residuals, which it starts with as well. cold_s: it warms up for as
    long as it was cut out, three quarters of an hour at most, before it starts.
    """

    def __init__(self, p, centre, config):
        self.p, self.centre, self.config = p, centre, config
        self.unknown_s = self.cold_s = 0.0
        self.peers = np.full(3, np.nan)
        self.reset()

    def reset(self):
        """Nothing is known; its step detectors look at no readings yet."""
        self.lumps, self.span, self.half = None, 0.0, np.zeros((2, 6))
        self.window = np.full((3, self.config.window), np.nan)
        self.steps = np.empty((3, step_detector.STATE))
        for state in self.steps:
            step_detector.start(state)

    def add(self, k, reading, square, speed, air, cut_out=False):
        """The k-th sample of a block: residuals (3,) K; `less_steps` of all motors follows."""
        c, p, self.raw = self.config, self.p, np.full(3, np.nan)
        self.runs = False
        since = c.dt_s + self.unknown_s
        known = bool(np.isfinite([square, speed, air]).all())
        self.unknown_s = 0.0 if known else since
        self.cold_s = min(self.cold_s + c.dt_s, 2700.0) if cut_out else max(self.cold_s - c.dt_s, 0)
        left_out = cut_out or self.cold_s > 0.0
        self.lost = left_out or (self.lumps is not None and self.unknown_s > c.gap_s)
        if self.lost:
            self.reset()
        if self.lost or not known:
            return
        if self.lumps is None:
            if not np.isfinite(reading).any():
                return
            shared = np.where(np.isfinite(self.peers), self.peers, 0.0)
            self.lumps, since = start(p, speed, air, reading - self.centre - shared), c.dt_s
            self.span = self.lumps[0] - self.lumps[2]
        step(p, square, speed, air, np.zeros(5), since, self.lumps)
        rise = max(self.lumps[2] - air, 3.0)
        copper = p[model.A] * square * (1.0 + 0.0039 * (self.lumps[0] - 60.0))
        sums = square, speed, (p[model.H_0] + p[model.H_1] * speed) * rise, copper, rise, 1.0
        self.half[int(k >= c.block / 2)] += sums
        self.runs = True
        self.raw = reading - p[model.OFFSETS] - self.centre - self.lumps[list(model.MEASURED)]
        self.window = np.column_stack([self.window[:, 1:], self.raw])


def less_steps(motors):
    """(M, 3) K: the residuals of the last sample of every motor without steps."""
    out = np.full((len(motors), 3), np.nan)
    known = motors[0].config
    shared = known.step_k > 0.0 and step_detector.all_jump(
        [[motor.window[q] for motor in motors] for q in range(3)],
        known.before, known.after, known.step_k,
    )  # fmt: skip
    for q in range(3):
        windows = [motor.window[q] for motor in motors]
        for m, motor in enumerate(motors):
            c, state = motor.config, motor.steps[q]
            if motor.runs and c.step_k > 0.0:
                others = 0.0
                if not shared:
                    others = step_detector.others_jump(windows, m, c.before, c.after)
                step_detector.one(
                    windows[m], state, c.before, c.after, c.step_k, c.back_k, c.drift_k, others
                )
            if motor.runs and state[step_detector.SINCE] < 0:
                out[m, q] = motor.raw[q] - state[step_detector.OFF]
    return out
