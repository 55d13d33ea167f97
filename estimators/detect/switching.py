"""Detection of lost adhesion by a switching model: the records of `switching.c`, the detector.

In the model each drive adheres, has lost adhesion, or has a load that carries no information; all
drives share the demand of the train. The equations are in `switching.c`, `switching_drive.c` and
`switching_mixture.c`, their derivation in `docs/switching.md`. Not in paper `adhesion`.
"""

from __future__ import annotations

from typing import Any, ClassVar, Final

import numpy as np
from _traction_core import ffi, lib

from dbc.records import (
    SWITCHING,
    SWITCHING_DRIVE,
    SWITCHING_HYPOTHESIS,
    SWITCHING_LOAD,
    SWITCHING_NOISE,
    Addressed,
)
from estimators.detect.protocol import Evidence, Opinion, nobody

STEP_NS: Final = 10_000_000
"""Time step of the model, whatever the period of a tick."""


class Switching(Addressed):
    """One `struct switching` of N drives, with everything that it points to."""

    pointer: Any

    def __init__(self, n: int, tick_ns: int = STEP_NS) -> None:
        """Start without knowledge; the model makes a step every `STEP_NS`, in whole ticks."""
        kept, tried = lib.SWITCHING_KEPT, lib.SWITCHING_TRIED
        self.loads, self.noises = np.zeros(n, SWITCHING_LOAD), np.zeros(n, SWITCHING_NOISE)
        self.hypotheses = np.zeros(kept, SWITCHING_HYPOTHESIS)
        self.trials = np.zeros(tried, SWITCHING_HYPOTHESIS)
        self.drives = np.zeros((kept, n), SWITCHING_DRIVE)
        self.trial_drives = np.zeros((tried + 1, n), SWITCHING_DRIVE)
        self.adhering, self.lost = np.zeros((2, n))
        self.record = np.zeros(1, SWITCHING)
        self.record["n"], self.record["every"] = n, max(round(STEP_NS / tick_ns), 1)
        self.link()
        lib.switching_reset(self.pointer)

    def link(self) -> None:
        """See `Addressed`."""
        for name in (
            "loads", "noises", "hypotheses", "drives", "trials", "trial_drives", "adhering", "lost",
        ):  # fmt: skip
            self.record[name] = getattr(self, name).ctypes.data
        self.pointer = ffi.from_buffer("struct switching *", self.record)


class SwitchingDetector:
    """The model as a detector: one object serves one sequence of steps of 10 ms.

    Loads are per unit of rated torque; the spread is learnt, not taken from the evidence. In the
    gateway the core runs the model, with further inputs from the drives.
    """

    code: ClassVar[int] = 5

    def __init__(self) -> None:
        """Start without knowledge; the first call makes the model."""
        self.model: Switching | None = None

    def __call__(self, evidence: Evidence) -> Opinion:
        """See Detector. The first call fixes the number of drives."""
        n = len(evidence.load)
        if self.model is None:
            self.model = Switching(n)
        known = evidence.usable & np.isfinite(evidence.load)
        self.model.loads["known"] = known
        self.model.loads["load"] = np.clip(np.where(known, evidence.load, 0.0), -2.0, 2.0)
        lib.switching_step(self.model.pointer)
        if np.count_nonzero(known) < 2:
            return nobody(n)
        demand = self.model.record["demand"].item()
        return Opinion(self.model.lost.copy(), evidence.usable.copy(), demand)
