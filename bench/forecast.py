"""Delays that `check --forecast` predicts, and those of random simulated runs.

    python -m bench.forecast [--seeds 5000-5199]

Each seed is one run with drives, motor, message set, cycles, speed, torque, loss and noise of its
own. It was written with seeds below 1000.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from dbc.codec import Codec, bind
from dbc.frame import MS, SECOND
from gateway.commands.check import LOAD_LIMIT_PERCENT, bus_load
from gateway.core.codes import Flag
from gateway.core.gateway import Gateway
from gateway.hil.forecast import LIMIT_NS, Forecast
from gateway.hil.synthetic_loss import simulated
from gateway.settings.config import BENCH_MOTOR, Config, parse, shipped_dbc
from sim.scenario import parse as scenario
from sim.simulation import Simulation

BEGIN_S = 3.0
NEAR, TICK_MS = 0.2, 10.0
MECHANICAL = 4.0
"""rad/s2 of a rotor where the train accelerates with 1 m/s2. A speed that is quite constant has one
rounding error for good, and the load observer no noise."""


class Run(NamedTuple):
    """What is random in one run. w_e: rad/s electrical; torque: share of the rated one."""

    seed: int
    config: Config
    codec: Codec
    w_e: float
    torque: float
    loss: float
    begin_s: float
    m_s2: float

    @property
    def name(self) -> str:
        c = self.config
        cycle = min(
            s.cycle_ns for s in self.codec.messages if s.kind in ("PhaseCurrents", "Samples")
        )
        return (
            f"{self.seed} {len(c.nodes)} x {c.drive[0].motor:<14} {cycle / MS:g} ms "
            f"{self.w_e:4.0f} rad/s torque {self.torque:3.0%} loss {self.loss:4.0%} "
            f"noise {c.estimator.current_noise_var:.1e}"
        )

    def with_cycle(self, cycle_ns: int) -> Run:
        """Currents and voltages of a classic bus come this often."""
        fast = ("PhaseCurrents", "StatorVoltages")
        specs = self.codec.messages
        specs = [replace(s, cycle_ns=cycle_ns) if s.kind in fast else s for s in specs]
        return self._replace(codec=Codec(self.codec.path, specs, self.codec.digest))


def draw(seed: int) -> Run:
    rng = np.random.default_rng(seed)
    motor = str(rng.choice(["bench", "traction_350kw"]))
    dbc = str(rng.choice(["traction.dbc", "traction.dbc", "traction_fd.dbc"]))
    noise = float(10.0 ** rng.uniform(-4.7, -2.0))
    most = 6 if dbc == "traction.dbc" else 4
    drives = [
        {"node": k + 1, "motor": motor} for k in range(min(most, rng.choice([1, 2, 3, 4, 6])))
    ]
    config = parse({
        "drive": drives, "dbc": {"file": dbc}, "estimator": {"current_noise_var": noise},
    })  # fmt: skip
    codec = bind(shipped_dbc(dbc), config.nodes)
    cycle = int(rng.choice([1, 2, 2, 4])) * MS
    w_e, torque = float(rng.uniform(30.0, 500.0)), float(rng.uniform(0.25, 1.0))
    loss = float(rng.uniform(0.12, 1.0))
    begin_s, m_s2 = BEGIN_S + 0.1 * float(rng.uniform()), float(rng.uniform(-1.0, 1.0))
    run = Run(seed, config, codec, w_e, torque, loss, begin_s, m_s2)
    while bus_load((made := run.with_cycle(cycle)).codec, config) > LOAD_LIMIT_PERCENT:
        cycle *= 2
    return made


def forecasts_ms(run: Run) -> np.ndarray:
    """Cases of the forecast; infinite: not found. NaN: no forecast."""
    pairs = run.config.motors[run.config.drive[0].motor].pole_pairs
    try:
        made = Forecast(run.config, run.codec, run.w_e / pairs, run.torque)
    except ValueError as error:
        print(f"{run.name}: {error}")
        return np.full(1, math.nan)
    return made.delays_ms(0, run.loss)


def measured_ms(run: Run) -> float:
    """From the loss to the tick of the flag in the simulator; infinite: not found.

    NaN: the flag was not good before.
    """
    config, motor = run.config, run.config.motors[run.config.drive[0].motor]
    load, share = run.torque * motor.T_rated, motor.I_rated / BENCH_MOTOR.I_rated
    slope = BEGIN_S * max(
        -0.1 * run.w_e, min(0.1 * run.w_e, run.m_s2 * MECHANICAL * motor.pole_pairs)
    )
    first = config.nodes[0]
    loss = {"at_s": run.begin_s, "drive": first, "kind": "adhesion_loss", "depth": run.loss}
    described = scenario({
        "title": "forecast", "seed": run.seed, "event": [loss], "duration_s": BEGIN_S + 1.0,
        "nodes": list(config.nodes), "thermal": {"start": "ambient"},
        "load": {"kind": "preset", "torque_nm": load, "wheel_within": 0.01},
        "motion": {"profile": [[0.0, run.w_e - slope], [2.0 * BEGIN_S, run.w_e + slope]]},
        "sensors": {"current_noise_var": config.estimator.current_noise_var * share**2,
                    "current_range_a": 100.0 * motor.I_rated},
    })  # fmt: skip
    plant = simulated(motor, run.w_e / motor.pole_pairs, load)
    drives = Simulation(described, run.codec, motor=plant)
    gateway, period = Gateway(config, run.codec, 0), config.loop.period_ns
    begin = run.begin_s * SECOND
    for now in range(period, int(begin) + LIMIT_NS + 1, period):
        before = gateway.flags.adhesion["state"].copy() if now > period else np.zeros(1)
        gateway.step(drives.step((), now), now)
        if now - period <= begin < now and (before != Flag.GOOD).any():
            return math.nan
        if now > begin and gateway.flags.adhesion["state"][0] == Flag.BAD:
            return (now - begin) / MS
    return math.inf


def main() -> None:
    """Print every run, then the summary."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="5000-5199")
    first, last = map(int, parser.parse_args().seeds.split("-"))
    rows, spread = [], []
    for seed in range(first, last + 1):
        run = draw(seed)
        cases, was = forecasts_ms(run), measured_ms(run)
        median = float(np.median(cases))
        print(f"{run.name}: forecast {median:5.0f} ms, measured {was:5.0f} ms", flush=True)
        rows.append((median, was))
        if math.isfinite(median):
            spread.append(float((abs(cases / median - 1.0) <= NEAR).mean()))
    summarise(*np.array(rows).T, spread)


