"""Records of the filters, made from rows and columns as tests have them."""

from typing import NamedTuple

import numpy as np

from estimators import filters
from estimators.models import pmsm
from tests.core_calls import acquisition


def samples(drive, u, y, n_sub, n_gap, nis=np.nan):
    """`struct filter_sample` of M rows; u and y (M, 2)."""
    made = filters.sample_records(drive, u, y, n_sub, n_gap)
    made.nis = nis
    return made


def acquire(drives, par, rows, dt):
    """Feed rows (drive, u, y, n_sub, n_gap) to the flux chords."""
    acquisition.add(samples(*rows[:5]), pmsm.table(par), drives, acquisition.limits(), dt)


class Estimate(NamedTuple):
    """At the last sample, each (N,)."""

    ready: np.ndarray
    w: np.ndarray
    theta: np.ndarray
    spread: np.ndarray


def estimate(drives):
    """What the chords say."""
    return Estimate(
        drives.ready == 1, drives.w.copy(), acquisition.theta(drives), drives.spread.copy()
    )


def check(drives, x):
    """Consistency (N,) of filters with the states x (N, 5)."""
    each = filters.unstarted(len(x))
    each.x = x
    return np.array(acquisition.check(drives, each))


def start_states(drives, par, noise, rated):
    """First x (N, 5) and P (N, 5, 5) of all filters."""
    each, table = filters.unstarted(len(drives)), pmsm.table(par)
    for k in range(len(drives)):
        acquisition.start_filter(drives, k, table, noise.R, rated.T[k], each)
    return each.x.copy(), each.P.copy()
