"""Wheel-rail contact: Polach's creep force curve for dry, wet and leaf-covered rail.

May know: mechanics. May not know: bits, buses, clocks.

Source: O. Polach, "Creep forces in simulations of traction vehicles running on adhesion
limit", Wear 258 (2005); longitudinal creep only:

    mu    = mu_0 ((1 - A) exp(-B |w|) + A)                   w sliding speed, m/s
    eps   = k_c |s| / mu                                     s creep, k_c = G pi a b c_11 / (4 Q)
    F / Q = (2 mu / pi) (k_A eps / (1 + (k_A eps)^2) + atan(k_S eps))

`k_A` and `k_S` reduce the slope in the area of adhesion and of slip. The values for dry and wet
rail are the paper's; those for leaves are ours (peak near 0.06).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

SPEED_FLOOR_M_S: Final = 0.5
"""Creep is sliding speed over train speed; the floor keeps it finite at standstill."""


class Rail(NamedTuple):
    """One rail condition.

    `mu_0` friction at standstill, `A` ratio at infinite sliding speed, `B` decay in s/m,
    `k_A`, `k_S` reduction factors, `k_c` contact stiffness per wheel load.
    """

    mu_0: float
    A: float
    B: float
    k_A: float
    k_S: float
    k_c: float = 80.0


RAILS: Final[dict[str, Rail]] = {
    "dry": Rail(0.55, 0.40, 0.60, 1.00, 0.40),
    "wet": Rail(0.30, 0.40, 0.20, 0.30, 0.10),
    "leaves": Rail(0.08, 0.50, 0.40, 0.30, 0.15),
}


_SHARES: Final = np.linspace(0.0, 1.0, 65)


def rail(condition: str | float) -> Rail:
    """The named condition; for a number the dry curve's shape (wet up to 0.3) with this `mu_0`.

    Raises ValueError for an unknown name or a friction outside (0, 1].
    """
    if isinstance(condition, str):
        if condition not in RAILS:
            msg = f"unknown rail condition {condition!r}: one of {', '.join(RAILS)} or a number"
            raise ValueError(msg)
        return RAILS[condition]
    if not 0.0 < condition <= 1.0:
        msg = f"friction {condition} is outside (0, 1]"
        raise ValueError(msg)
    shape = RAILS["dry"] if condition > RAILS["wet"].mu_0 else RAILS["wet"]
    return shape._replace(mu_0=float(condition))


def traction_coefficient(
    curve: Rail, creep: NDArray[np.float64], v_m_s: float
) -> NDArray[np.float64]:
    """F / Q at `creep` (any shape, dimensionless) and vehicle speed `v_m_s`; odd in creep."""
    s = np.abs(creep)
    w = s * max(abs(v_m_s), SPEED_FLOOR_M_S)
    mu = curve.mu_0 * ((1.0 - curve.A) * np.exp(-curve.B * w) + curve.A)
    eps = curve.k_c * s / mu
    x = curve.k_A * eps
    ratio = (2.0 / np.pi) * mu * (x / (1.0 + x * x) + np.arctan(curve.k_S * eps))
    out: NDArray[np.float64] = np.sign(creep) * ratio
    return out


@lru_cache(maxsize=64)  # the drives of a train ask alike
def available(curve: Rail, v_m_s: float, creep_limit: float) -> float:
    """Largest F / Q the rail offers up to `creep_limit`: what a drive with a slip limit can use."""
    return float(traction_coefficient(curve, creep_limit * _SHARES, v_m_s).max())


@lru_cache(maxsize=64)
def peak_creep(curve: Rail, v_m_s: float) -> float:
    """Creep of the largest F / Q below 0.5: beyond it the wheel runs away."""
    creep = np.linspace(0.0, 0.5, 501)
    return float(creep[traction_coefficient(curve, creep, v_m_s).argmax()])
