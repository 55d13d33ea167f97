"""One second of a simulated bus: its frames, and the gateway's time for each tick.

Filled by the ticks that `synthetic_loss` runs anyway. May know: frames. May not know: the DBC.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final

from dbc.frame import SECOND, Frame, Nanos
from gateway.io.canopen_node import CanopenNode

if TYPE_CHECKING:
    from gateway.core.gateway import Gateway
    from gateway.settings.config import Config

MEASURE_NS: Final[Nanos] = SECOND


class Measured:
    """Last second before the loss. frames: both sides'; times_us: the gateway's, for each tick."""

    def __init__(self, config: Config) -> None:
        self.frames: list[Frame] = []
        self.times_us: list[float] = []
        self._node = CanopenNode(config.nodes)

    def step(self, gateway: Gateway, batch: list[Frame], now: Nanos, begin: Nanos) -> None:
        """Use in place of `gateway.step(batch, now)`; the loss begins at `begin`."""
        began = time.perf_counter_ns()
        out = gateway.step(batch, now)
        took = time.perf_counter_ns() - began
        out += self._node.step(batch, now)
        if begin - MEASURE_NS < now <= begin:
            self.frames += [*batch, *out]
            self.times_us.append(took / 1e3)
