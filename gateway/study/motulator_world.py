"""Drives of `motulator` (PyPI): a world with another author's machines to judge detectors in.

motulator provides the machine (flux equations in rotor coordinates), mechanics, inverter, modulator
with its delay, and the control: speed, current reference and current vector control with its own
gains, at its own current bandwidth. Ours are the scenario (load and wanted speed, held over
125 us), sensors, messages and bus; the kinds are those of `held_world`.

We set two things: the drives roll at the start (with preloaded controllers, as in our simulator;
otherwise a run begins with a shock), and the speed bandwidth. 60 rad/s gives motulator's controller
our gains, 2 alpha J = 120 J and alpha^2 J = 3600 J; its own default is 25 rad/s (4 Hz).
"""

from __future__ import annotations

import cmath
import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dbc.arrays import Array
from dbc.codec import Codec
from gateway.io.extras import need
from gateway.settings.config import ConfigError
from gateway.study.held_world import OtherMachine, courses, periods
from sim.physics import plant as columns
from sim.physics.plant import DT, MOTORS, OUT, Motor
from sim.scenario import Scenario
from sim.simulation import start_angles

OVERLOAD: Final = 1.5
"""Largest torque and current, over the rated ones, as in our simulator."""
SPEED_BANDWIDTH: Final = 60.0
"""Bandwidth of the speed control, rad/s."""


def simulate(_kind: str, scenario: Scenario, codec: Codec) -> OtherMachine:
    """The simulated train with these drives. Raises ConfigError without motulator."""
    need(("motulator",), "verify", "--world motulator")
    return OtherMachine(scenario, codec, waveforms(scenario))


class Drive:
    """One drive made of motulator's parts."""

    def __init__(
        self, motor: Motor, p: np.record, w_0: float, theta_0: float, load_0: float
    ) -> None:
        """Start rolling at `w_0` rad/s (rotor), electrical angle `theta_0` rad, load `load_0` Nm.

        `p`, a `struct sim_motor`: the machine's own parameters; its control has those of `motor`.
        """
        from motulator.common.control import PWM
        from motulator.drive import model
        from motulator.drive.control import sm
        from motulator.drive.utils import SynchronousMachinePars

        poles = motor.pole_pairs
        real = SynchronousMachinePars(
            n_p=poles, R_s=float(p.R_s), L_d=float(p.L_s), L_q=float(p.L_s), psi_f=float(p.psi_pm)
        )
        assumed = SynchronousMachinePars(
            n_p=poles, R_s=motor.R_s, L_d=motor.L_s, L_q=motor.L_s, psi_f=motor.psi_pm
        )
        self._load_nm, self._w_ref = load_0, w_0
        self._machine = model.SynchronousMachine(real)
        self._mechanics = model.StiffMechanicalSystem(
            float(p.J), float(p.B), lambda _t: self._load_nm
        )
        self._model = model.Drive(
            model.VoltageSourceConverter(motor.U_dc), self._machine, self._mechanics
        )
        limits = sm.CurrentReferenceCfg(
            assumed,
            max_i_s=OVERLOAD * motor.I_rated,
            nom_w_m=motor.U_dc / math.sqrt(3.0) / motor.psi_pm,
        )
        control = sm.CurrentVectorControl(assumed, limits, T_s=DT, sensorless=False)
        speed = sm.SpeedController(motor.J, SPEED_BANDWIDTH, OVERLOAD * motor.T_rated)
        control.speed_ctrl = speed
        control.ref.w_m = lambda _t: poles * self._w_ref
        self._control = control

        self._machine.state.exp_j_theta_m = cmath.rect(1.0, theta_0)
        self._mechanics.state.exp_j_theta_M = cmath.rect(1.0, theta_0 / poles)
        self._mechanics.state.w_M = w_0
        induced = 1j * poles * w_0 * real.psi_f
        speed.u_i = load_0 + (speed.k_p - speed.k_t) * w_0
        control.current_ctrl.u_i = induced
        first = induced * cmath.rect(1.0, theta_0 + 0.5 * poles * w_0 * DT)
        control.pwm = PWM(u_cs0=first)
        self._model.delay.data = [control.pwm.duty_ratios(first, motor.U_dc)]

    def advance(self, w_ref: float, load_nm: float, out: Array) -> None:
        """Advance one period of 125 us; `out` (10,) gets its row, with the mean voltages."""
        model, control, converter = self._model, self._control, self._model.converter
        self._w_ref, self._load_nm = w_ref, load_nm
        measured = control.get_feedback_signals(model)
        wanted = control.output(measured)
        control.update(measured, wanted)
        volt_seconds = 0j
        states = model.pwm(wanted.T_s, model.delay(wanted.d_abc))
        for lasts_s, state in zip(*states, strict=True):
            if lasts_s > 0.0:
                converter.inp.q_cs = state
                _runge_kutta(model, lasts_s)
                volt_seconds += lasts_s * converter.u_cs
        mean = volt_seconds / wanted.T_s
        turned = self._machine.state.exp_j_theta_m
        current = self._machine.i_s * turned
        out[columns.I_ALPHA], out[columns.I_BETA] = current.real, current.imag
        out[columns.U_ALPHA], out[columns.U_BETA] = mean.real, mean.imag
        out[columns.U_DC] = converter.u_dc
        out[columns.TORQUE] = self._machine.tau_M
        out[columns.SPEED] = self._mechanics.meas_speed()
        out[columns.ANGLE] = cmath.phase(turned) % (2.0 * math.pi)
        out[columns.LOAD] = load_nm


def _runge_kutta(model: Any, lasts_s: float) -> None:
    """Make one classical Runge-Kutta step with motulator's own right-hand side."""
    t, h = model.t0, lasts_s
    y = np.array(model.get_initial_values(), dtype=np.complex128)

    def slope(at: float, state: NDArray[np.complex128]) -> NDArray[np.complex128]:
        return np.array(model.rhs(at, state.tolist()), dtype=np.complex128)

    k_1 = slope(t, y)
    k_2 = slope(t + 0.5 * h, y + 0.5 * h * k_1)
    k_3 = slope(t + 0.5 * h, y + 0.5 * h * k_2)
    k_4 = slope(t + h, y + h * k_3)
    model.set_states((y + h / 6.0 * (k_1 + 2.0 * k_2 + 2.0 * k_3 + k_4)).tolist())
    model.t0 = t + h


def waveforms(scenario: Scenario) -> Array:
    """Rows (n, N, 10) of a whole run, columns `plant.OUT`; start angles are our simulator's.

    Raises ConfigError for rails, curves and open phases, which this drive cannot simulate.
    """
    other = any(event.kind == "phase_open" for event in scenario.event)
    if scenario.load.kind != "preset" or scenario.load.curve or other:
        raise ConfigError(scenario.title, ["only preset loads, without curve or open phase"])
    motor = MOTORS[scenario.motor.name]
    variety, (w_ref, w_acc, demand), carried = courses(scenario, periods(scenario))
    load = demand[:, None] * variety.share(0.0) * carried
    rolling = scenario.motion.start == "rolling"
    out = np.empty((*load.shape, OUT))
    out[:, :, columns.COMMAND] = (demand + motor.J * w_acc)[:, None]
    for d, theta in enumerate(start_angles(scenario).tolist()):
        wanted = w_ref / variety.p.wheel[d]
        w_0 = float(wanted[0]) if rolling else 0.0
        drive = Drive(motor, variety.p[d], w_0, theta, float(load[0, d]))
        for k, (w, nm) in enumerate(zip(wanted.tolist(), load[:, d].tolist(), strict=True)):
            drive.advance(w, nm, out[k, d])
    return out
