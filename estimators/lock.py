"""Is the filter locked to the rotor? An answer that does not trust the filter: flux chords.

In the stationary frame (complex alpha + j beta), over any interval with known volt-seconds,
    c_k = integral(u - R_s i) dt - L_s (i_k - i_(k-1)) = psi_f (e^(j theta_k) - e^(j theta_(k-1))),
the chord that the magnet flux has moved along (`adhesion` eq. (11), integrated). Hence
    |c_k| = 2 psi_f |sin(w dt / 2)|,  arg c_k = theta_mid + sign(w) pi / 2,
    arg(c_k conj(c_(k-1))) = w dt,
so speed, its sign and the angle follow from two chords, from any start, with nothing to
converge and no wrong answer that is stable. A filter started on a wrong angle can stay wrong
(speed and load of the wrong sign), with a NIS that depends on speed: no threshold on it works.

Chords of up to 2 ms; pairs of consecutive complete chords feed exponentially forgotten means:
S1 = <c_k conj(c_(k-1))>, S0 = <|c|^2>, S2 = <S1>. arg S1 lags an acceleration by the memory,
and arg(S1 conj S2) measures that lag (double smoothing), so w follows a ramp without error.

Where samples come faster, chords are as long as the speed allows: they begin with one sample and
are doubled while their length, which no alias can shorten there, leaves room, and halved above
`turn_long`. Speeds of 5000 rad/s are then as good as 50.

Limits. Below `w_off` the chord drowns in errors of R_s and voltage (20 % of R_s at 25 A looks
like 7 rad/s on the bench motor): not observable, said so. Above ten sub-steps of the filter per
revolution (`step_turn_max`) its Euler step is too coarse. Turns above pi per sample alias: with
2 ms a speed of 1571 rad/s and more reads as one of the other sign, and the length of the chord
cannot tell, |sin| being the same. The caller must know that |w| dt < pi, as for any bus slower
than two samples per revolution; `turn_max` keeps a margin.
"""

# ruff: noqa: F722, F821, UP037 - shape strings of jaxtyping
from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.models import pmsm
from estimators.models.pmsm import T_L, THETA_E, W_E, Noise, Pmsm, Rated

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]


class LockTuning(NamedTuple):
    """When the chords are believed. Speeds are electrical, rad/s."""

    chord_steps: int = 16
    """Most sub-steps per chord: 2 ms. A sample that spans more is a chord by itself."""
    turn_long: float = 1.5
    """A chord that turns more, rad, is halved if it has more than one sample."""
    turn_short: float = 0.9
    """A chord whose length allows no more than this turn is doubled."""
    settle: int = 4
    """Pairs of a new length before it is judged."""
    forget: float = 0.92
    """Of S1, S2 and S0, per chord: memory of about 12 chords."""
    forget_angle: float = 0.5
    """Of the rotated mean of chords, per chord."""
    chords: int = 20
    """Consecutive plausible pairs before `ready`: 40 ms."""
    w_on: float = 20.0
    w_off: float = 15.0
    """Ready from w_on upwards, until below w_off: R_s 20 % off at rated current is 7 rad/s."""
    coherence: float = 0.9
    """Smallest |S1| / S0; 0.99 at 20 rad/s with noise of 1e-2 A^2, about 0.5 for noise alone."""
    length_tol: float = 0.35
    """Relative difference of |c| from psi_f |turn|: R_s 20 % off at 20 rad/s makes 0.28."""
    turn_max: float = 2.5
    """Largest turn per chord, rad: margin below the alias at pi."""
    step_turn_max: float = 0.63
    """Largest turn per sub-step, rad: ten a revolution, 5000 rad/s at 125 us. The load of the
    Euler model then reads 7 % high, 1 % at 3000 rad/s."""
    hold: float = 10.0
    """Longest chord durations without a new pair that end the lock; shorter holes only break a
    pair."""


class LockState(NamedTuple):
    """Memory of N drives, each entry (N,). Filled by `_lock_kernels.lock_sweep`.

    i_last, i_start: current at the last sample and at the start of the open chord, A.
    flux: volt-seconds less resistive drop of the open chord, Wb; steps: its sub-steps, -1 when
    there is no start point. chord: the last complete chord, Wb; pair: its sub-steps, 0 when the
    next one cannot be paired with it; stride: least sub-steps of the open chord. S1, S2, S0: means
    over pairs, Wb^2; mean: rotated sum of chords, Wb; span: chord duration, s; pairs: how many
    since the start; good: consecutive plausible ones. w, theta: speed and angle at the end of the
    last paired chord; age: time
    since then, s; spread: circular standard deviation of the turn, rad; w_max: largest |w|
    that the length of the chords allows; psi: the magnet flux that length and turn say, Wb
    (errors of R_s included; NaN before the first pair); ready: w and theta can be believed.
    """

    i_last: Complex
    i_start: Complex
    flux: Complex
    steps: Ints
    chord: Complex
    pair: Ints
    stride: Ints
    S1: Complex
    S2: Complex
    S0: Array
    mean: Complex
    span: Array
    pairs: Ints
    good: Ints
    w: Array
    theta: Array
    age: Array
    spread: Array
    w_max: Array
    psi: Array
    ready: Flags


class LockEstimate(NamedTuple):
    """What the chords say at the last sample: see `lock_estimate`."""

    ready: Bool[Flags, "N"]
    w: Float[Array, "N"]
    theta: Float[Array, "N"]
    spread: Float[Array, "N"]


