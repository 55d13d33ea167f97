"""The bank of filters: samples in, per drive state, health and age out.

A drive is acquired by its flux chords, then filtered, and watched by the chords for as long
as it is tracked: the filter's own word is never the proof that it is locked. May know:
estimators. May not know: frames, clocks, flags.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import Final

import numpy as np
from _traction_core import lib
from numpy.typing import NDArray

from dbc.frame import MS, SECOND, Nanos
from dbc.records import Addressed
from estimators import acquisition, adaptation, current_calibration, filters
from estimators.models import pmsm
from gateway import inputs, tracks
from gateway._bank_kernels import forget, tell
from gateway._direct import Direct
from gateway._sweep_kernels import run_filters
from gateway.channel import SAMPLE_NS
from gateway.config import Estimator, Motor
from gateway.pairing import Samples

SETTLE_STEPS: Final = lib.FILTER_SETTLE_STEPS
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
SAMPLES_AT_FIRST: Final = 256
"""Of a tick, that there is room for before one brings more."""


class Bank(Addressed):
    """Filters of N drives; `advance` once per tick. estimates: `drive_estimate` of every one."""

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
        n = len(motors)
        self.filters, self.tracks = adaptation.filters(n), tracks.tracks(n)
        self.estimates = tracks.estimates(n)
        self.told = tracks.told_of(self.estimates)
        self.chords = acquisition.start(n)
        self.sensors = current_calibration.start(n)
        self.limits = tracks.Limits(
            self.par.R_s, self.par.psi_f, self.par.p, MOVING * self.rated.T, acquisition.PAIRS,
            SETTLE_STEPS, DISAGREE_TICKS, DIVERGED_NS, LOOSE, FORGET,
            self.tick_s / FLUX_TAU_S, FLUX_SURE, RESISTANCE_SURE,
        )  # fmt: skip
        self.link()
        self.constants = tracks.Constants(
            self.table, filters.noise_records(self.noise), self.rated.I,
            acquisition.limits(config.min_speed_rad_s, 0.75 * config.min_speed_rad_s),
            filters.settings(SAMPLE_NS * 1e-9, config.kind), self.limits, SAMPLE_NS * 1e-9,
            LONGEST_COAST,
        )  # fmt: skip
        self.room = tracks.room(SAMPLES_AT_FIRST)
        """Of the last tick; its first samples, with their `nis`, are those."""
        self._advance = Direct(run_filters)
        self._tell = Direct(tell)
        # Compiled, or loaded, now and not when the first filter begins.
        none = inputs.inputs(n)
        self._tell(none.cause, none.fresh, self.filters, self.tracks, self.limits, self.told)

    def link(self) -> None:
        """See `Addressed`: fields of the records for others."""
        self.x, self.P = self.filters.x, self.filters.P
        told = tracks.told_of(self.estimates)
        self.told = told._replace(agrees=self.told.agrees, begins=self.told.begins)
        self.tracks = self.tracks._replace(flux=self.estimates["flux_ratio"])
        self.believed = tracks.Believed(
            self.filters, self.tracks, self.chords, self.sensors, self.told
        )

    def advance(
        self,
        samples: Samples,
        restart: Collection[int],
        causes: NDArray[np.uint8],
        fresh: NDArray[np.bool_],
        now: Nanos,
    ) -> None:
        """Filter this tick's samples and judge every drive; fills `told`.

        restart: drives whose samples begin anew; causes (N,): `Reason` why a drive's input cannot
        be believed; fresh (N,): whether its newest sample is within its age limit.
        """
        for k in restart:
            forget(k, self.filters, self.tracks)
            acquisition.restart(self.chords, k)
            current_calibration.restart(self.sensors, k)
            self.tracks.flux[k] = math.nan
        if len(samples.drive) > len(self.room.samples):
            self.room = tracks.room(2 * len(samples.drive))
        if self._advance(
            samples, now, causes, fresh, self.believed, self.constants, self.room
        ):  # fmt: skip
            self.begin(causes, fresh)

    def begin(self, causes: NDArray[np.uint8], fresh: NDArray[np.bool_]) -> None:
        """Start the filters that `told.begins` names, and judge them."""
        self._begin()
        self._tell(causes, fresh, self.filters, self.tracks, self.limits, self.told)

    def _begin(self) -> None:
        """Filters of the drives whose chords are ready."""
        mine, chords, rated = self.filters, self.chords, self.rated
        for k in np.flatnonzero(self.told.begins).tolist():
            acquisition.start_filter(chords, k, self.table, self.noise.R, rated.T.item(k), mine)
            mine.active[k], mine.steps[k], mine.nis[k] = True, 0, 2.0
            self.tracks.diverged_ns[k], self.tracks.doubts[k] = -1, 0
            if not mine.v_q_bias.item(k):
                mine.v_q_bias[k] = adaptation.first_q_bias(chords, k, self.table, rated.I.item(k))


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
