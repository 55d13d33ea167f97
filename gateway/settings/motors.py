"""`[motor.NAME]`: parameters of a motor, their bounds, and whether they are consistent.

The bounds admit every permanent-magnet motor from 0.5 kW to 2 MW. May know: numbers. May not know:
drives, buses, estimators.
"""

from __future__ import annotations

import math
from typing import Annotated, Final, Self

from pydantic import model_validator

from dbc.toml_files import Strict, Within, within

TORQUE_RATIO: Final = Within(0.25, 2.5, "", "")
"""T_rated over the torque of the magnets at I_rated: reluctance torque, saturation and a rated
current stated as RMS stay within these bounds; a misplaced decimal point does not."""
ELECTRICAL_S: Final = Within(1e-4, 2.0, "s", "")
"""L_s / R_s: bench 12 ms, 350 kW motor 38 ms."""
SPIN_UP: Final = Within(5, 1e5, "rad/s2", "")
"""T_rated / J: bench 750, 350 kW motor with its wheelset 72, a bare servo motor 20,000 rad/s2. No
real rotor needs more than rated torque to follow its train at 1 m/s2."""
FRICTION_SPEED_RAD_S: Final = 100.0
"""B times this may not exceed T_rated."""


class Motor(Strict):
    """SI units; noise and thresholds are per unit of the rated values."""

    R_s: Annotated[float, within(1e-4, 100, "ohm", "give the resistance of a phase in ohm")]
    L_s: Annotated[float, within(1e-6, 2, "H", "give the inductance of a phase in henry")]
    psi_pm: Annotated[float, within(1e-3, 50, "Wb", "give the magnets' flux linkage in weber")]
    pole_pairs: Annotated[int, within(1, 100, "", "a machine of 8 poles has 4 pole pairs")]
    J: Annotated[float, within(1e-6, 1e4, "kg m2", "give rotor and wheel, at the motor shaft")]
    B: Annotated[float, within(0, 100, "Nm s", "give the friction per rad/s of the rotor")] = 0.0
    k_p: Annotated[float, within(0.5, 3, "", "1.5 for amplitude-invariant alpha and beta")] = 1.5
    I_rated: Annotated[float, within(0.5, 5000, "A", "give the phase current's amplitude in A")]
    T_rated: Annotated[float, within(0.2, 1e5, "Nm", "give the torque at the motor shaft in Nm")]

    @property
    def torque_nm(self) -> float:
        """Torque of the magnets at the rated current, Nm."""
        return self.k_p * self.pole_pairs * self.psi_pm * self.I_rated

    def voltage(self, w_e: float, i_q: float) -> float:
        """Amplitude in V at a steady electrical speed in rad/s and q current in A; i_d is 0."""
        return math.hypot(w_e * self.L_s * i_q, w_e * self.psi_pm + self.R_s * i_q)

    @model_validator(mode="after")
    def _one_machine(self) -> Self:
        problems = []
        torque = self.torque_nm
        if not TORQUE_RATIO.low <= self.T_rated / torque <= TORQUE_RATIO.high:
            problems.append(
                f"T_rated: {self.T_rated:g} Nm does not fit I_rated = {self.I_rated:g} A, which "
                f"gives k_p x pole_pairs x psi_pm x I_rated = {torque:.3g} Nm: correct the "
                f"one that is wrong (T_rated may be {TORQUE_RATIO} times that)"
            )
        tau = self.L_s / self.R_s
        if not ELECTRICAL_S.low <= tau <= ELECTRICAL_S.high:
            problems.append(
                f"L_s: {self.L_s:g} H with R_s = {self.R_s:g} ohm is a time constant of {tau:.3g} "
                f"s, expected {ELECTRICAL_S}: give L_s in henry and R_s in ohm"
            )
        spin_up = self.T_rated / self.J
        if not SPIN_UP.low <= spin_up <= SPIN_UP.high:
            problems.append(
                f"J: T_rated = {self.T_rated:g} Nm would speed up {self.J:g} kg m2 by "
                f"{spin_up:.3g} rad/s2, expected {SPIN_UP}: give J in kg m2, at the motor shaft"
            )
        if self.T_rated < self.B * FRICTION_SPEED_RAD_S:
            problems.append(
                f"B: a friction of {self.B:g} Nm s takes more than T_rated = {self.T_rated:g} Nm "
                f"at {FRICTION_SPEED_RAD_S:g} rad/s: give it per rad/s of the rotor"
            )
        if problems:
            raise ValueError("\n".join(problems))
        return self


BENCH_MOTOR: Final = Motor(
    R_s=0.28, L_s=3.465e-3, psi_pm=0.1989, pole_pairs=4, J=0.04, I_rated=25.0, T_rated=30.0
)
"""The motor of the adhesion paper, which does not state its constants: see docs/papers.md."""
TRACTION_350KW: Final = Motor(
    R_s=0.08, L_s=3.02e-3, psi_pm=1.104, pole_pairs=2, J=11.0, I_rated=240.4, T_rated=796.0
)
"""The thermal paper's motor (350 kW, 1443 V, 170 A, 140 Hz) as a PMSM: `sim.physics.plant`."""
