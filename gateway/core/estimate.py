"""Estimates of N drives by their filters: records and constants of `gateway/core/estimate.c`.

The rules by which a filter starts or is dropped, and a drive's state is known, are in C, the fields
of the records in `gateway/core/records.h`. May know: motors. May not know: frames, clocks, flags.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from _traction_core import lib

from dbc.frame import MS, SECOND, Nanos
from dbc.records import (
    ACQUISITION,
    CURRENT_CALIBRATION,
    DRIVE_ESTIMATE,
    ESTIMATOR,
    FILTER,
    FILTER_SAMPLE,
    FILTER_TRACK,
    Addressed,
    Records,
    pointer,
    zeros,
)
from estimators import filters
from estimators.models import pmsm
from gateway.core.channel import SAMPLE_NS
from gateway.core.codes import Reason
from gateway.settings.config import Motor
from gateway.settings.sections import Estimator

SAMPLES_AT_FIRST: Final = 512
"""Samples per tick that there is room for, until a tick has more."""


class Bank(Addressed):
    """A `struct estimator` with everything that it points to; a tick changes it.

    estimates: `drive_estimate` of every drive.
    """

    _pointer: Any

    def __init__(
        self,
        motors: Sequence[Motor],
        config: Estimator,
        current_step_a: float,
        tick_ns: Nanos = 10 * MS,
    ) -> None:
        """current_step_a: resolution of the currents on the bus, part of R."""
        n = len(motors)
        rows = [(m.R_s, m.L_s, m.psi_pm, float(m.pole_pairs), m.J, m.B, m.k_p) for m in motors]
        par = pmsm.motors(*rows)
        self.motors = pmsm.table(par)
        self.rated_a = np.array([m.I_rated for m in motors])
        self.rated_nm = np.array([m.T_rated for m in motors])
        rated = pmsm.Rated(self.rated_a, self.rated_nm)
        self.noise = filters.noise_records(_noise(par, rated, config, current_step_a))
        self.filters, self.chords = zeros(n, FILTER), zeros(n, ACQUISITION)
        self.sensors, self.tracks = zeros(n, CURRENT_CALIBRATION), zeros(n, FILTER_TRACK)
        self.samples = zeros(SAMPLES_AT_FIRST, FILTER_SAMPLE)
        """Samples of the last tick, with their `nis`."""
        self.estimates = estimates(n)
        self.record = np.zeros(1, ESTIMATOR)
        self.record["n"], self.record["tick_s"] = n, tick_ns / SECOND
        self.record["settings"] = filters.settings(SAMPLE_NS * 1e-9, config.kind)
        self.record["limits"]["w_on"] = config.min_speed_rad_s
        self.record["limits"]["w_off"] = 0.75 * config.min_speed_rad_s
        self.link()
        lib.estimator_reset(self._pointer)

    def link(self) -> None:
        """See `Addressed`."""
        for name in (
            "motors", "noise", "rated_a", "rated_nm", "filters", "chords", "sensors", "tracks",
            "samples",
        ):  # fmt: skip
            self.record[name] = getattr(self, name).ctypes.data
        self._pointer = pointer("struct estimator", self.record)
        self.x, self.P = self.filters.x, self.filters.P

    def reserve(self, samples: int) -> None:
        """Make room for so many samples per tick."""
        if samples > len(self.samples):
            self.samples = zeros(samples, FILTER_SAMPLE)
            self.link()


def estimates(n: int) -> Records:
    """`drive_estimate` of N drives of which nothing is known."""
    made = np.zeros(n, DRIVE_ESTIMATE)
    for name in ("speed_rad_s", "load_nm", "load_sigma_nm", "nis", "flux_ratio"):
        made[name] = np.nan
    made["health_reason"] = Reason.STARTING
    return made


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
