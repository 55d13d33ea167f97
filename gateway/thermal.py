"""The thermal side: temperatures in, evidence per motor and per sensor out.

Two questions are kept apart, so that a dead sensor is never a hot motor: is the sensor to
be believed (`gateway/sensors.py`), and what is wrong with the motor: by its thermal model
(`gateway/heatside.py`), or, with `method = "maisd"`, by how it differs from the others. A sensor
that is not believed takes no part in the second. All of it is compiled (`_thermal_kernels`) but for
the model, which is asked once a second.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.frame import SECOND, Nanos
from estimators import maisd
from gateway import channel, inputs, said, slow, warmth
from gateway._direct import Direct
from gateway._thermal_kernels import AMBIENT, FOREVER, advance, hear, report, report_one
from gateway.calibration import POINTS, Calibration
from gateway.channel import ChannelState
from gateway.config import ConfigError
from gateway.health import NEVER, FaultClass, FaultSensor, Flag, Reason
from gateway.heatside import SAMPLE_NS, HeatSide, Sample, Wear
from gateway.inbox import Inbox, Temperatures
from gateway.inputs import NONE, Places
from gateway.said import Findings
from gateway.sensors import SensorSide
from gateway.slow import SlowState
from gateway.warmth import Beat, Method

NO_MODEL: Final = (
    "no thermal model of every configured motor: calibrate with logs that have Status and Motion "
    'and a changing duty, or set [thermal] method = "maisd"'
)


class Report(NamedTuple):
    """What is known of one motor: evidence for its two flags and what goes on the bus."""

    thermal: Flag = Flag.UNKNOWN
    sensor: Flag = Flag.UNKNOWN
    reason: Reason = Reason.STARTING
    fault_class: FaultClass = FaultClass.UNKNOWN
    fault_sensor: FaultSensor = FaultSensor.NONE
    mixed_c: float | None = None
    maisd_k: float | None = None
    wear: Wear = Wear()


class Beside(NamedTuple):
    """What else the drives have said, for the thermal model."""

    places: Places
    state: ChannelState
    slow: SlowState


class ThermalSide:
    """State of all motors' temperatures; `hear` and `tell` per tick."""

    def __init__(
        self,
        motors: int,
        period_ns: Nanos,
        window_s: float,
        calibration: Calibration | None,
        nodes: tuple[int, ...],
        sensors: Sequence[Sequence[str]] | None = None,
        *,
        model: bool = False,
        limit_k: float = 10.0,
    ) -> None:
        """period_ns: the temperatures' cycle; the window is `window_s` of it.

        sensors: names of the points each drive has; None: all have all. model: judge by the thermal
        model; limit_k: K that a motor may grow warmer than the others. Raises ConfigError where
        the calibration has no model.
        """
        self.period_ns = period_ns
        by_node = {m.node: m for m in calibration.motor} if calibration else {}
        cells = [by_node.get(n) for n in nodes]
        self.sensors = SensorSide(motors, period_ns, cells, sensors)
        every = max(round(SAMPLE_NS / period_ns), 1)
        self.dt_s = every * period_ns / SECOND
        """From one second to the next."""
        self.learning = False
        """Look at seconds although there is no model: one is to be learnt."""
        self.heat: HeatSide | None = None
        method = Method.UNCALIBRATED if calibration is None else Method.MAISD
        if model and calibration is not None:
            known = calibration.known(nodes)
            if known is None:
                raise ConfigError("calibration", [NO_MODEL])
            self.heat = HeatSide(known, self.dt_s, limit_k)
            method = Method.MODEL
        window = max(1, round(window_s * SECOND / period_ns))
        self.warmth = warmth.warmth(
            self.sensors.drives,
            warmth.seconds(motors, len(POINTS) + 3, every),
            _averages(
                self.sensors.configured,
                maisd.window(window, motors, len(POINTS)),
                calibration,
                nodes,
            ),
            period_ns,
            method,
        )
        self._hear, self._advance, self._report = Direct(hear), Direct(advance), Direct(report)

    def hear(self, inbox: Inbox, places: Places, now: Nanos) -> None:
        """Accept this tick's readings; advance the windows once per temperature cycle."""
        came = inbox.seen > 0
        if came:
            self._hear(inbox.seen, inbox.scratch, inbox.wiring, self.warmth)
        self._go_on(came, now, Beside(places, inbox.state, inbox.slow))

    def take(
        self, readings: Sequence[Temperatures], now: Nanos, beside: Beside | None = None
    ) -> None:
        """As `hear`, of readings that came in no frame: a recording's."""
        for reading in readings:
            self.sensors.take(reading)
            celsius, valid = reading.celsius[AMBIENT], reading.valid[AMBIENT]
            self.warmth.seconds.ambient[reading.drive] = celsius if valid else math.nan
        self._go_on(bool(readings), now, beside or _nothing(len(self.warmth.kept_ns)))

    def _go_on(self, came: bool, now: Nanos, beside: Beside) -> None:
        """The rest of a tick once its readings are in."""
        heat, summed = self.heat, self.learning or self.heat is not None
        full = self._advance(came, now, summed, *beside, self.warmth)
        if heat is None:
            return
        if full:
            assert self.last is not None
            heat.take(self.last)
        if heat.work() or full:
            heat.say(self.warmth.model)

    @property
    def last(self) -> Sample | None:
        """The newest second, in the temperature cycle that completed it."""
        if not self.warmth.beat[Beat.FULL]:
            return None
        mean, points = self.warmth.seconds.mean.copy(), len(POINTS)
        return Sample(
            mean[:, :points], mean[:, points], mean[:, points + 1], mean[:, points + 2]
        )  # fmt: skip

    @property
    def cycles(self) -> int:
        """How often the windows have advanced."""
        return int(self.warmth.beat[Beat.CYCLES])

    def tell(self, now: Nanos, limit_ns: NDArray[np.int64], out: Findings) -> None:
        """Every motor's report into `out`, where one can have changed since the last call.

        limit_ns (N,): how old its temperatures may be.
        """
        self._report(now, limit_ns, self.warmth, out)

    @property
    def alone_ns(self) -> Nanos:
        """No tick before it needs the model: `hear` and `tell` are all compiled."""
        if self.heat is None and not self.learning:
            return FOREVER
        beat = self.warmth.beat
        next_ns, left = int(beat[Beat.NEXT_NS]), self.warmth.seconds.every - int(beat[Beat.AT]) - 1
        if next_ns == NEVER or (self.heat is not None and self.heat.monitor.waiting):
            return NEVER
        return next_ns + left * self.period_ns

    @property
    def wear(self) -> list[Wear]:
        """What is known of each motor's degradation, while its temperatures are heard."""
        heat = self.heat
        return [
            heat.wear(k) if heat is not None and heard else Wear()
            for k, heard in enumerate(self.warmth.fresh.tolist())
        ]

    def report(self, drive: int, now: Nanos, limit_ns: Nanos) -> Report:
        """Evidence for one motor at `now`; `limit_ns` is the age limit of its temperatures."""
        if self.heat is not None:
            self.heat.say(self.warmth.model)
        out = said.findings(len(self.warmth.kept_ns))
        report_one(drive, now, limit_ns, self.warmth, out)
        return self.told(drive, out)

    def told(self, drive: int, out: Findings) -> Report:
        """One motor's of what `tell` has filled, in words."""
        mixed, largest = out.mixed_c.item(drive), out.maisd_k.item(drive)
        return Report(
            Flag(out.thermal.item(drive)), Flag(out.sensor.item(drive)),
            Reason(out.reason.item(drive)), FaultClass(out.fault_class.item(drive)),
            FaultSensor(out.fault_sensor.item(drive)), None if math.isnan(mixed) else mixed,
            None if math.isnan(largest) else largest, self.wear[drive],
        )  # fmt: skip


def _averages(
    configured: NDArray[np.bool_],
    ring: NDArray[np.float64],
    calibration: Calibration | None,
    nodes: tuple[int, ...],
) -> warmth.Averages:
    """An empty window, and how a calibration centres and judges what it holds."""
    gain, offset = np.ones(ring.shape[1:]), np.zeros(ring.shape[1:])
    limit_k, apart_k = np.full((2, len(POINTS)), math.inf)
    if calibration is not None:
        gain, offset = calibration.centring(nodes)
        limit_k = np.array(calibration.maisd_limit_k)
        apart_k = np.array(calibration.deviation_limit_k)
    return warmth.averages(configured, ring, gain, offset, limit_k, apart_k)


def _nothing(drives: int) -> Beside:
    """Drives that say nothing else."""
    places = inputs.places([(0, 0, [], NONE, NONE)] * drives, [0] * drives, [0.0] * drives)
    return Beside(places, channel.state_of(channel.records([])), slow.start(drives))
