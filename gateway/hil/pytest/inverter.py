"""The simulated inverters in a test, with faults that start now and last for a given time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

from sim.scenario import Event
from sim.simulation import Simulation


class Inverter:
    """All drives of the bench; `drive` is a number from 1 or "all"."""

    def __init__(self, simulation: Simulation, now_s: Callable[[], float]) -> None:
        """Made by the bench, whose time `now_s` tells."""
        self._simulation, self._now_s = simulation, now_s

    def fault(
        self,
        kind: str,
        drive: int | Literal["all"] = "all",
        *,
        for_s: float | None = None,
        **more: Any,
    ) -> None:
        """An event of `sim.scenario` from now on: `depth`, `value`, `sensor`, `ramp_s` as there.

        for_s: seconds; None: for good. Raises ValueError for an event that cannot be.
        """
        fields = {"at_s": self._now_s(), "for_s": for_s, "drive": drive, "kind": kind, **more}
        self._simulation.inject(Event.model_validate(fields))

    def lose_adhesion(
        self, drive: int | Literal["all"], depth: float = 1.0, for_s: float | None = None
    ) -> None:
        """The rail carries (1 - depth) of what this wheel is to pull."""
        self.fault("adhesion_loss", drive, depth=depth, for_s=for_s)

    def silence(self, drive: int | Literal["all"], for_s: float | None = None) -> None:
        """The drive leaves the bus, its heartbeat too."""
        self.fault("silent", drive, for_s=for_s)

    def lose_frames(
        self, drive: int | Literal["all"], share: float, for_s: float | None = None
    ) -> None:
        """Each frame of the drive is lost with this probability."""
        self.fault("frame_loss", drive, depth=share, for_s=for_s)

    def lose_sensor(
        self, drive: int | Literal["all"], sensor: str = "stator", for_s: float | None = None
    ) -> None:
        """A sensor says not-available: stator, drive_end, non_drive_end, ambient or current."""
        self.fault("sensor_lost", drive, sensor=sensor, for_s=for_s)
