"""The simulated inverters in a test, with faults that start now and last for a given time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

from pydantic import ValidationError

from sim.scenario import Event
from sim.scenario_errors import problems_of
from sim.simulation import Simulation


class Inverter:
    """All drives of the bench; `drive` is a node number or "all"."""

    def __init__(self, simulation: Simulation, now_s: Callable[[], float]) -> None:
        """Made by the bench; `now_s` returns the bench's time."""
        self._simulation, self._now_s = simulation, now_s

    def fault(
        self,
        kind: str,
        drive: int | Literal["all"] = "all",
        *,
        for_s: float | None = None,
        **more: Any,
    ) -> None:
        """Start an event of `sim.scenario` now; `depth`, `value`, `sensor`, `ramp_s` as there.

        for_s: duration in s; None: for good. Raises ValueError for an invalid event.
        """
        __tracebackhide__ = True
        fields = {"at_s": self._now_s(), "for_s": for_s, "drive": drive, "kind": kind, **more}
        try:
            self._simulation.inject(Event.model_validate(fields))
        except ValidationError as error:
            raise ValueError("; ".join(problems_of(error, Event))) from None
        except ValueError as error:
            raise ValueError(str(error)) from None

    def lose_adhesion(
        self, drive: int | Literal["all"], depth: float = 1.0, for_s: float | None = None
    ) -> None:
        """Lose adhesion: the rail carries only (1 - depth) of the torque demanded of the wheel."""
        __tracebackhide__ = True
        self.fault("adhesion_loss", drive, depth=depth, for_s=for_s)

    def silence(self, drive: int | Literal["all"], for_s: float | None = None) -> None:
        """Stop all frames of the drive, its heartbeat included."""
        __tracebackhide__ = True
        self.fault("silent", drive, for_s=for_s)

    def lose_frames(
        self, drive: int | Literal["all"], share: float, for_s: float | None = None
    ) -> None:
        """Lose each frame of the drive with probability `share`."""
        __tracebackhide__ = True
        self.fault("frame_loss", drive, depth=share, for_s=for_s)

    def lose_sensor(
        self, drive: int | Literal["all"], sensor: str = "stator", for_s: float | None = None
    ) -> None:
        """Make a sensor not available: stator, drive_end, non_drive_end, ambient or current."""
        __tracebackhide__ = True
        self.fault("sensor_lost", drive, sensor=sensor, for_s=for_s)
