"""The bench of a test: simulated inverters, a gateway, a bus. Only the test lets time pass."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final

from dbc.codec import Codec
from dbc.frame import SECOND, Frame, Nanos
from gateway.core.gateway import Gateway
from gateway.hil.bench import Alter, Tick, VirtualBus, unaltered
from gateway.hil.pytest.flags import GatewayFlags
from gateway.hil.pytest.inverter import Inverter
from gateway.hil.pytest.world import BusWorld
from gateway.settings.config import Config
from sim.scenario import Scenario
from sim.simulation import Simulation

if TYPE_CHECKING:
    from gateway.hil.mutants import Mutant

KEPT: Final = 2000
"""Frames that are kept for display."""
SETTLE_S: Final = 5.0
"""Time after which a bench whose flags are not all good is at fault itself."""


class HilBench:
    """Inverters and gateway together. Time passes only in the `run` methods and `settle`.

    On a bus the gateway is this process's own, or an external one (`own_gateway=False`).
    """

    def __init__(
        self,
        scenario: Scenario,
        config: Config,
        codec: Codec,
        bus: Mapping[str, Any] | None = None,
        mutant: Mutant | None = None,
        *,
        own_gateway: bool = True,
    ) -> None:
        """bus: python-can's options; None: the virtual clock. Raises ConfigError.

        mutant: the gateway has this fault.
        """
        own = own_gateway or bus is None
        alter: Alter = unaltered
        if mutant is not None:
            from gateway.hil.mutants import Altered

            config = config if mutant.settings is None else mutant.settings(config)
            alter = Altered(mutant, codec, config.nodes)
        simulation = Simulation(scenario, codec, self_start=not own)
        self._world: VirtualBus | BusWorld
        if bus is None:
            self._world = VirtualBus(simulation, Gateway(config, codec, 0), alter)
        else:
            self._world = BusWorld(simulation, config, codec, bus, alter, own_gateway=own_gateway)
        self.codec, self.config, self.scenario = codec, config, scenario
        self.nodes = simulation.nodes
        self.frames: deque[Frame] = deque(maxlen=KEPT)
        """The last frames on the bus, of drives and gateway, oldest first."""
        self.lost: dict[int, deque[tuple[Nanos, bool]]] = {
            node: deque(maxlen=KEPT) for node in self.nodes
        }
        """Latest ground truth by node, every 10 ms: stamp, and whether adhesion is lost."""
        self.now_ns: Nanos = 0
        self.flags = GatewayFlags(self)
        self.inverter = Inverter(simulation, lambda: self.now_s)

    @property
    def now_s(self) -> float:
        """Seconds since the start of the bench."""
        return self.now_ns / SECOND

    @property
    def missed(self) -> int:
        """Ticks that this process came too late for: on a bus, time does not wait for the test."""
        return self._world.missed

    def run(self, seconds: float) -> None:
        """Let `seconds` pass."""
        end = self.now_ns + round(seconds * SECOND)
        while self.now_ns < end:
            self._step()

    def run_until(self, met: Callable[[], bool], within_s: float) -> bool:
        """Let time pass until `met()`, at most `within_s`; return whether it was met."""
        end = self.now_ns + round(within_s * SECOND)
        while not met():
            if self.now_ns >= end:
                return False
            self._step()
        return True

    def settle(self, within_s: float = SETTLE_S) -> None:
        """Run until every adhesion flag is good. Raises AssertionError if one takes too long."""
        for node in self.nodes:
            self.flags.expect_adhering(drive=node, within_ms=1000.0 * within_s)

    def close(self) -> None:
        """Leave the bus."""
        self._world.close()

    def _step(self) -> None:
        tick: Tick = self._world.step()
        self.now_ns = tick.now_ns
        self.frames.extend(sorted([*tick.drives, *tick.gateway]))
        self.flags.track.store(tick.gateway)
        for row in self._world.simulation.truth_rows():
            self.lost[row.drive].append((round(row.t_s * SECOND), bool(row.lost)))


def scenario_of(tables: Mapping[str, Any], title: str) -> Scenario:
    """A scenario for a bench: three drives at constant speed on dry rail, changed by `tables`.

    Raises ScenarioError with every problem.
    """
    from sim.scenario import parse

    return parse({"title": title, "duration_s": 1e6, **tables}, "hil marker")
