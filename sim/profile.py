"""Speed and load over time, from the scenario's `[motion]` and `[load]`.

May know: scenarios. May not know: bits, buses, clocks, the plant's state.
"""

from __future__ import annotations

import math

import numpy as np

from dbc.arrays import Array
from sim.scenario import Scenario
from sim.scenario_schema import Load


class Profile:
    """The speed wanted and the load met at any time."""

    def __init__(self, scenario: Scenario, pole_pairs: int) -> None:
        """`pole_pairs` turns electrical speeds into the rotor's."""
        self._load = scenario.load
        points = scenario.motion.profile or [(0.0, scenario.motion.speed)]
        factor = math.pi / 30.0 if scenario.motion.unit == "rpm" else 1.0 / pole_pairs
        self._times = np.array([t for t, _ in points])
        self._speeds = factor * np.array([w for _, w in points])
        inner = np.diff(self._speeds) / np.diff(self._times)
        self._slopes = np.concatenate([[0.0], inner, [0.0]])

    def at(self, t_s: Array) -> tuple[Array, Array, Array]:
        """Rotor speed rad/s, its slope rad/s2, load Nm, each (n,), at times (n,)."""
        w_ref = np.interp(t_s, self._times, self._speeds)
        w_acc = self._slopes[np.searchsorted(self._times, t_s, side="right")]
        return w_ref, w_acc, load_nm(self._load, t_s)


def load_nm(load: Load, t_s: Array) -> Array:
    """The load of one drive, Nm (n,), at times (n,)."""
    points = load.profile or [(0.0, load.torque_nm)]
    times = np.array([t for t, _ in points])
    values = np.array([v for _, v in points])
    if load.transition == "linear":
        return np.asarray(np.interp(t_s, times, values), dtype=np.float64)
    out = np.full_like(t_s, values[0])
    for at, step in zip(times[1:], np.diff(values), strict=True):
        from scipy.special import ndtr  # slow to load, and rarely needed

        out += step * ndtr((t_s - at) / load.smooth_s)
    return out
