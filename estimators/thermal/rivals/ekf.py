"""Residual of an extended Kalman filter: paper `thermal`, Table 2 and, as its model, eq. (1).

For every point, with heat gain c and heat loss xi that walk slowly (ageing),

    dT/dt = c (I^2 + g w^2) - xi (T - T_out)        reading = T + b + noise

c, xi, g and the offset b are fitted to the fault-free run; the filter starts from them.
Eq. (1) is corrected: the loss is subtracted from the heat, and both are multiplied by dt. The term
g is added for the losses of iron and bearings: without it the bearings' residual is 2.5 K, not
1.1 K (100 days). A missing reading gives no innovation and changes no state.

`FOLLOWING` is the filter as it is usually described, with coefficients that walk fast: it follows
the fault and misses nearly all of it.

Tried on seeds 0, 3, 6, 9: walk 0 to 0.3, prior_sigma 0.001 to 0.05, with and without `joint`, means
of 2 to 5 %; nearly fixed coefficients won: at a walk of 0.1, not joint, c and xi follow the fault
(overheating, 100 days: AUC 0.60, not 0.99). At 1 Hz T itself follows it, whatever was tried.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from _traction_core import ffi, lib

from dbc import records
from dbc.arrays import Array
from dbc.records import pointer
from estimators.thermal.record import Record
from estimators.thermal.rivals.dpca import TINY, Scorer, moving, span, usual

LOSSES = np.geomspace(1.0 / 14_400.0, 1.0 / 120.0, 24)
"""Heat losses that are tried, 1/s: time constants from four hours to two minutes."""


@dataclass(frozen=True)
class EkfResidual:
    """Tuning of the filter.

    walk: relative walk of c and xi within a run; prior_sigma: their relative sigma at the start;
    joint: whether innovations are weighted by their covariance in the fault-free run, not only by
    the filter's own; window: share of the run's samples over which the statistic is averaged.
    """

    walk: float = 0.001
    prior_sigma: float = 0.001
    joint: bool = True
    window: float = 0.03
    name: str = "ekf"

    def fit(self, healthy: Record) -> Scorer:
        """Learn from one fault-free run. Raises ValueError for fewer than 10 samples."""
        if len(healthy.at) < 10:
            raise ValueError(f"{len(healthy.at)} samples are too few")
        model = Lumped.of(healthy)
        window = span(healthy, self.window)
        step = self.walk**2 / len(healthy.at)
        points = len(model.loss)
        weight: Array = np.eye(points)
        if self.joint:
            own = innovations(healthy, model, step, self.prior_sigma)[1:]
            shape = own.T @ own / len(own)
            floor = 1e-2 * float(np.trace(shape)) / points + TINY
            weight = np.asarray(np.linalg.inv(shape + floor * np.eye(points)), dtype=np.float64)

        def score(record: Record) -> Array:
            own = innovations(record, model, step, self.prior_sigma)[1:]
            square = np.einsum("ki,ij,kj->k", own, weight, own) / points
            out = np.full(len(record.at), np.nan)
            out[1:] = moving(np.maximum(square, 0.0), window)
            return out

        return score


FOLLOWING = EkfResidual(walk=0.1, prior_sigma=0.05, joint=False, window=0.02, name="ekf_following")


class Lumped(NamedTuple):
    """Eq. (1) of N = 3 M points, each field (N,); `struct lumped_model` is one point.

    gain: K/(A^2 s); loss: 1/s; speed_share: g, A^2 s^2; offset: K; unrest, noise: K^2, variances
    of what the model leaves out and of a reading; usual: degC.
    """

    gain: Array
    loss: Array
    speed_share: Array
    offset: Array
    unrest: Array
    noise: Array
    usual: Array

    @classmethod
    def of(cls, healthy: Record) -> Lumped:
        """Least squares over a fault-free run, with the loss from `LOSSES`."""
        from scipy.signal import lfilter

        reading = healthy.temperature.reshape(len(healthy.at), -1)
        points = reading.shape[1]
        heat = np.concatenate([healthy.current_square, healthy.speed[:, None] ** 2], axis=1)
        found = np.full((points, 6), np.nan)
        found[:, 4] = np.inf
        for loss in LOSSES.tolist():
            keep = np.exp(-loss * healthy.step_s)
            # Exact response of a first-order lag to steps of constant heat and ambient.
            driven = lfilter([1.0 - keep], [1.0, -keep], heat / loss, axis=0)[healthy.at]
            first = healthy.ambient[:1] * keep
            air = lfilter([1.0 - keep], [1.0, -keep], healthy.ambient, zi=first)[0][healthy.at]
            start = np.exp(-loss * healthy.step_s * (healthy.at + 1.0))
            for n in range(points):
                known = np.isfinite(reading[:, n])
                if known.sum() < 5:
                    continue
                columns = [driven[:, n // 3], driven[:, -1], np.ones(len(air)), start]
                table = np.stack(columns, axis=1)[known]
                scale = np.maximum(np.abs(table).max(axis=0), TINY)
                wanted = reading[known, n] - air[known]
                # Neither current nor speed may cool.
                lower = np.array([0.0, 0.0, -np.inf, -np.inf])
                solution = _bounded(table / scale, wanted, lower) / scale
                rest = wanted - table @ solution
                variance = float(rest.var())
                if variance < found[n, 4]:
                    fine = min(float(np.diff(rest).var()) / 2.0, variance)
                    found[n] = [loss, *solution[:3], variance, max(fine, 1e-4)]
        lost = ~np.isfinite(found[:, 0])
        found[lost] = [LOSSES[0], 0.0, 0.0, 0.0, 1.0, 1e6]  # no readings: practically no weight
        losses, gain, by_speed, offset, spread, noise = found.T
        gain = np.maximum(gain, 1e-12)
        ambient = float(healthy.ambient.mean())
        mean = np.where(lost, ambient, usual(reading))
        unrest = np.maximum(spread - noise, 1e-4)
        return cls(gain, losses, by_speed / gain, offset, unrest, noise, mean)


def _bounded(table: Array, wanted: Array, lower: Array) -> Array:
    """Least squares; a result below its bound is set to the bound and the rest solved again."""
    free = np.ones(table.shape[1], dtype=np.bool_)
    out = np.zeros(table.shape[1])
    for _ in range(len(lower)):
        out[free] = np.linalg.lstsq(table[:, free], wanted, rcond=None)[0]
        bad = free & (out < lower)
        if not bad.any():
            break
        free &= ~bad
        out[bad] = lower[bad]
    return out


def innovations(record: Record, model: Lumped, step: float, prior_sigma: float) -> Array:
    """(K, N) innovations over their sigma, 0 where there is no reading.

    step: variance of the logarithms of gain and loss per sample; prior_sigma: their standard
    deviation at the start.
    For a missing reading the filter's own prediction stands.
    """
    motors = record.temperature.shape[1]
    reading = record.temperature.reshape(-1, 3 * motors).T.astype(np.float64, order="C")
    out = np.zeros(reading.shape)
    at = np.ascontiguousarray(record.at, dtype=np.int64)
    inputs = np.empty((motors, len(record.speed)), records.THERMAL_INPUT)
    inputs["current_square"] = record.current_square.T
    inputs["speed"], inputs["ambient"] = np.abs(record.speed), record.ambient
    models = pointer("struct lumped_model", np.stack(model, axis=1))
    tuning = ffi.new("struct lumped_tuning *", (record.step_s, step, prior_sigma))
    for n in range(3 * motors):
        lib.lumped_innovations(
            models + n, tuning, pointer("struct thermal_input", inputs[n // 3]),
            pointer("double", reading[n]), pointer("int64_t", at), len(at),
            pointer("double", out[n]),
        )  # fmt: skip
    return np.ascontiguousarray(out.T)
