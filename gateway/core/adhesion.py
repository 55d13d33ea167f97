"""Which drives have lost adhesion: records of `gateway/core/adhesion.c`, and the detector.

The rules are in C, the fields of the records in `gateway/core/records.h`. May know: estimators,
estimates, commands. May not know: frames, bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from _traction_core import lib

from dbc.frame import SECOND, Nanos
from dbc.records import (
    ADHESION,
    COMMAND_RESPONSE,
    DRIVE_LOAD,
    LOAD_OBSERVATION,
    LOAD_RATIO,
    ROTOR,
    ROTOR_INPUTS,
    Addressed,
    Records,
    pointer,
)
from estimators.detect import Evidence, Opinion, make
from estimators.detect.switching import Switching, SwitchingDetector
from estimators.detect.variational import VariationalDetector
from gateway.settings.config import Motor
from gateway.settings.sections import Adhesion

BASE_NM: Final = 30.0
"""Rated torque of the motor that `spread_nm` is stated for."""


class AdhesionMonitor(Addressed):
    """A `struct adhesion` with everything that it points to; a tick changes it."""

    def __init__(
        self, config: Adhesion, motors: Sequence[Motor], rules: Records, tick_ns: Nanos
    ) -> None:
        """rules: `flag_rules`; motors: one per drive."""
        self.config, self.rules = config, rules
        self.rated = tuple(motor.T_rated for motor in motors)
        self.detector = make(config.detector, config.observe, config.tolerance, config.reuse)
        self.in_core = isinstance(self.detector, VariationalDetector | SwitchingDetector)
        """Whether the core runs the detector."""
        n = len(motors)
        self.rotors = _rotors(motors)
        self.rotor_inputs = np.zeros(n, ROTOR_INPUTS)
        self.responses = np.zeros(n, COMMAND_RESPONSE)
        self.response_ratios, self.ratios = np.zeros((2, n), LOAD_RATIO)
        self.observed, self.loads = np.zeros(n, LOAD_OBSERVATION), np.zeros(n, DRIVE_LOAD)
        self.normalised, self.sigma, self.loss_probability = np.zeros((3, n))
        flags = np.zeros((4, n), dtype=np.bool_)
        self.known, self.compared, self.loss_known, self.may_learn = flags
        self.workspace = np.zeros((5, n))
        self.record = np.zeros(1, ADHESION)
        self.record["n"], self.record["tick_s"] = n, tick_ns / SECOND
        if isinstance(self.detector, VariationalDetector):
            self.record["priors"] = tuple(self.detector.priors)
            self.record["iterations"] = self.detector.sweeps
        self.switching: Switching | None = None
        if isinstance(self.detector, SwitchingDetector):
            self.switching = Switching(n, tick_ns)
        self.link()
        lib.adhesion_reset(self._pointer, config.spread_nm / BASE_NM)

    def link(self) -> None:
        """See `Addressed`."""
        for name in (
            "rules", "rotors", "rotor_inputs", "responses", "response_ratios", "ratios", "observed",
            "loads", "normalised", "sigma", "known", "compared", "loss_probability", "loss_known",
            "may_learn", "workspace",
        ):  # fmt: skip
            self.record[name] = getattr(self, name).ctypes.data
        if self.switching is not None:
            self.record["switching"] = self.switching.record.ctypes.data
        self._pointer = pointer("struct adhesion", self.record)

    def ask_detector(self, estimates: Records) -> None:
        """Do what `adhesion_detect` does, with a detector outside the core. estimates: (N,)."""
        speeds = None if self.config.observe == "torque" else np.abs(estimates["speed_rad_s"])
        lost, known, common = self.detector(
            Evidence(self.normalised, self.sigma, self.compared, speeds)
        )  # fmt: skip
        self.loss_probability[:], self.loss_known[:] = lost, known
        self.record["common"] = common

    @property
    def opinion(self) -> Opinion:
        """Opinion of the last tick, after the fusion with other criteria."""
        return Opinion(self.loss_probability, self.loss_known, self.record["common"].item())


def _rotors(motors: Sequence[Motor]) -> Records:
    """`rotor` of every drive. Speeds are compared between motors of the same ratings.

    What was measured on each motor, such as its flux, may differ.
    """
    made = np.zeros(len(motors), ROTOR)
    ratings = [(m.pole_pairs, m.T_rated, m.I_rated) for m in motors]
    made["rated_nm"] = [m.T_rated for m in motors]
    made["inertia_kg_m2"] = [m.J for m in motors]
    made["motor"] = [ratings.index(rating) for rating in ratings]
    return made
