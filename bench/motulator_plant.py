"""`python -m bench.motulator_plant`: the gateway on a machine that nobody here wrote.

The same random runs with three drives of `motulator` (PyPI) and with our own, each into a candump
log, which is replayed. Of motulator are the machine (flux equations in rotor coordinates), the
mechanics, the inverter, the modulator with its delay, and the control: speed, current reference
and current vector control with its own gains, at its own current bandwidth. Of ours are the
scenario (load and speed wanted, held over 125 us), sensors, messages and bus.

Two things are given to it: it rolls at the start (controllers preloaded, as in our simulator, else
a run begins with a shock), and the speed bandwidth. 60 rad/s gives motulator's controller the
gains of ours: 2 alpha J = 120 J, alpha^2 J = 3600 J; its own default is 25 rad/s (4 Hz).
"""

from __future__ import annotations

import argparse
import cmath
import math
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.motulator_log import (
    LEGEND,
    Judged,
    cells,
    judge,
    replay_log,
    table,
    write_log,
)
from dbc.codec import bind
from gateway.settings.config import ConfigError, parse
from gateway.study.held_world import OtherMachine, periods
from gateway.study.scenarios_family import ALL, draw
from sim.drive_spread import Variety
from sim.faults import Schedule
from sim.physics import plant as columns
from sim.physics.plant import DT, MOTORS, OUT, Motor
from sim.profile import Profile
from sim.scenario import Scenario
from sim.simulation import ANGLE_STREAM, Simulation

Array = NDArray[np.float64]
OVERLOAD: Final = 1.5
"""Most torque and current, of the rated, as in our simulator."""
HELP: Final = "pip install -e .[verify]"


class Setup(NamedTuple):
    """What may be chosen of motulator's drive. `speed_bandwidth` rad/s."""

    speed_bandwidth: float
    switching: bool
    solver: str


class Drive:
    """One drive made of motulator's parts."""

    def __init__(
        self, motor: Motor, p: np.record, w_0: float, theta_0: float, load_0: float, setup: Setup
    ) -> None:
        """Rolling at `w_0` rad/s (rotor), electrical angle `theta_0` rad, `load_0` Nm met.

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
        believed = SynchronousMachinePars(
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
        if setup.switching:
            self._model.pwm = model.CarrierComparison()
        self._solve = SOLVERS[setup.solver]
        limits = sm.CurrentReferenceCfg(
            believed,
            max_i_s=OVERLOAD * motor.I_rated,
            nom_w_m=motor.U_dc / math.sqrt(3.0) / motor.psi_pm,
        )
        control = sm.CurrentVectorControl(believed, limits, T_s=DT, sensorless=False)
        speed = sm.SpeedController(motor.J, setup.speed_bandwidth, OVERLOAD * motor.T_rated)
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
        """One period of 125 us; `out` (10,) gets its row, voltages their mean."""
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
                self._solve(model, lasts_s)
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
    """One classical Runge-Kutta step over motulator's own right-hand side."""
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


def _solve_ivp(model: Any, lasts_s: float) -> None:
    """As motulator's own loop does it."""
    from scipy.integrate import solve_ivp

    span = (model.t0, model.t0 + lasts_s)
    solution = solve_ivp(model.rhs, span, model.get_initial_values())
    model.set_states(solution.y[:, -1].tolist())
    model.t0 = span[1]


SOLVERS: Final[dict[str, Callable[[Any, float], None]]] = {
    "rk4": _runge_kutta, "solve_ivp": _solve_ivp,
}  # fmt: skip
"""rk4: one step per switching state; solve_ivp: motulator's own choice, 2.5 times the time."""


def waveforms(scenario: Scenario, setup: Setup) -> Array:
    """(n, N, 10) rows of a whole run, columns `plant.OUT`; start angles are our simulator's.

    Raises ConfigError for what motulator's drive does not know here: rails, curves, open phases.
    """
    other = any(event.kind == "phase_open" for event in scenario.event)
    if scenario.load.kind != "preset" or scenario.load.curve or other:
        raise ConfigError(scenario.title, ["only preset loads, without curve or open phase"])
    motor = MOTORS[scenario.motor.name]
    variety = Variety(scenario, motor)
    t_s: Array = DT * np.arange(periods(scenario), dtype=np.float64)
    w_ref, w_acc, demand = Profile(scenario, motor.pole_pairs).at(t_s)
    load = demand[:, None] * variety.share(0.0) * Schedule(scenario, motor).carry(t_s, demand)
    rolling = scenario.motion.start == "rolling"
    out = np.empty((len(t_s), scenario.drives, OUT))
    out[:, :, columns.COMMAND] = (demand + motor.J * w_acc)[:, None]
    for d in range(scenario.drives):
        theta = np.random.default_rng([scenario.seed, ANGLE_STREAM, d]).uniform(0.0, 2.0 * math.pi)
        wanted = w_ref / variety.p.wheel[d]
        w_0 = float(wanted[0]) if rolling else 0.0
        drive = Drive(motor, variety.p[d], w_0, float(theta), float(load[0, d]), setup)
        for k, (w, nm) in enumerate(zip(wanted.tolist(), load[:, d].tolist(), strict=True)):
            drive.advance(w, nm, out[k, d])
    return out


