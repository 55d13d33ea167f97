"""Detection figures on random single losses: tuned on one set of seeds, reported on another."""

from __future__ import annotations

from gateway.commands.common import prepare
from gateway.core import Gateway
from gateway.results.expect import FlagTrack
from gateway.results.scoring import Score, score_run
from sim.random_runs import random_scenario
from sim.simulation import Simulation

DEVELOPMENT = range(30)
"""Seeds that thresholds may be tuned on."""
REPORTING = range(1000, 1060)
"""Seeds that nobody looks at before reporting."""


def run(
    seed: int, dbc: str = "traction.dbc", *, healthy: bool = False, detector: str = "vb"
) -> Score:
    """One random run in open loop, as a recorded log would be: simulate, step, score."""
    config, codec = prepare(None, dbc={"file": dbc}, adhesion={"detector": detector})
    scenario = random_scenario(seed, healthy=healthy)
    simulation = Simulation(scenario, codec, self_start=True)
    gateway = Gateway(config, codec, 0)
    track = FlagTrack(codec, config.nodes)
    truth = []
    for tick in range(round(scenario.duration_s * config.loop.rate_hz) + 1):
        now = tick * config.loop.period_ns
        track.add(gateway.step(simulation.step((), now), now))
        truth += simulation.truth_rows()
    return score_run(truth, track, config.nodes)


def pooled(seeds: range, dbc: str = "traction.dbc", *, healthy: bool = False,
           detector: str = "vb") -> Score:  # fmt: skip
    """All runs of a set together."""
    total = Score()
    for seed in seeds:
        total = total.plus(run(seed, dbc, healthy=healthy, detector=detector))
    return total


def rows() -> list[tuple[str, ...]]:
    """One row per set: what, seeds, F1, good share, median delay, missed, raised on healthy."""
    table = []
    for name, seeds, dbc, detector in (
        ("2 ms classic, vb, development", DEVELOPMENT, "traction.dbc", "vb"),
        ("2 ms classic, vb, reporting", REPORTING, "traction.dbc", "vb"),
        ("2 ms classic, median, reporting", REPORTING, "traction.dbc", "median"),
        ("8 kHz FD, vb, reporting", REPORTING[:20], "traction_fd.dbc", "vb"),
    ):
        lossy = pooled(seeds, dbc, detector=detector)
        healthy = pooled(seeds[:20], dbc, healthy=True, detector=detector)
        table.append(
            (
                name,
                f"{seeds.start}-{seeds.stop - 1}",
                f"{lossy.f1:.4f}",
                f"{lossy.good_share:.4f}",
                f"{lossy.median_delay_ms:.0f}",
                f"{lossy.missed} of {lossy.missed + len(lossy.delays_ms)}",
                f"{healthy.false_positive} of {healthy.healthy}",
            )
        )
    return table


HEADER = ("set", "seeds", "F1", "healthy frames `Adhering`", "median delay / ms", "losses missed",
          "`AdhesionLost` frames in 20 healthy runs")  # fmt: skip
