"""What the thermal side has found of every drive, as arrays.

May know: words of the message set. May not know: frames, clocks, bits.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.health import NEVER, Reason

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


class Findings(NamedTuple):
    """What the thermal side has found of every drive, (N,): `thermal.Report`; NaN: not known.

    heard_ns: stamp of the last temperatures, `NEVER` before any.
    """

    thermal: Ints
    sensor: Ints
    reason: Ints
    fault_class: Ints
    fault_sensor: Ints
    mixed_c: Array
    maisd_k: Array
    rate_k_h: Array
    jumps: Ints
    heard_ns: Ints


def findings(n: int) -> Findings:
    """Nothing found."""
    thermal, sensor, fault_class, fault_sensor, jumps = np.zeros((5, n), dtype=np.int64)
    mixed_c, maisd_k, rate_k_h = np.full((3, n), np.nan)
    return Findings(
        thermal, sensor, np.full(n, Reason.STARTING, dtype=np.int64), fault_class, fault_sensor,
        mixed_c, maisd_k, rate_k_h, jumps, np.full(n, NEVER, dtype=np.int64),
    )  # fmt: skip