def summarise(forecast: np.ndarray, measured: np.ndarray, spread: list[float]) -> None:
    """Print what came of all runs. spread: share of each forecast's own cases near its median."""
    known = ~np.isnan(forecast) & ~np.isnan(measured)
    found, seen = np.isfinite(forecast) & known, np.isfinite(measured) & known
    both = found & seen
    predicted, was = forecast[both], measured[both]
    near = abs(predicted / was - 1.0) <= NEAR
    quartiles = np.quantile(predicted / was, (0.25, 0.5, 0.75))
    print(f"runs {len(known)}; judged before the loss {known.sum()}; found by both {both.sum()}, "
          f"by neither {(known & ~found & ~seen).sum()}, only forecast {(found & ~seen).sum()}, "
          f"only in the run {(seen & ~found).sum()}")  # fmt: skip
    print("forecast / measured: quartiles {:.3f}, {:.3f}, {:.3f}; ".format(*quartiles)
          + f"mean delays {predicted.mean():.1f} and {was.mean():.1f} ms")  # fmt: skip
    print(f"within 20 %: {near.sum()} of {both.sum()}; within 20 % or one tick: "
          f"{(near | (abs(predicted - was) <= TICK_MS)).sum()}; the forecast's own cases "
          f"are within 20 % of their median in {np.mean(spread):.0%}")  # fmt: skip


if __name__ == "__main__":
    main()
