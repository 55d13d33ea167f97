"""The bench: simulated drives and the gateway together on a virtual clock.

The core is the same as live and in replay; here its frames come from `sim`, and its own frames go
back to `sim`, which closes the loop. Faster than real time, and the same on every run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import TYPE_CHECKING, Final, NamedTuple

from dbc.codec import Codec
from dbc.frame import Frame, Nanos
from gateway.core.gateway import Gateway
from gateway.io.canopen_node import CanopenNode
from gateway.reports.expectations import FlagTrack, Verdict, judge
from gateway.settings.config import Config
from sim.scenario import Scenario
from sim.simulation import Simulation

if TYPE_CHECKING:
    from dbc.secoc_receiver import Verifier
    from dbc.secoc_sender import Authenticator
    from gateway.reports.reporting import Reporting

Alter = Callable[[list[Frame], Nanos], list[Frame]]
"""(frames that a gateway sends, now) -> the frames on the bus instead."""
Watch = Callable[[Nanos, list[Frame], list[Frame], Gateway], None]
"""(now, frames from the drives, frames from the gateway, the gateway)"""


class Tick(NamedTuple):
    """Frames on the bus in one tick; stamps count from the start of the bench."""

    now_ns: Nanos
    drives: list[Frame]
    gateway: list[Frame]


def unaltered(frames: list[Frame], _now: Nanos) -> list[Frame]:
    """The unmodified gateway."""
    return frames


class VirtualBus:
    """Drives and a gateway, which starts them, on a virtual clock that starts at 0."""

    missed: Final = 0
    """Ticks that came too late: none, since the clock waits."""

    def __init__(self, simulation: Simulation, gateway: Gateway, alter: Alter = unaltered) -> None:
        """The gateway must not have run yet."""
        self.simulation, self._gateway, self._alter = simulation, gateway, alter
        self._node = CanopenNode(gateway.nodes, nmt_master=True)
        self._now: Nanos = 0
        self._sent: list[Frame] = []

    def step(self) -> Tick:
        """Run the next tick of both sides."""
        now, self._now = self._now, self._now + self._gateway.config.loop.period_ns
        came = self.simulation.step(self._sent, now)
        self._sent = self._alter(self._gateway.step(came, now), now) + self._node.step(came, now)
        return Tick(now, came, self._sent)

    def close(self) -> None:
        """Do nothing: there is no bus to leave."""


class Outcome(NamedTuple):
    """Result of a scenario."""

    scenario: Scenario
    verdicts: list[Verdict]
    gateway: Gateway
    overload: str = ""
    """Evidence that the machine was too slow for real time; a failure is then inconclusive."""

    @property
    def passed(self) -> bool:
        """Whether every expectation held."""
        return all(v.passed for v in self.verdicts)

    @property
    def inconclusive(self) -> bool:
        """Whether an expectation failed on a machine that could not keep up."""
        return bool(self.overload) and not self.passed


def touched_drives(scenario: Scenario) -> set[int]:
    """Drives to which an event applies; `all` means every drive."""
    return {drive for event in scenario.event for drive in scenario.drives_of(event.drive)}


def both_sides(key: bytes | None) -> tuple[Authenticator | None, Callable[[], Verifier] | None]:
    """Sender, and a factory of drives' receivers that accept no freshness before its first."""
    if key is None:
        return None, None
    from dbc.secoc_receiver import Verifier
    from dbc.secoc_sender import Authenticator

    sender = Authenticator(key, 1)
    return sender, partial(Verifier, key, sender.freshness)


def run_virtual(
    scenario: Scenario,
    config: Config,
    codec: Codec,
    watch: Iterable[Watch] = (),
    key: bytes | None = None,
    left: Reporting | None = None,
) -> Outcome:
    """Run on the virtual clock, starting at 0. Raises ConfigError as `Gateway` does.

    The gateway starts the drives even if the configuration does not make it NMT master.
    key: authenticates the flags; the drives then accept no others. left: records the run for a
    report.
    """
    watch = tuple(watch)
    authenticator, verifier = both_sides(key)
    simulation = Simulation(scenario, codec, self_start=False, verifier=verifier)
    gateway = Gateway(config, codec, 0, authenticator)
    if left is not None:
        left.begin(gateway)
    bus, track = VirtualBus(simulation, gateway), FlagTrack(codec, config.nodes)
    for _ in range(round(scenario.duration_s * config.loop.rate_hz) + 1):
        tick = bus.step()
        rows = simulation.truth_rows()
        if left is not None:
            left.add_truth(rows)
        track.store(tick.gateway)
        for look in watch:
            look(*tick, gateway)
        if left is not None:
            left.add_tick()
    verdicts = judge(scenario.expect, track, touched_drives(scenario), 0)
    return Outcome(scenario, verdicts, gateway)
