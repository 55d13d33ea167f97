"""Views of ticks as the columns that reports take."""

import numpy as np

from dbc.records import DRIVE_STATUS, TRAIN_STATUS
from gateway.core.flags import FlagKind
from gateway.reports.ticks import Ticks

NUMBERS = ("speed_rad_s", "load_nm", "load_sigma_nm", "loss_probability", "nis", "mixed_c",
           "maisd_k")  # fmt: skip
WORDS = ("adhesion_reason", "thermal_reason", "health", "fault_class", "fault_sensor")


def or_nan(value):
    return np.nan if value is None else value


def ticks(*views):
    """Of one or several ticks; no temperatures came in them."""
    k, n = len(views), len(views[0].drives)
    drives, train = np.zeros((k, n), DRIVE_STATUS), np.zeros(k, TRAIN_STATUS)
    wear = np.full((k, n, 3), np.nan)
    for at, view in enumerate(views):
        train["common_mode"][at], train["overrun"][at] = view.common_mode, view.overrun
        for j, d in enumerate(view.drives):
            row = drives[at, j]
            for kind in FlagKind:
                row["flag"]["state"][kind] = getattr(d, kind.name.lower())
            for name in NUMBERS:
                row[name] = or_nan(getattr(d, name))
            for name in WORDS:
                row[name] = getattr(d, name)
            wear[at, j] = [or_nan(v) for v in (d.wear.rate_k_h, d.wear.sigma_k_h, d.wear.hours)]
    return Ticks(
        np.array([view.t_ns for view in views]), drives, train,
        np.array([or_nan(view.bus_load_percent) for view in views]), wear,
        np.full((k, n, 4), np.nan),
    )  # fmt: skip
