"""Steps of sensors: changes by kelvins within seconds, too fast for a motor of 850 kg.

The detector compares the median of a sensor's residual (reading less model) over the last seconds
with the median before. If they differ by more than `STEP_K`, it compares the medians again when the
readings have settled, less the step that the other motors' sensors show: a burst is over by then, a
step is not. Steps add up to the sensor's offset; a step back to the first level is no new fault.
Only for readings that come every few seconds. Not in paper `thermal`. The rules are in
`step_detector.c`, those of the train in `residuals.c`.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from _traction_core import lib

from dbc import records
from dbc.records import Records, pointer

BEFORE_S, AFTER_S, SETTLED_S = 20.0, 5.0, 25.0
STEP_K: Final = 1.5
"""Least step of medians over seconds."""
STEP_NOISES: Final = 6.0
"""A step is at least so many times the noise of a single reading: eight times that of a median."""
BACK: Final = 2.0 / 3.0
"""A sensor that is off by less than this share of a step is back at its first level: a step and the
step back are measured with the same noise."""
HEAT_K_PER_S: Final = 0.1
"""Largest rate at which heat unknown to the model changes a level."""
SLOWEST_S: Final = 2.0
"""Readings further apart do not distinguish a step from heat."""
MOST_SAMPLES: Final[int] = lib.STEP_WINDOW_MAX


def config(spacing_s: float, *, noise_k: float = 0.0, tested: bool = True) -> Records:
    """(1,) of `struct step_config`, for samples `spacing_s` apart; without `tested` no steps.

    noise_k: standard deviation of the noise of a reading.
    """
    out = np.zeros(1, records.STEP_CONFIG)
    least = max(STEP_K, STEP_NOISES * noise_k)
    out["step_k"], out["back_k"] = least if tested else 0.0, BACK * least
    out["drift_k"] = HEAT_K_PER_S * spacing_s
    for name, seconds in (("before", BEFORE_S), ("after", AFTER_S), ("settled", SETTLED_S)):
        out[name] = round(seconds / spacing_s)
    return out


def window(configs: Records) -> int:
    """Samples in the detector's window."""
    return int(lib.step_window(pointer("struct step_config", configs)))