def _judged(scenario: Scenario, dbc: str, rows: Array | None, folder: Path) -> Judged:
    """A run through a log and a replay; `rows` None: our own machine."""
    nodes = tuple(range(1, scenario.drives + 1))
    drives = [{"node": node, "motor": scenario.motor.name} for node in nodes]
    config = parse({"dbc": {"file": dbc}, "drive": drives})
    codec = bind(config.dbc_path, nodes)
    log = folder / "run.log"
    simulation = (
        Simulation(scenario, codec) if rows is None else OtherMachine(scenario, codec, rows)
    )
    truth = write_log(simulation, log)
    return judge(truth, replay_log(log, config, codec), codec)


def _measure(options: argparse.Namespace, folder: Path) -> list[list[str]]:
    """Lines of the table; a line per run goes to stderr as it comes."""
    setup = Setup(options.speed_bandwidth, options.inverter == "switching", options.solver)
    total: dict[tuple[str, str, str], Judged] = {}
    for family in options.family:
        for seed in options.seeds:
            scenario = draw(family, seed)
            rows = waveforms(scenario, setup)
            for dbc in options.dbc:
                for machine, played in (("motulator", rows), ("ours", None)):
                    run = _judged(scenario, dbc, played, folder)
                    line = cells((machine, family, dbc), 1, run)
                    print(f"{seed}: {' '.join(line)}", file=sys.stderr, flush=True)
                    key = machine, family, dbc
                    total[key] = total.get(key, Judged()).plus(run)
    return [cells(names, len(options.seeds), judged) for names, judged in total.items()]


def _report(options: argparse.Namespace, lines: list[list[str]]) -> str:
    """All of it as Markdown, with what it takes to make it again."""
    setup = (
        f"Seeds {options.seeds.start}-{options.seeds.stop - 1}; of motulator {options.inverter} "
        f"voltage, speed bandwidth {options.speed_bandwidth:g} rad/s, solver {options.solver}."
    )
    return f"# The machine of motulator and ours\n\n{setup}\n\n{table(lines)}\n\n{LEGEND}"


def _seeds(text: str) -> range:
    first, dash, last = text.partition("-")
    digits = first.isdecimal() and (last.isdecimal() or not dash)
    seeds = range(int(first), int(last or first) + 1) if digits else range(0)
    if not seeds:
        raise argparse.ArgumentTypeError(f"{text!r} is not A or A-B")
    return seeds


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; exit code 2 without motulator or for a run that it does not know."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("--seeds", type=_seeds, default="1000-1019", metavar="A-B")
    parser.add_argument("--family", nargs="+", choices=sorted(ALL), default=["single"],
                        metavar="NAME", help="with preset loads (default: single)")  # fmt: skip
    parser.add_argument("--dbc", nargs="+", default=["traction.dbc"], metavar="FILE")
    parser.add_argument("--speed-bandwidth", type=float, default=60.0, metavar="RAD_S",
                        help="of motulator's speed control (default: 60)")  # fmt: skip
    parser.add_argument("--inverter", choices=("mean", "switching"), default="mean",
                        help="mean voltage per period, or each switching state")  # fmt: skip
    parser.add_argument("--solver", choices=tuple(SOLVERS), default="rk4")
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help="also DIR/motulator.md")
    options = parser.parse_args(arguments)
    try:
        import motulator.drive.model  # noqa: F401 - only whether it is there
    except ImportError as error:
        print(f"motulator cannot be imported ({error}): {HELP}", file=sys.stderr)
        return 2
    try:
        with tempfile.TemporaryDirectory() as folder:
            lines = _measure(options, Path(folder))
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    text = _report(options, lines)
    print(text)
    if options.output:
        options.output.mkdir(parents=True, exist_ok=True)
        (options.output / "motulator.md").write_text(text + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
