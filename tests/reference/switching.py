"""The model with a memory in NumPy, which `switching*.c` are compared with.

Equations (S1) to (S21) of `docs/switching.md`. A hypothesis is a demand with its slope, mean (2,)
and covariance (2, 2), and arrays over N drives; ratios are (N, 2) with (N, 2, 2), one each for a
drive that adheres and for one that does not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEP_S: Final = 0.01
KEPT: Final = 6
A, L, X = range(3)
MOVE: Final = 0.04
"""Standard deviation of a wobble or a turn, and the probability of either."""
MOST: Final = 0.9
"""Share that a lost drive carries at most."""
RATIO: Final = np.diag([0.065**2, 0.02**2])
EYE: Final = np.ones(2)


@dataclass
class Hypothesis:
    """log_weight; x (2,), P (2, 2): demand and slope; p (N, 3): states; fresh (N, 2): of the
    lost, of the others; c, v_c (N,).

    rho (2, N, 2), V (2, N, 2, 2): ratios (r, u) of a drive that adheres, and of one that does not;
    site (N, 2): precision and shift that each load has given to the demand.
    """

    log_weight: float
    x: Array
    P: Array
    p: Array
    fresh: Array
    c: Array
    v_c: Array
    rho: Array
    V: Array
    site: Array


def unknown(n: int) -> Hypothesis:
    """Before anything is known."""
    return Hypothesis(
        0.0, np.zeros(2), np.diag([1.0, 1e-4]), np.tile([0.97, 0.03, 1e-6], (n, 1)),
        np.zeros((n, 2)), np.full(n, MOST / 2), np.full(n, MOST**2 / 12),
        np.tile([1.0, 0.0], (2, n, 1)), np.tile(RATIO, (2, n, 1, 1)), np.zeros((n, 2)),
    )  # fmt: skip


def moments(weight: Array, mean: Array, spread: Array) -> tuple[Array, Array]:
    """Of a mixture: weight (K, ...), mean (K, ..., D), spread (K, ..., D, D)."""
    total = weight.sum(axis=0)
    share = np.divide(weight, total, out=np.zeros_like(weight), where=total > 1e-300)
    share[0] = np.where(total > 1e-300, share[0], 1.0)
    m = (share[..., None] * mean).sum(axis=0)
    off = mean - m
    v = spread + off[..., :, None] * off[..., None, :]
    return m, (share[..., None, None] * v).sum(axis=0)


def predict(h: Hypothesis, begin: float) -> Hypothesis:
    """(S2) to (S4)."""
    a, lost, x = h.p.T
    keeps, stays = a * (1 - begin - 1e-8), lost * (1 - 0.04 - 1e-8)
    begins = a * begin + 0.3 * 0.01 * x
    other = x * (1 - 0.01) + 1e-8 * lost
    grips = lost * 0.04 + 0.01 * x
    now = moments(np.stack([keeps, grips]), h.rho, h.V)
    gone = moments(np.stack([stays + other, a * (begin + 1e-8)]), h.rho[::-1], h.V[::-1])
    fade = np.array([1.0, 1.0 - STEP_S / 3.0])
    rho = np.stack([now[0], gone[0]]) * fade
    V = np.stack([now[1], gone[1]]) * np.outer(fade, fade)
    V[..., 1, 1] += 0.02**2 * (1 - fade[1] ** 2)
    l_now = stays + begins
    p = np.stack([keeps + lost * 0.04 + 0.7 * 0.01 * x, l_now, other + 1e-8 * a], axis=1)
    x_now = p[:, X]
    new = np.stack([begins + 0.02 * stays, 1e-8 * (a + lost) + 0.02 * (1 - 0.01) * x], axis=1)
    of = np.stack([l_now, x_now], axis=1)
    fresh = np.where(of > 1e-300, new / np.where(of > 1e-300, of, 1), 1.0)
    return replace(h, p=p, fresh=fresh, v_c=np.minimum(h.v_c + 0.015**2, 0.1), rho=rho, V=V)


def normal(e: Any, v: Any) -> Any:
    return np.exp(-0.5 * e * e / v) / np.sqrt(2 * np.pi * v)


def logistic(x: float) -> float:
    return float(1 / (1 + np.exp(np.clip(-1.702 * x, -700, 700))))


def explain(h: Hypothesis, i: int, y: float, noise: float, m: float, v: float) -> Array:
    """(S5) to (S8): joint densities of adhering, outlier, held, fresh, steady, neither."""
    rho, own = h.rho[0, i].sum(), max(h.V[0, i].sum(), 0.0)
    v_a = rho**2 * v + own * m * m + noise
    v_l = h.c[i] ** 2 * v + h.v_c[i] * m * m + noise
    most = MOST * h.rho[1, i].sum()
    low, high, sd = most * min(m, -0.01), most * max(m, 0.01), np.sqrt(noise + most**2 * v / 3)
    anything = (logistic((y - low) / sd) - logistic((y - high) / sd)) / (high - low)
    a, lost, x = h.p[i]
    held = normal(y - h.c[i] * m, v_l)
    sd_c = np.sqrt(h.v_c[i])
    less = logistic((most - h.c[i]) / sd_c) * logistic((h.c[i] + 0.1) / sd_c)
    return np.array([
        a * (1 - 0.002) * normal(y - rho * m, v_a),
        a * 0.002 * normal(y - rho * m, v_a + 24 * noise),
        lost * (1 - h.fresh[i, 0]) * held * less,
        lost * h.fresh[i, 0] * anything if lost > 1e-14 else 0.0,
        x * (1 - h.fresh[i, 1]) * held * (1 - less),
        x * h.fresh[i, 1] / 3,
    ])  # fmt: skip


def absorb(
    h: Hypothesis, i: int, y: float, noise: float, m: float, v: float, share: Array
) -> tuple[float, float]:
    """The demand with a load, moments of the mixture over its origins."""
    rho, own = h.rho[0, i].sum(), max(h.V[0, i].sum(), 0.0) * m * m
    slope = np.array([rho, rho, h.c[i], 0.0, h.c[i], 0.0])
    held = h.v_c[i] * m * m + noise
    error = np.array([own + noise, own + 25 * noise, held, 1.0, held, 1.0])
    k = v * slope / (slope**2 * v + error)
    mean, spread = m + k * (y - slope * m), v * (1 - k * slope)
    out = float(share @ mean)
    return out, max(float(share @ (spread + (mean - out) ** 2)), 1e-8)


def update(
    h: Hypothesis, i: int, y: float, noise: float, m: float, v: float, z: Array, teaches: bool
) -> None:
    """(S9) to (S11), in place."""
    share = z / max(z.sum(), 1e-300)
    lost = share[2] + share[3]
    most, gone = MOST * h.rho[1, i].sum(), share[2:].sum()
    if gone > 1e-12 and abs(m) >= 0.02:
        k = h.v_c[i] * m / (h.v_c[i] * m * m + h.c[i] ** 2 * v + noise)
        new = np.clip(y / m, -5, 5)
        held, v_new = h.c[i] + k * (y - h.c[i] * m), min((noise + new**2 * v) / m**2, 0.1)
        mean = np.array([held, np.clip(new, 0, most), held, new])
        spread = np.array([(1 - k * m) * h.v_c[i], v_new, (1 - k * m) * h.v_c[i], v_new])
        w = share[2:] / gone
        c = w @ mean
        h.v_c[i] = np.clip(w @ (spread + (mean - c) ** 2), 1e-6, 0.1)
        h.c[i] = c
    if teaches and abs(m) >= 0.05 and v < 0.01:
        rho, V = h.rho[0, i], h.V[0, i]
        own, other = max(V.sum(), 0.0) * m * m, rho.sum() ** 2 * v + noise
        gain = V @ EYE * m / (own + 3 * other)
        limit = 3 * np.sqrt(own + other)
        error = np.clip(y - rho.sum() * m, -limit, limit)
        h.V[0, i] = V - np.outer(gain, V @ EYE * m)
        h.V[0, i][[0, 1], [0, 1]] = np.maximum(h.V[0, i][[0, 1], [0, 1]], [1e-6, 1e-7])
        h.rho[0, i] = np.clip(rho + gain * error, [0.7, -0.05], [1.3, 0.05])
    h.p[i] = share[0] + share[1], lost, max(share[4] + share[5], 1e-9)


class Switching:
    """N drives; one `step` after the other. adhering, lost (N,): what it finds; demand."""

    def __init__(self, n: int) -> None:
        self.n = n
        self.all = [unknown(n)]
        self.variance, self.lag = np.full(n, 0.02**2), np.zeros(n)
        self.learnt_s, self.lasting = np.zeros(n), np.zeros(n)
        self.scatter: Array = np.full(n, 0.005)
        self.source = np.zeros(n, int)
        self.past: list[list[float]] = [[] for _ in range(n)]
        self.demand = 0.0
        self.contradicted = 0

    def step(
        self, load: Array, known: Array, apart: Array, unsure: Array, gain: Array, error: Array,
        sigma: Array, source: Array, answers: Array,
    ) -> None:  # fmt: skip
        """load, gain, error, sigma (N,) per unit; known, apart, unsure, answers (N,) bool; source
        (N,).
        """
        self.y, self.known = load, known
        self.leads, self.teaches = known & ~apart, known & ~unsure
        self.plain, self.scale = self.leads & self.teaches & (error == 0), (1 + gain) ** 2
        self.error = error
        self._sources(source, sigma)
        self.noise = self._noise()
        before = self.demand
        best = self.all[0].log_weight
        trials: list[Hypothesis] = []
        for h in self.all:
            trials += self._propose(h, best, trials)
        self._reduce(trials)
        weight = np.exp([h.log_weight for h in self.all])
        self.demand = float(sum(w * h.x[0] for w, h in zip(weight, self.all, strict=True)))
        p = sum(w * h.p for w, h in zip(weight, self.all, strict=True))
        self.adhering, self.lost = p[:, A], p[:, L]
        if known.sum() > 1:
            self._learn()
        wrong = known & ((p[:, X] > 0.5) | (answers & (p[:, L] >= 0.5)))
        most = 2 * np.sum(wrong) > known.sum()
        self.contradicted = self.contradicted + 1 if most else 0
        if self.contradicted == 50:
            self.all, self.contradicted = [unknown(self.n)], 0
        self.lag = np.maximum(0.4 * self.lag, 0.15 * abs(self.demand - before))

    def _propose(self, h: Hypothesis, best: float, trials: list[Hypothesis]) -> list[Hypothesis]:
        """(S1), (S16), (S17): all that a hypothesis may become."""
        F = np.array([[1.0, 1.0], [0.0, 0.9]])
        P = F @ h.P @ F.T + 0.003**2 * np.eye(2)
        P[1, 1] = min(P[1, 1], 0.01)
        if P[0, 0] >= 1.0:
            P = np.diag([1.0, P[1, 1]])
        x = np.array([np.clip(h.x.sum(), -4, 4), 0.9 * h.x[1]])
        often = min(abs(x[0]) / 0.25, 1.0) ** 3
        calm, onsets = 1 - 2e-4 - 0.02 - 2 * MOVE, max(2e-4 * often, 1e-12)
        turn = MOVE**2 * np.array([[1.0, 0.5], [0.5, 0.5]])
        wobble = MOVE**2 * np.diag([1.0, 0.0])
        out = []
        for p, more, begin in (
            (calm, 0.0, 1e-5 * often), (onsets, 0.0, 0.3), (MOVE, wobble, 1e-5 * often),
            (MOVE, turn, 1e-5 * often),
        ):  # fmt: skip
            one = replace(predict(h, begin), x=x.copy(), P=P + more)
            one.log_weight += float(np.log(p))
            if one.log_weight >= best - 16:
                out.append(self._weigh(one, -1))
        likeliest = max([t.log_weight for t in trials + out], default=-np.inf)
        ahead = np.where(self.leads, self.y / h.rho[0].sum(axis=1), 0.0)
        for sign in (-1.0, 1.0):
            ranked = [j for j in np.argsort(-sign * ahead, kind="stable") if sign * ahead[j] > 0]
            for j in ranked[:2]:
                if P[0, 0] < 0.01 and (ahead[j] - x[0]) ** 2 < 4 * (P[0, 0] + MOVE**2):
                    continue
                p = max(h.p[j, A] + 0.01 * h.p[j, L], 1e-12) * 0.02 / 3 / h.rho[0, j].sum()
                one = replace(predict(h, 1e-5 * often), x=x.copy(), P=P)
                one.log_weight += float(np.log(p))
                if one.log_weight >= likeliest - 30:
                    out.append(self._jump(one, j))
                    likeliest = max(likeliest, out[-1].log_weight)
        return out

    def _jump(self, h: Hypothesis, j: int) -> Hypothesis:
        ahead = np.where(self.leads, self.y / h.rho[0].sum(axis=1), 0.0)
        x = ahead[j]
        more = (ahead * x > 0) & (np.abs(ahead) > abs(x))
        more[j] = False
        h.p[more, X] += h.p[more, A] * 1e-9
        h.p[more, :X] = 0.0
        h.p[j] = 1 - 1e-9, 0.0, 1e-9
        rho, own = h.rho[0, j].sum(), max(h.V[0, j].sum(), 0.0)
        far = np.clip(x - h.x[0], -1, 1)
        h.x = np.array([x, 0.5 * far])
        h.P = np.diag([(self.noise[j] + own * x * x) / rho**2, 1e-4 + (0.5 * far) ** 2])
        return self._weigh(h, j)

    def _weigh(self, h: Hypothesis, anchor: int) -> Hypothesis:
        """(S13) to (S15)."""
        h.c, h.v_c, h.site = h.c.copy(), h.v_c.copy(), np.zeros((self.n, 2))
        m, v = h.x[0], h.P[0, 0]
        for sweep in range(2):
            for i in np.flatnonzero(self.known):
                if i == anchor or (sweep == 0 and not self.leads[i]):
                    continue
                left = max(1 / v - h.site[i, 0], 0.1)
                m_i, v_i = ((m / v - h.site[i, 1]) / left, 1 / left) if sweep else (m, v)
                z = explain(h, i, self.y[i], self.noise[i], m_i, v_i)
                if not sweep:
                    h.log_weight += float(np.log(max(z.sum(), 1e-300)))
                if self.leads[i]:
                    share = z / max(z.sum(), 1e-300)
                    with_m, with_v = absorb(h, i, self.y[i], self.noise[i], m_i, v_i, share)
                    told = max(1 / with_v - 1 / v_i, 0.0)
                    h.site[i] = told, with_m / with_v - m_i / v_i if told > 0 else 0.0
                    v = 1 / (1 / v_i + told)
                    m = (m_i / v_i + h.site[i, 1]) * v
                if sweep:
                    update(h, i, self.y[i], self.noise[i], m_i, v_i, z, bool(self.teaches[i]))
        k = h.P[0, 1] / h.P[0, 0]
        slope = max(h.P[1, 1] - k * k * (h.P[0, 0] - v), 1e-9)
        h.x = np.array([m, h.x[1] + k * (m - h.x[0])])
        h.P = np.array([[v, k * v], [k * v, slope]])
        if anchor >= 0:
            h.site[anchor] = 0.0
        return h

    def _reduce(self, trials: list[Hypothesis]) -> None:
        """(S18), (S19)."""
        trials = sorted(trials, key=lambda h: -h.log_weight)
        best = trials[0].log_weight
        self.all = []
        for h in trials:
            if h.log_weight < best - 20:
                break
            same = [k for k, one in enumerate(self.all) if self._alike(one, h)]
            if same:
                self.all[same[0]] = self._merged(self.all[same[0]], h)
            elif len(self.all) < KEPT:
                self.all.append(h)
        total = np.logaddexp.reduce([h.log_weight for h in self.all])
        for h in self.all:
            h.log_weight -= float(total)

    @staticmethod
    def _alike(a: Hypothesis, b: Hypothesis) -> bool:
        near = (a.x[0] - b.x[0]) ** 2 <= 0.5 * (a.P[0, 0] + b.P[0, 0])
        return bool(near and (np.abs(a.p[:, A] - b.p[:, A]) < 0.2).all())

    @staticmethod
    def _merged(a: Hypothesis, b: Hypothesis) -> Hypothesis:
        w = 1 / (1 + np.exp(b.log_weight - a.log_weight))
        both = np.array([w, 1 - w])
        x, P = moments(both, np.stack([a.x, b.x]), np.stack([a.P, b.P]))
        p = w * a.p + (1 - w) * b.p
        gone = both[:, None] * (1 - np.stack([a.p[:, A], b.p[:, A]]))
        c, v_c = moments(
            gone, np.stack([a.c, b.c])[..., None], np.stack([a.v_c, b.v_c])[..., None, None]
        )
        seen = gone.sum(axis=0) > 1e-300
        ratios = []
        for k in range(2):
            part = np.stack([a.p[:, A], b.p[:, A]])
            weight = both[:, None] * (part if k == 0 else 1 - part)
            ratios.append(
                moments(weight, np.stack([a.rho[k], b.rho[k]]), np.stack([a.V[k], b.V[k]]))
            )
        return replace(
            a, log_weight=float(np.logaddexp(a.log_weight, b.log_weight)), x=x, P=P, p=p,
            c=np.where(seen, c[:, 0], a.c), v_c=np.where(seen, v_c[:, 0, 0], a.v_c),
            rho=np.stack([r[0] for r in ratios]), V=np.stack([r[1] for r in ratios]),
        )  # fmt: skip

    def _sources(self, source: Array, sigma: Array) -> None:
        """(S24)."""
        other = self.known & (source != self.source)
        self.source = np.where(other, source, self.source)
        self.learnt_s[other] = self.lasting[other] = 0.0
        for i in np.flatnonzero(other):
            self.past[i].clear()
        wider = np.clip(sigma**2, self.variance, 0.2**2)
        self.variance = np.where(self.known & (self.learnt_s == 0.0), wider, self.variance)

    def _noise(self) -> Array:
        """Variances of the errors (N,)."""
        return self._with(np.maximum(self.variance, (1.05 * self.scatter) ** 2))

    def _with(self, variance: Array) -> Array:
        return variance * self.scale + self.lag**2 + self.error**2

    def _scatter(self, i: int, error: float) -> None:
        """(S22), (S23)."""
        past = self.past[i]
        if len(past) == 10:
            step = 0.04 if abs(error - past.pop(0)) > self.scatter[i] else -0.02
            self.scatter[i] = np.clip(self.scatter[i] * (1 + step), 0.005, 0.15)
        past.append(error)

    def _learn(self) -> None:
        """(S12), (S20), (S22), (S23)."""
        h = self.all[0]
        for i in range(self.n):
            left = 1 / h.P[0, 0] - h.site[i, 0]
            if not (self.plain[i] and left > 100):
                self.past[i].clear()
                continue
            m = (h.x[0] / h.P[0, 0] - h.site[i, 1]) / left
            rho = h.rho[0, i].sum()
            error = self.y[i] - rho * m
            self._scatter(i, error)
            if not (self.adhering[i] >= 0.5 and abs(m) >= 0.05):
                continue
            noise = self._with(self.variance)[i]
            v = max(h.V[0, i].sum(), 0.0) * m * m + rho**2 / left + noise
            z = np.clip(error / math.sqrt(v), -3.0, 3.0)
            self.lasting[i] += STEP_S / 1.0 * (z - self.lasting[i]) * self.adhering[i]
            z2 = min((z - self.lasting[i]) ** 2, 9.0)
            self.learnt_s[i] += STEP_S
            tau = np.clip(self.learnt_s[i], 0.1, 1.0)
            own = self.variance[i] * self.scale[i]
            grow = 2 * STEP_S / tau * own / v * (z2 - 1) * self.adhering[i]
            self.variance[i] = np.clip(self.variance[i] * (1 + grow), 0.012**2, 0.2**2)
        for h in self.all:
            mean = h.rho[0, :, 0].mean()
            h.rho[..., 0] = np.clip(h.rho[..., 0] / mean, 0.7, 1.3)
            h.x = h.x * [mean, 1.0]
