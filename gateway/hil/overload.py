"""Whether a machine kept up with a scenario in real time: if not, a failure is inconclusive."""

from __future__ import annotations

import numpy as np

from dbc.frame import MS, Nanos
from gateway.core.gateway import Gateway
from gateway.io.live import LiveSnapshot
from sim.scenario import Scenario

ON_THE_WIRE = ("silent", "frame_loss", "corrupt")
"""Events that by themselves make a drive's samples late or lost."""
MOST_LATE_NS: Nanos = 5 * MS
"""Largest lateness of samples, usual or current, on a machine that keeps up: half a tick."""


class Overload:
    """Evidence, gathered tick by tick, that gateway or drives did not get enough processor time."""

    def __init__(self, scenario: Scenario, tick_ns: Nanos) -> None:
        """Check the drives' samples for lateness, unless the scenario itself delays them."""
        self._tick_ns = tick_ns
        self._drives = not any(event.kind in ON_THE_WIRE for event in scenario.event)
        self._missed_before: int | None = None
        self._missed = 0
        self._late_ns = 0

    def look(self, gateway: Gateway, seen: LiveSnapshot) -> None:
        """Take one tick in which the drives are on the bus."""
        if self._missed_before is None:
            self._missed_before = seen.missed
        self._missed = seen.missed - self._missed_before
        if self._drives:
            drives = gateway.inbox.receiver.drives
            sampled = drives[drives["sample_ns"] >= 0]
            # At its end, samples may be up to a tick old; older means that newer ones are overdue.
            away_ns = seen.now_ns - sampled["sample_ns"] - self._tick_ns
            late_ns = np.maximum(sampled["clock"]["usual_ns"], away_ns)
            self._late_ns = max(self._late_ns, int(late_ns.max(initial=0)))

    def __str__(self) -> str:
        """The evidence in words; empty if the machine kept up."""
        found = []
        if self._missed:
            found.append(f"the gateway missed {self._missed} ticks")
        if self._late_ns > MOST_LATE_NS:
            found.append(f"the drives' samples came up to {self._late_ns / MS:.0f} ms late")
        return " and ".join(found)
