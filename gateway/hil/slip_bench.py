"""The slip-protection bench: one track, one controller, with a gateway on the bus or without.

On the bus, sensors, drives' ECUs and messages are the simulator's; only the plant is replaced by
the braking train. Without a gateway, the controller sees the plant directly: 20 times faster.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from dbc.codec import Codec
from gateway.core.gateway import Gateway
from gateway.hil.bench import VirtualBus
from gateway.hil.fitting import fitting
from gateway.hil.simbus import run_on_bus
from gateway.hil.slip_controllers import CreepControl, FlagLaw, Timid, late, none, oracle
from gateway.hil.slip_plant import MOTOR, START_M_S, TRAIN, BrakingTrain, Controller, Moment
from gateway.hil.slip_rails import AXLES, Track
from gateway.hil.slip_score import Score, score
from gateway.io.bus import open_present
from gateway.io.live import Stop
from gateway.io.permission import drives_only
from gateway.settings.config import Config
from sim.physics.plant import MOTORS
from sim.scenario import Scenario, parse
from sim.simulation import Simulation

LONGEST_S: Final = 60.0
"""A run that has not stopped by then is scored up to this time."""
OURS: Final = "gateway"


class Run(NamedTuple):
    """One run of a track under a controller, with its score."""

    track: Track
    controller: str
    moments: list[Moment]
    score: Score


CONTROLLERS: Final[dict[str, Callable[[int], Controller]]] = {
    "oracle": lambda _seed: oracle,
    "creep": lambda _seed: CreepControl(),
    "late": late,
    "timid": Timid,
    "none": lambda _seed: none,
}
"""Factories, from a seed, of the controllers that need no bus, by name."""


def ride(track: Track, controller: Controller, name: str) -> Run:
    """One run without a bus."""
    moments = BrakingTrain(track, controller).run(LONGEST_S)
    return Run(track, name, moments, score(track, moments))


def scenario_of(track: Track, duration_s: float = LONGEST_S) -> Scenario:
    """Scenario of a track for the simulator's sensors, ECUs and bus."""
    silent = [{"kind": "silent", "at_s": 0.0, "drive": track.cut_out + 1}]
    electrical = START_M_S / TRAIN.wheel_radius_m * MOTORS[MOTOR].pole_pairs
    return parse({
        "title": track.title, "drives": AXLES, "duration_s": duration_s, "slip_limiter": "none",
        "motor": {"name": MOTOR}, "motion": {"speed": electrical}, "bus": {"bitrate": 0},
        "load": {"kind": "rail", "wheel": list(track.wheel)},
        "event": silent if track.cut_out >= 0 else [],
    })  # fmt: skip


class Bench(Simulation):
    """The simulated drives of a track, whose torque follows the flags on the bus."""

    def __init__(self, track: Track, codec: Codec, *, self_start: bool = False) -> None:
        """The drives act on the flags by `FlagLaw`."""
        super().__init__(scenario_of(track), codec, self_start=self_start)
        self.train = BrakingTrain(track, FlagLaw(), self._flags)
        self._plant = self.train

    def _flags(self) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
        """(N,) flag of each drive as its ECU has received it; 0: unknown."""
        return np.array([ecu.flag(self._now_ns) for ecu in self._ecus])


def configured(track: Track) -> tuple[Config, Codec]:
    """The gateway's configuration for the bench's drives."""
    return fitting(None, scenario_of(track))


def ride_with_gateway(track: Track, longest_s: float = LONGEST_S) -> Run:
    """One run with our gateway on a virtual bus."""
    config, codec = configured(track)
    bench = Bench(track, codec)
    bus = VirtualBus(bench, Gateway(config, codec, 0))
    for _ in range(round(longest_s * config.loop.rate_hz) + 1):
        bus.step()
        bench.truth_rows()  # discarded, as they are not used
        if bench.train.stopped:
            break
    moments = bench.train.moments
    return Run(track, OURS, moments, score(track, moments))


def ride_on_bus(track: Track, options: Namespace) -> Run:
    """One run in real time against a device on the bus of `options` (-i, -c).

    The drives go Operational by themselves. Raises `Ended` if a signal came first.
    """
    _, codec = configured(track)
    bench = Bench(track, codec, self_start=True)
    transport = open_present(options, drives_only(codec, bench.nodes))
    stop = Stop()

    def after_step() -> None:
        bench.truth_rows()  # discarded, as they are not used
        if bench.train.stopped:
            stop()

    run_on_bus(bench, transport, LONGEST_S, after_step, stop)
    if stop.ended is not None:
        raise stop.ended
    return Run(track, "device", bench.train.moments, score(track, bench.train.moments))
