"""Expectation-maximisation in NumPy, which `gaussian_mixture.c` is compared with."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def expect_maximise(x: Array, iterations: int, floor: float, out: Array) -> None:
    """EM from spread quantiles of x (N,); out (3, n): weights, means (ascending), variances."""
    count, n = x.shape[0], out.shape[1]
    ordered = np.sort(x)
    weight, mean, variance = out[0], out[1], out[2]
    spread = max(np.var(x), floor)
    for i in range(n):
        weight[i] = 1.0 / n
        mean[i] = ordered[((2 * i + 1) * count) // (2 * n)]
        variance[i] = spread
    total, first, second = np.empty(n), np.empty(n), np.empty(n)
    share, top = np.empty(n), np.empty(n)
    for _ in range(iterations):
        total[:] = 0.0
        first[:] = 0.0
        second[:] = 0.0
        for i in range(n):
            top[i] = math.log(max(weight[i], 1e-300)) - 0.5 * math.log(variance[i])
        for s in range(count):
            best = -1e300
            for i in range(n):
                d = x[s] - mean[i]
                share[i] = top[i] - 0.5 * d * d / variance[i]
                best = max(best, share[i])
            norm = 0.0
            for i in range(n):
                share[i] = math.exp(share[i] - best) if share[i] != best else 1.0
                norm += share[i]
            for i in range(n):
                p = share[i] / norm
                total[i] += p
                first[i] += p * x[s]
                second[i] += p * x[s] * x[s]
        for i in range(n):
            weight[i] = total[i] / count
            if total[i] > 1e-9:
                mean[i] = first[i] / total[i]
                variance[i] = max(second[i] / total[i] - mean[i] * mean[i], floor)
    order = np.argsort(mean)
    out[:, :] = out[:, order]
