"""Degradation as a jump diffusion: paper `thermal`, eq. (22)-(27).

    X(t) = X(0) + mu t + sigma B(t) + Z(t),   y = X + reading noise r

Z is compound Poisson. Jumps are found first, by the undecimated Haar transform (a decimated one
sees only every other difference), or causally from differences. Drift, diffusion and r follow by
maximum likelihood from the increments dy without the jumps,

    dy ~ N(mu tau, C),   C = sigma^2 diag(tau) + r^2 tridiag(-1, 2, -1),
    mu = m'C^-1 dy / m'C^-1 m,   m = tau;

(27) as printed is no estimate, and without r the diffusion is that of the readings' noise. A drift
that is a power of time, mu t^b, or an exponential, mu (e^(bt) - 1) / b (Remark 3), by Nelder-Mead.
"""

from __future__ import annotations

from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

GAUSS: Final = 1.4826
"""Standard deviation over median absolute deviation."""
MOST_GROWTH: Final = 30.0
"""Times e over the readings: more is a jump at their end."""
JUMP: Final = 5.0
"""A difference of more standard deviations is a jump."""


Form = Literal["linear", "power", "exponential"]


class Course(NamedTuple):
    """How a drift of 1 goes over time: t, t^b, or (e^(bt) - 1) / b with b per s."""

    form: Form = "linear"
    b: float = 1.0

    def at(self, t: Array) -> Array:
        """(K,) at t (K,) s, from 0 on."""
        if self.form == "power":
            return np.asarray(t**self.b)
        if self.form == "exponential" and self.b != 0.0:
            return np.asarray(np.expm1(self.b * t) / self.b)
        return t


class Degradation(NamedTuple):
    """What was found.

    drift: what `course` is multiplied by, per s where that is linear, and its standard error;
    diffusion per sqrt(s); noise of a reading; jumps (k,): their sizes; jump_rate per s; loglik:
    logarithm of the likelihood.
    """

    drift: float
    drift_sigma: float
    diffusion: float
    noise: float
    course: Course
    jumps: Array
    jump_rate: float
    loglik: float

    def ahead(self, now: float, seconds: float) -> tuple[float, float]:
        """Mean and standard deviation of the change `seconds` after `now` s."""
        mean = self.drift * float(np.diff(self.course.at(np.array([now, now + seconds])))[0])
        mean += self.jump_rate * seconds * (float(self.jumps.mean()) if len(self.jumps) else 0.0)
        square = self.diffusion**2 * seconds + (self.drift_sigma * seconds) ** 2
        square += self.jump_rate * seconds * float(np.sum(self.jumps**2)) / max(len(self.jumps), 1)
        return mean, float(np.sqrt(square))


def jump_points(y: Array, threshold: float = JUMP) -> Flags:
    """(K - 1,) differences of y (K,) that are jumps, by the undecimated Haar transform's details.

    The first level of it is every difference over sqrt(2), circularly; looks ahead by one sample.
    """
    import pywt

    padded = np.concatenate([y, y[-1:]] if len(y) % 2 else [y])
    detail = np.asarray(pywt.swt(padded, "haar", level=1, trim_approx=True)[1])
    # Haar's detail k holds y_k - y_(k+1); the last one wraps around.
    differences = -np.sqrt(2.0) * detail[: len(y) - 1]
    return outliers(differences, threshold)


def outliers(differences: Array, threshold: float = JUMP) -> Flags:
    """Which of the differences are jumps: beyond `threshold` robust standard deviations."""
    off = np.abs(differences - np.median(differences))
    sigma = GAUSS * float(np.median(off))
    if sigma <= 0.0:
        # More than half of the readings are the same: the resolution, not the spread.
        sigma = float(np.sqrt(np.mean(off**2)))
    return off > threshold * max(sigma, 1e-12)


def fit(y: Array, t: Array, jumps: Flags | None = None, *, form: Form = "linear") -> Degradation:
    """Maximum likelihood from readings y (K,) at times t (K,) s, ascending, from 0 on.

    jumps (K - 1,): increments to leave out, default `jump_points`; form: of the drift, whose b is
    found as well. Raises ValueError with fewer than 5 increments.
    """
    from scipy.optimize import minimize

    tau, dy = np.diff(t), np.diff(y)
    cut = jump_points(y) if jumps is None else jumps
    if np.count_nonzero(~cut) < 5:
        raise ValueError("too few increments without jumps")
    scale = max(float(np.std(dy[~cut])), 1e-9)
    unit = float(np.median(tau))

    def value(v: Array) -> float:
        shape = np.diff(_course(form, v, t).at(t))
        parts = _likelihood(dy, tau, shape, cut, scale * np.exp(v[:2]) / (unit**0.5, 1.0))
        return -parts[0]

    begins = [[-0.7, -0.7]] if form == "linear" else [[-0.7, -0.7, 0.0], [-4.0, -0.7, 0.0]]
    tried = [
        minimize(value, b, method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-4})
        for b in begins
    ]
    found = min(tried, key=lambda one: float(one.fun))
    sigma, r = scale * np.exp(found.x[:2]) / (unit**0.5, 1.0)
    course = _course(form, found.x, t)
    shape = np.diff(course.at(t))
    loglik, drift, error = _likelihood(dy, tau, shape, cut, (sigma, r))
    sizes = dy[cut] - drift * shape[cut]
    rate = len(sizes) / float(tau.sum())
    return Degradation(drift, error, float(sigma), float(r), course, sizes, rate, loglik)


def _course(form: Form, v: Array, t: Array) -> Course:
    """v[2]: logarithm of a power; how often an exponential grows by e over the readings."""
    if form == "power":
        return Course(form, float(np.exp(v[2])))
    if form == "exponential":
        return Course(form, float(np.clip(v[2], -MOST_GROWTH, MOST_GROWTH)) / float(t[-1]))
    return Course()


def _likelihood(
    dy: Array, tau: Array, m: Array, cut: Flags, spread: tuple[float, float] | Array
) -> tuple[float, float, float]:
    """Log likelihood, drift and its standard error, for (sigma, r); tridiagonal throughout."""
    from scipy.linalg import cholesky_banded, solve_banded

    sigma, r = float(spread[0]), float(spread[1])
    # A jump's increment is known to nobody: as good as infinite variance.
    big = 1e8 * float(np.max(dy * dy) + sigma**2 * tau.max() + r**2)
    diagonal = sigma**2 * tau + 2.0 * r**2 + np.where(cut, big, 0.0) + 1e-12
    off = np.full(len(dy), -(r**2))
    band = np.stack([off, diagonal])
    band[0, 0] = 0.0
    lower = cholesky_banded(band)
    log_det = 2.0 * float(np.sum(np.log(lower[1][~cut])))
    full = np.stack([off, diagonal, off])
    solved = solve_banded((1, 1), full, np.stack([dy, m], axis=1))
    mm, md = float(m @ solved[:, 1]), float(m @ solved[:, 0])
    drift = md / mm
    rest = dy - drift * m
    square = float(rest @ (solved[:, 0] - drift * solved[:, 1]))
    return -0.5 * (square + log_det), drift, float(mm**-0.5)
