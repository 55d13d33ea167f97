"""Degradation as a jump diffusion: paper `thermal`, eq. (22)-(27).

    X(t) = X(0) + mu t + sigma B(t) + Z(t),   y = X + reading noise r

Z is compound Poisson. Jumps are found first, by the undecimated Haar transform (a decimated one
has only every other difference), or causally from differences. Drift, diffusion and r follow by
maximum likelihood from the increments dy without the jumps,

    dy ~ N(mu tau, C),   C = sigma^2 diag(tau) + r^2 tridiag(-1, 2, -1),
    mu = m'C^-1 dy / m'C^-1 m,   m = tau;

(27) as printed is no estimator, and without r the diffusion would be that of the readings' noise.
Sigma and r are found by Nelder-Mead.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from dbc.arrays import Array, Flags

GAUSS: Final = 1.4826
"""Standard deviation over median absolute deviation, of a normal distribution."""
JUMP: Final = 5.0
"""A difference of more than so many standard deviations is a jump."""


class Degradation(NamedTuple):
    """Result of `fit`.

    drift, per s, and drift_sigma, its standard error; diffusion, per sqrt(s); noise of a reading;
    jumps (k,): their sizes.
    """

    drift: float
    drift_sigma: float
    diffusion: float
    noise: float
    jumps: Array


def jump_points(y: Array) -> Flags:
    """Mask (K - 1,) of the differences of y (K,) that are jumps, by the undecimated Haar transform.

    The details of its first level are all differences over sqrt(2), circularly. The transform looks
    ahead by one sample.
    """
    import pywt

    padded = np.concatenate([y, y[-1:]] if len(y) % 2 else [y])
    detail = np.asarray(pywt.swt(padded, "haar", level=1, trim_approx=True)[1])
    # Haar's detail k holds y_k - y_(k+1); the last one wraps around.
    differences = -np.sqrt(2.0) * detail[: len(y) - 1]
    off: Array = np.abs(differences - np.median(differences))
    sigma = GAUSS * float(np.median(off))
    if sigma <= 0.0:
        # More than half of the differences are equal: it shows their resolution, not their spread.
        sigma = float(np.sqrt(np.mean(off**2)))
    return off > JUMP * max(sigma, 1e-12)


def fit(y: Array, t: Array, jumps: Flags | None = None) -> Degradation:
    """Maximum-likelihood estimate from readings y (K,) at times t (K,) s, ascending, from 0 on.

    jumps (K - 1,): increments to leave out, default `jump_points`. Raises ValueError for fewer
    than 5 increments.
    """
    from scipy.optimize import minimize

    tau, dy = np.diff(t), np.diff(y)
    cut = jump_points(y) if jumps is None else jumps
    if np.count_nonzero(~cut) < 5:
        raise ValueError("too few increments without jumps")
    scale = max(float(np.std(dy[~cut])), 1e-9)
    unit = float(np.median(tau))

    def value(v: Array) -> float:
        return -_likelihood(dy, tau, cut, scale * np.exp(v) / (unit**0.5, 1.0))[0]

    begin = [-0.7, -0.7]
    found = minimize(value, begin, method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-4})
    sigma, r = scale * np.exp(found.x) / (unit**0.5, 1.0)
    _, drift, error = _likelihood(dy, tau, cut, (sigma, r))
    return Degradation(drift, error, float(sigma), float(r), dy[cut] - drift * tau[cut])


def _likelihood(
    dy: Array, tau: Array, cut: Flags, spread: tuple[float, float] | Array
) -> tuple[float, float, float]:
    """Log likelihood, drift and its standard error, for (sigma, r); tridiagonal throughout."""
    from scipy.linalg import cholesky_banded, solve_banded

    sigma, r = float(spread[0]), float(spread[1])
    # The increment of a jump without the jump is unknown: practically infinite variance.
    big = 1e8 * float(np.max(dy * dy) + sigma**2 * tau.max() + r**2)
    diagonal = sigma**2 * tau + 2.0 * r**2 + np.where(cut, big, 0.0) + 1e-12
    off = np.full(len(dy), -(r**2))
    band = np.stack([off, diagonal])
    band[0, 0] = 0.0
    lower = cholesky_banded(band)
    log_det = 2.0 * float(np.sum(np.log(lower[1][~cut])))
    full = np.stack([off, diagonal, off])
    solved = solve_banded((1, 1), full, np.stack([dy, tau], axis=1))
    mm, md = float(tau @ solved[:, 1]), float(tau @ solved[:, 0])
    drift = md / mm
    rest = dy - drift * tau
    square = float(rest @ (solved[:, 0] - drift * solved[:, 1]))
    return -0.5 * (square + log_det), drift, float(mm**-0.5)
