"""The bench of a test on a bus in real time, tick by tick as on a `VirtualBus`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dbc.codec import Codec
from dbc.frame import Nanos
from gateway.core.gateway import Gateway
from gateway.hil.bench import Alter, Tick, unaltered
from gateway.hil.simbus import newest
from gateway.io.bus import open_present
from gateway.io.canopen_node import CanopenNode, meant
from gateway.io.realtime import Ticker
from gateway.io.transport import Allow
from gateway.settings.config import Config
from sim.simulation import Simulation


class BusWorld:
    """The bench in real time on any python-can interface, with our own or an external gateway."""

    def __init__(
        self,
        simulation: Simulation,
        config: Config,
        codec: Codec,
        bus: Mapping[str, Any],
        alter: Alter = unaltered,
        *,
        own_gateway: bool = True,
    ) -> None:
        """bus: python-can's options. Raises ConfigError for a bus that cannot be opened.

        alter: an external gateway's frames are altered after they were received.
        """
        self.simulation, self._alter = simulation, alter
        self.period_ns = config.loop.period_ns
        self._ticker = Ticker(self.period_ns)
        self._gateway_ids = {spec.can_id for spec in codec.messages if spec.is_gateway}
        self._core: Gateway | None = None
        if own_gateway:
            self._core = Gateway(config, codec, self._ticker.clock())
            creep = config.adhesion.send_creep
            allow = Allow.from_codec(codec, config.nodes, nmt_master=True, creep=creep)
            self._theirs = open_present(bus, allow)
            self._node = CanopenNode(config.nodes, nmt_master=True)
        self._bus = open_present(bus)
        self._start: Nanos | None = None

    @property
    def missed(self) -> int:
        """Ticks that came too late to be simulated."""
        return self._ticker.missed

    def step(self) -> Tick:
        """Advance by one period."""
        now = self._ticker.wait().now_ns
        if self._start is None:
            self._start = now
        start = self._start
        received = list(self._bus.receive().frames())
        frames = newest(self.simulation.step(received, now - start))
        for frame in frames:
            self._bus.send(frame)
        self._answer()
        answers = [
            f._replace(t_ns=max(f.t_ns - start, 0))
            for f in received
            if f.can_id in self._gateway_ids
        ]
        if self._core is None:
            answers = self._alter(answers, now - start)
        return Tick(now - start, frames, answers)

    def _answer(self) -> None:
        """Run a tick of our own gateway, if there is one."""
        if self._core is None:
            return
        block = self._theirs.receive()
        now = self._ticker.clock()
        sent = self._alter(self._core.step(block, now), now)
        for frame in sent + self._node.step(meant(block), now):
            self._theirs.send(frame)

    def close(self) -> None:
        """Leave the bus."""
        self._bus.close()
        if self._core is not None:
            self._theirs.close()