class Agreement(IntEnum):
    """The chords' opinion of a filter."""

    UNKNOWN = 0
    AGREES = 1
    DISAGREES = 2


WILD: Final = 1e5
"""A current or voltage, A or V, that no motor has: no sample. Sums over a value of 1e80 would take
seconds to forget it, its square would be none."""
W_TOL = 20.0
"""rad/s. With noise of 1e-2 A^2 the chords' own speed is up to 17 off around 30 rad/s; the wrong
sign differs by 40 or more wherever the lock is ready."""
W_TOL_RELATIVE = 0.5
"""Of the chords' |w|: when an acceleration sets in at once, the means are late for some 20 ms,
30 rad/s at 2500 rad/s^2. The angle is the sharp test: it comes from the last two chords, and no
wrong speed keeps it right."""
THETA_TOL = 0.8
"""rad. A filter 0.8 rad off shows 30 % of torque too little; the wrong lock is 2.45 rad off,
parameter errors of 20 % make less than half of this."""
STILL_TOL = 40.0
"""rad/s above what the chords' length allows: a filter that runs away from a slow rotor."""


def start(n: int) -> LockState:
    """N drives of which nothing has been seen."""
    c = np.zeros((5, n), dtype=np.complex128)
    i = np.zeros((3, n), dtype=np.int64)
    f = np.zeros((6, n))
    return LockState(
        i_last=c[0].copy(),
        i_start=c[1].copy(),
        flux=c[2].copy(),
        steps=np.full(n, -1, dtype=np.int64),
        chord=c[3].copy(),
        pair=i[0].copy(),
        stride=np.ones(n, dtype=np.int64),
        S1=c[4].copy(),
        S2=np.zeros(n, dtype=np.complex128),
        S0=f[0].copy(),
        mean=np.zeros(n, dtype=np.complex128),
        span=f[1].copy(),
        pairs=i[1].copy(),
        good=i[2].copy(),
        w=f[2].copy(),
        theta=f[3].copy(),
        age=f[4].copy(),
        spread=np.full(n, np.inf),
        w_max=np.full(n, np.inf),
        psi=np.full(n, np.nan),
        ready=np.zeros(n, dtype=np.bool_),
    )


def forget(state: LockState, drive: int) -> None:
    """Start one drive anew, in place: after a long silence or a new motor."""
    for old, new in zip(state, start(1), strict=True):
        old[drive] = new[0]


def lock_estimate(state: LockState) -> LockEstimate:
    """Speed and angle at the last sample, from the last chord at constant speed.

    ready (N,) bool; w (N,) rad/s electrical; theta (N,) in (-pi, pi]; spread (N,) rad per
    chord. Where not ready the numbers are finite but mean nothing.
    """
    theta = pmsm.wrap(state.theta + state.w * state.age)
    return LockEstimate(state.ready.copy(), state.w.copy(), theta, state.spread.copy())


def agrees(
    state: LockState, x: Float[Array, "N 5"], tuning: LockTuning | None = None
) -> Int[NDArray[np.int64], "N"]:
    """`Agreement` of each drive's filter state x with the chords, both at the last sample.

    AGREES and DISAGREES compare speed and angle where the lock is ready. Where it is not,
    DISAGREES still if the filter's speed is far above what the chords' length allows (a
    rotor at rest cannot have moved the flux); else UNKNOWN. A state that is not finite
    disagrees. Call it when both have seen the same samples; silence is the caller's to notice.
    """
    tuning = tuning or LockTuning()
    w, theta = x[:, W_E], x[:, THETA_E]
    with np.errstate(invalid="ignore"):
        same_w = np.abs(w - state.w) <= W_TOL + W_TOL_RELATIVE * np.abs(state.w)
        theta_chord = lock_estimate(state).theta
        same_theta = np.abs(pmsm.wrap(theta - theta_chord)) <= THETA_TOL
        runaway = (state.pairs >= tuning.chords) & (np.abs(w) > state.w_max + STILL_TOL)
    verdict = np.where(same_w & same_theta, Agreement.AGREES, Agreement.DISAGREES)
    unready = np.where(runaway, Agreement.DISAGREES, Agreement.UNKNOWN)
    verdict = np.where(state.ready, verdict, unready)
    return np.where(np.isfinite(x).all(axis=1), verdict, Agreement.DISAGREES).astype(np.int64)


def start_state(
    state: LockState, par: Pmsm, noise: Noise, rated: Rated
) -> tuple[Float[Array, "N 5"], Float[Array, "N 5 5"]]:
    """First x and P of a filter from the chords; meaningful where `ready`.

    Currents from the last sample with variance R; w and theta from the chords with (3 spread
    per chord) and a tenth of the value, at least 5 rad/s and 0.1 rad; T_L from the
    electromagnetic torque (no acceleration assumed), with the rated torque as deviation.
    """
    ready, w, theta, spread = lock_estimate(state)
    x = np.zeros((len(w), 5))
    x[:, 0] = state.i_last.real
    x[:, 1] = state.i_last.imag
    x[:, W_E] = w
    x[:, THETA_E] = theta
    x[:, T_L] = pmsm.torque(par, x)
    spread = np.where(ready, spread, 1.0)
    span = np.where(ready, state.span, 1.0)
    deviation_w = 5.0 + 0.1 * np.abs(w) + 0.3 * spread / span
    deviation_theta = 0.1 + spread
    variance = np.stack(
        [noise.R[:, 0], noise.R[:, 1], deviation_w**2, deviation_theta**2, rated.T**2], axis=1
    )
    return x, variance[:, :, None] * np.eye(5)
