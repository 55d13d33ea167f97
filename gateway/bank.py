"""The bank of filters: samples in, per drive state, health and age out.

A drive is acquired by its flux chords, then filtered, and watched by the chords for as long
as it is tracked: the filter's own word is never the proof that it is locked. May know:
estimators. May not know: frames, clocks, flags.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import Final, NamedTuple

import numpy as np

from dbc.frame import MS, SECOND, Nanos
from estimators import adapt, lock, unbalance
from estimators._adapt_kernels import absorb
from estimators._lanes_kernels import ekf_lanes, ukf_lanes
from estimators._lock_kernels import agreement, lock_sweep
from estimators._unbalance_kernels import balance
from estimators.models import pmsm
from gateway._direct import Direct
from gateway.channel import SAMPLE_NS
from gateway.config import Estimator, Motor
from gateway.health import Health, Reason
from gateway.pairing import Samples

SETTLE_STEPS: Final = 480
"""Sub-steps (60 ms) a new filter runs before its load is believed."""
DISAGREE_TICKS: Final = 3
"""Ticks in a row that the chords must contradict the filter before it counts as diverged."""
LONGEST_COAST: Final = 64
"""Sub-steps (8 ms) without samples that a filter bridges: what the voltage did meanwhile may turn
the rotor by some tenths of a radian. After longer gaps the chords find speed and angle anew."""
LOOSE: Final = 2.0
"""A load is no evidence while its standard deviation is this many times its best."""
FORGET: Final = 1.01
"""Rise of that best per tick: sensors may become noisier for good."""
MOVING: Final = 0.07
"""Of the rated torque in a tick: more than the noise of a steady load."""
FLUX_TAU_S: Final = 0.5
FLUX_SURE: Final = 0.03
"""What the chords say of the flux is believed beyond this, and beyond what an R_s that is off by
`RESISTANCE_SURE` would make of it."""
RESISTANCE_SURE: Final = 0.25
DIVERGED_NS: Final = 100 * MS
"""A divergence is said for at least this long before the drive is acquired anew."""
TOLERANCES: Final = (lock.W_TOL, lock.W_TOL_RELATIVE, lock.THETA_TOL, lock.STILL_TOL)
UKF_KAPPA: Final = -2.0
"""n + kappa = 3: the sigma points match the kurtosis of a Gaussian."""
NIS_SMOOTHING: Final = 0.2


class DriveEstimate(NamedTuple):
    """One drive after a tick; numbers are None while nothing is tracked."""

    health: Health
    speed_rad_s: float | None = None
    load_nm: float | None = None
    load_sigma_nm: float | None = None
    nis: float | None = None
    reason: Reason = Reason.STARTING
    """Why, where it is not tracking."""


class _Track:
    """What the bank remembers of one drive beside the arrays."""

    __slots__ = ("best", "diverged_ns", "doubts", "flux", "load", "moved", "silent")

    def __init__(self) -> None:
        self.doubts = 0
        self.best = math.inf
        """Standard deviation of the load when it was known best of late, Nm."""
        self.diverged_ns: Nanos | None = None
        self.flux: float | None = None
        """Magnet flux over that of the data sheet; torque and load are larger by that."""
        self.silent = False
        """No samples in this tick."""
        self.load = 0.0
        self.moved = 0.0
        """Load after the last tick with samples, and how far it had moved in that, Nm."""


class Bank:
    """Filters of N drives. `advance` once per tick is the only mutator."""

    def __init__(
        self,
        motors: Sequence[Motor],
        config: Estimator,
        current_step_a: float,
        tick_ns: Nanos = 10 * MS,
    ) -> None:
        """current_step_a: resolution of the currents on the bus, part of R."""
        self.tick_s = tick_ns / SECOND
        rows = [(m.R_s, m.L_s, m.psi_pm, float(m.pole_pairs), m.J, m.B, m.k_p) for m in motors]
        self.par = pmsm.motors(*rows)
        self.rated = pmsm.Rated(
            np.array([m.I_rated for m in motors]), np.array([m.T_rated for m in motors])
        )
        self.noise = _noise(self.par, self.rated, config, current_step_a)
        self.table = pmsm.table(self.par)
        self.tuning = lock.LockTuning(
            w_on=config.min_speed_rad_s, w_off=0.75 * config.min_speed_rad_s
        )
        self.ukf = config.kind == "ukf"
        n = len(motors)
        self.x = np.zeros((n, 5))
        self.P = np.tile(np.eye(5), (n, 1, 1))
        self.chords = lock.start(n)
        self.sensors = unbalance.start(n)
        self.tracks = [_Track() for _ in range(n)]
        self.active = np.zeros(n, dtype=np.bool_)
        self.steps = np.zeros(n, dtype=np.int64)
        """Sub-steps since the filter's start; negative once it has become a number that is none."""
        self.nis = np.full(n, 2.0)
        """Smoothed."""
        self.scale = np.ones(n)
        """Variance of the currents over the configured one, as the innovations show it."""
        self.lean = np.zeros(n)
        """Voltage along q that the motor lacks against its data, V."""
        self._balance, self._lock_sweep = Direct(balance), Direct(lock_sweep)
        self._absorb = Direct(absorb)
        self.pole_pairs = self.par.p.tolist()
        self.sheet = list(zip(self.par.R_s.tolist(), self.par.psi_f.tolist(), strict=True))

    def advance(
        self,
        samples: Samples,
        restart: Collection[int],
        inputs: Sequence[Reason],
        fresh: Sequence[bool],
        now: Nanos,
    ) -> list[DriveEstimate]:
        """Filter this tick's samples and judge every drive.

        restart: drives whose samples begin anew; inputs: why a drive's input cannot be
        believed (NONE if it can); fresh: whether its newest sample is within its age limit.
        """
        for k in restart:
            self._drop(k)
            lock.forget(self.chords, k)
            unbalance.forget(self.sensors, k)
            self.tracks[k].flux = None
        self._drop_over_holes(samples)
        if len(samples.drive):
            self._sweep(samples)
        self._note_moves(samples)
        self._note_flux()
        active = self.active.tolist()
        for k, pairs in enumerate(self.chords.pairs.tolist()):
            if active[k] and pairs < self.tuning.chords:
                # The chords have begun anew, and the filter with its only witness.
                self._drop(k)
                active[k] = False
        first, P_first = (self.x, self.P) if all(active) else self.start_states()
        agreement = self._agreement()
        return [
            self._judge(k, inputs[k], fresh[k], agreement[k], first[k], P_first[k], now)
            for k in range(len(self.tracks))
        ]

    def _drop_over_holes(self, samples: Samples) -> None:
        """Filters that cannot bridge what is missing begin anew; one sample they always can."""
        if not any(samples.gap.tolist()):
            return
        long = samples.gap > np.maximum(samples.steps, LONGEST_COAST)
        for k in set(samples.drive[long].tolist()):
            self._drop(k)

    def _note_moves(self, samples: Samples) -> None:
        """Whose load has been moving, and who has said nothing in this tick."""
        heard = set(samples.drive.tolist())
        for k, track in enumerate(self.tracks):
            track.silent = k not in heard
            if not track.silent:
                load = self.x.item(k, pmsm.T_L)
                track.load, track.moved = load, abs(load - track.load)

    def _sweep(self, samples: Samples) -> None:
        drive, u, measured, n_sub, n_gap = samples
        dt, y = SAMPLE_NS * 1e-9, np.empty_like(measured)
        w_e, known = self.chords.w, self.chords.ready
        self._balance(self.sensors, drive, measured, n_sub, n_gap, dt, w_e, known, self.rated.I, y)
        self._lock_sweep(self.table, self.chords, self.tuning, drive, u, y, n_sub, n_gap, dt)
        nis = np.empty(len(drive))
        ok = np.empty(len(self.tracks), dtype=np.bool_)
        arguments = (
            self.table, self.noise.Q, self.noise.R * self.scale[:, None], self.noise.coast,
            self.x, self.P, drive, u, y, n_sub, n_gap, dt,
        )  # fmt: skip
        if self.ukf:
            ukf_lanes(*arguments, UKF_KAPPA, nis, ok, self.lean)
        else:
            ekf_lanes(*arguments, nis, ok, self.lean)
        self._absorb(
            drive, nis, n_sub, dt, NIS_SMOOTHING, SETTLE_STEPS, self.table, self.rated.I,
            self.x[:, pmsm.W_E], self.chords, self.active, self.steps, self.nis, self.scale,
            self.lean,
        )  # fmt: skip
        for k, fine in enumerate(ok.tolist()):
            if not fine:
                self._diverge(k)

    def _agreement(self) -> list[int]:
        """`lock.agrees`, compiled."""
        c = self.chords
        out = np.empty(len(self.x), dtype=np.int64)
        agreement(
            c.w, c.theta, c.age, c.ready, c.pairs, c.w_max, self.x, self.tuning.chords,
            TOLERANCES, out,
        )  # fmt: skip
        verdicts: list[int] = out.tolist()
        return verdicts

    def start_states(self) -> tuple[pmsm.Array, pmsm.Array]:
        """First x (N, 5) and P (N, 5, 5) of every drive from its chords."""
        return lock.start_state(self.chords, self.par, self.noise, self.rated)

    def _judge(
        self,
        k: int,
        cause: Reason,
        fresh: bool,
        agreement: int,
        first: pmsm.Array,
        P_first: pmsm.Array,
        now: Nanos,
    ) -> DriveEstimate:
        track = self.tracks[k]
        steps = self.steps.item(k)
        if steps < 0:
            self.steps[k] = 0
            track.diverged_ns = now
        if agreement == lock.Agreement.DISAGREES and self.active.item(k):
            track.doubts += 1
            if track.doubts >= DISAGREE_TICKS:
                self._drop(k)
                self.lean[k] = 0.0
                # A start that does not settle is tried again; a lost lock is a divergence.
                track.diverged_ns = now if steps >= SETTLE_STEPS else track.diverged_ns
        else:
            track.doubts = 0
        if track.diverged_ns is not None and now - track.diverged_ns < DIVERGED_NS:
            return DriveEstimate(Health.DIVERGED)
        if fresh and not self.active.item(k) and self._seen(k):
            self._start(k, first, P_first)
            track.diverged_ns = None
            track.doubts = 0
            agreement = lock.Agreement.AGREES
        if track.silent and track.moved > MOVING * self.rated.T[k]:
            # A load that moves is not the load of a tick ago.
            fresh = False
        return self._estimate(k, cause, fresh, agreement)

    def on_line(self, k: int, speed_rad_s: float) -> bool:
        """Whether the currents do not turn with a rotor of this measured speed: an open phase."""
        return unbalance.on_line(self.sensors, k, self.pole_pairs[k] * speed_rad_s)

    def flux(self, k: int) -> float:
        """Magnet flux of this drive over that of its data sheet; 1 where nothing is known."""
        return self.tracks[k].flux or 1.0

    def _seen(self, k: int) -> bool:
        """Whether the chords know speed and angle from the very last samples."""
        c = self.chords
        return bool(c.ready[k] and c.age[k] < 2.0 * c.span[k])

    def _estimate(self, k: int, cause: Reason, fresh: bool, agreement: int) -> DriveEstimate:
        if cause in (Reason.RANGE, Reason.NOT_AVAILABLE, Reason.CORRUPTED, Reason.SEQUENCE):
            return DriveEstimate(Health.INPUT_INVALID)
        if not self.active.item(k):
            return DriveEstimate(Health.CONVERGING if fresh else Health.UNKNOWN)
        sigma = math.sqrt(self.P.item(k, pmsm.T_L, pmsm.T_L))
        flux = self.flux(k)
        health = Health.TRACKING
        if not fresh:
            health = Health.PREDICTING
        elif self.steps.item(k) < SETTLE_STEPS or agreement != lock.Agreement.AGREES:
            health = Health.CONVERGING
        else:
            track = self.tracks[k]
            track.best = min(FORGET * track.best, sigma)
            if sigma > LOOSE * track.best:
                health = Health.CONVERGING
        return DriveEstimate(
            health,
            self.x.item(k, pmsm.W_E) / self.pole_pairs[k],
            self.x.item(k, pmsm.T_L) * flux,
            sigma * flux,
            self.nis.item(k),
        )

    def _note_flux(self) -> None:
        """Magnet flux over that of the data sheet, as the chords' length has it of late.

        Errors of R_s lengthen a chord, too: what they can explain is not taken for flux. The
        chords reach further than the filters, and what they found survives a new start.
        """
        chords, near = self.chords, self.tick_s / FLUX_TAU_S
        each = zip(
            self.tracks, self.sheet, chords.ready.tolist(), chords.psi.tolist(),
            chords.w.tolist(), np.abs(chords.i_last).tolist(), strict=True,
        )  # fmt: skip
        for track, (R_s, psi_f), ready, psi, w, current in each:
            if not (ready and math.isfinite(psi) and w):
                continue
            sure = FLUX_SURE * psi_f + RESISTANCE_SURE * R_s * current / abs(w)
            more = math.copysign(max(abs(psi - psi_f) - sure, 0.0), psi - psi_f) / psi_f
            before = more if track.flux is None else track.flux - 1.0
            track.flux = 1.0 + before + near * (more - before)

    def _start(self, k: int, x: pmsm.Array, P: pmsm.Array) -> None:
        """Begin a filter. What the chords are too long by is the voltage that the motor lacks."""
        self.x[k], self.P[k] = x, P
        self.active[k], self.steps[k], self.nis[k] = True, 0, 2.0
        if not self.lean.item(k):
            w, R_s, psi_f = self.chords.w.item(k), *self.sheet[k]
            most = adapt.most_lean(w, R_s, psi_f, self.rated.I.item(k))
            self.lean[k] = min(max((self.chords.psi.item(k) - psi_f) * w, -most), most)

    def _drop(self, k: int) -> None:
        """Forget the filter of one drive; it is acquired anew."""
        self.active[k] = False
        self.steps[k] = 0
        self.tracks[k].doubts = 0
        self.x[k] = 0.0
        self.P[k] = np.eye(5)

    def _diverge(self, k: int) -> None:
        """A number that is not one: reset now, said from this tick on."""
        active = self.active.item(k)
        self._drop(k)
        self.lean[k] = 0.0
        self.steps[k] = -1 if active else 0


def _noise(par: pmsm.Pmsm, rated: pmsm.Rated, config: Estimator, step_a: float) -> pmsm.Noise:
    """Noise of the configuration; R in the stationary frame, quantisation included.

    With three currents the alpha-beta noise is 2/3 of a phase's; R keeps the full phase
    variance, which also covers the two-current beta of the FD samples.
    """
    noise = pmsm.default_noise(par, rated, SAMPLE_NS * 1e-9, step_a, config.current_noise_var)
    base = pmsm.default_noise(
        pmsm.BENCH_MOTOR, pmsm.BENCH_RATED, SAMPLE_NS * 1e-9, step_a, config.current_noise_var
    )
    return noise._replace(Q=noise.Q * (np.array(config.process_noise) / base.Q[0]))
