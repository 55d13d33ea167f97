"""Flags of N drives: their records. The C sources have the rules.

What a flag follows and how long evidence must hold is in `gateway/core/flags.c`, the fields of the
records are in `gateway/core/records.h`. May know: flags and reasons. May not know: frames, clocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
from _traction_core import lib

from dbc.records import (
    DRIVE_EVIDENCE,
    DRIVE_STATUS,
    FLAG_INPUTS,
    FLAG_RULES,
    TRAIN_INPUTS,
    TRAIN_STATUS,
    Addressed,
    Records,
)
from gateway.core.codes import NEVER, Flag, Reason

UNCHANGED: Final[int] = lib.FLAG_UNCHANGED
"""In place of evidence: the flag is unchanged, and the tick does not count."""


class FlagKind(IntEnum):
    """Flags of a drive; the index of one in `drive_status.flag`."""

    ADHESION = lib.FLAG_ADHESION
    THERMAL = lib.FLAG_THERMAL
    COMM = lib.FLAG_COMM
    ESTIMATOR = lib.FLAG_ESTIMATOR
    SENSOR = lib.FLAG_SENSOR


class Timing(NamedTuple):
    """How long evidence must hold before a flag follows it, ns (`struct flag_timing`)."""

    good_ns: int
    raise_ns: int
    clear_ns: int


class Status(NamedTuple):
    """What is sent: `drive_status` of N drives, (N,), and one `train_status`, (1,)."""

    drives: Records
    train: Records


def rules(
    timing: Sequence[Timing], severe: Timing, raise_probability: float, clear_probability: float,
    tick_ns: int,
) -> Records:  # fmt: skip
    """One `flag_rules`. timing: by `FlagKind`; severe: for a severe loss of adhesion."""
    made = np.zeros(1, FLAG_RULES)
    made["timing"] = [[tuple(each) for each in timing]]
    made["severe"] = tuple(severe)
    made["raise_probability"], made["clear_probability"] = raise_probability, clear_probability
    made["tick_ns"] = tick_ns
    return made


def unknown_status(n: int, detector: int, start_ns: int = 0) -> Status:
    """Status of N drives of which nothing is known; detector: its number in the DBC."""
    drives, train = np.zeros(n, DRIVE_STATUS), np.zeros(1, TRAIN_STATUS)
    drives["flag"]["since_ns"] = start_ns
    for name, kind in zip(DRIVE_STATUS.names, DRIVE_STATUS.descr, strict=False):
        if kind[1] == "<f8":
            drives[name] = np.nan
    for table, reasons in ((drives, ("adhesion", "thermal")), (train, ("adhesion", "faults"))):
        for name in reasons:
            table[f"{name}_reason"] = Reason.STARTING
        table["age_ns"] = table["temperature_age_ns"] = NEVER
    train["detector"], train["overrun"] = detector, Flag.GOOD
    return Status(drives, train)


class Flags(Addressed):
    """Records of N drives' flags: the inputs that a tick fills in, and the resulting status."""

    def __init__(self, rules: Records, n: int, detector: int, start_ns: int) -> None:
        self.rules = rules
        self.inputs = np.zeros(n, FLAG_INPUTS)
        self.train_inputs = np.zeros(1, TRAIN_INPUTS)
        self.evidence = np.zeros(n, DRIVE_EVIDENCE)
        self.status = unknown_status(n, detector, start_ns)
        self.link()

    def link(self) -> None:
        """See `Addressed`."""
        self.adhesion = self.status.drives["flag"][:, FlagKind.ADHESION]
        """(N,) the adhesion flags, a view."""
