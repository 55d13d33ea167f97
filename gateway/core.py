"""The core: `Gateway.step(frames, now) -> frames`.

Five laws:
1. One `now` per tick, an integer of nanoseconds, passed in. Nobody below `drivers/` reads a
   clock, a socket, an environment variable or a global random generator.
2. Same frames and same nows give the same bytes out.
3. `step` never raises on wire data or numbers: wire faults are counted, numeric faults reset
   that drive's filter and set its health. Exceptions mean a programming or configuration error.
4. Missing is not NaN. Every batch carries freshness and age. NaN anywhere means diverged.
5. The truth never meets the estimate: `sim/` and `estimators/` do not import one another;
   parameters are frozen.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from dbc.block import Block, block_of
from dbc.codec import Codec
from dbc.frame import MS, SECOND, Frame, Nanos
from estimators.detect import Opinion
from gateway import calibration, foreign
from gateway.adhesion import AdhesionSide
from gateway.bank import Bank, DriveEstimate, estimates_of
from gateway.busload import BusLoad
from gateway.channel import SAMPLE_NS
from gateway.config import Config, ConfigError
from gateway.decide import FlagState, Timing, advance, from_probability, hold
from gateway.doubt import Doubt
from gateway.health import (
    REJECTED,
    FaultClass,
    FaultSensor,
    Flag,
    GatewayState,
    Health,
    Reason,
    summary,
    worst,
)
from gateway.inbox import ELECTRICAL, SAMPLES, DriveInput, Inbox
from gateway.motion import MotionSide, Timebase
from gateway.outbox import DriveView, GatewayView, Outbox
from gateway.slow import RPM
from gateway.supervision import Life, Supervision
from gateway.thermal import Report, ThermalSide
from gateway.translate import Translator

if TYPE_CHECKING:
    from dbc.authentication import Authenticator

FLAGS: Final = ("adhesion", "thermal", "comm", "estimator", "sensor")
HEARTBEAT_LIMIT_NS: Final = 300 * MS
COMM_CLEAR_NS: Final = 100 * MS
ESTIMATOR: Final = Timing(good_ns=0, raise_ns=0, clear_ns=200 * MS)
SENSOR: Final = Timing(good_ns=SECOND, raise_ns=0, clear_ns=5 * SECOND)
COMM_CAUSES: Final = (Reason.STALE, Reason.CORRUPTED, Reason.SEQUENCE)


class Gateway:
    """All state of the gateway. One object per bus; `step` is called once per tick."""

    def __init__(
        self,
        config: Config,
        codec: Codec,
        start_ns: Nanos,
        authenticator: Authenticator | None = None,
    ) -> None:
        """Raises ConfigError where configuration, calibration and DBC do not fit.

        authenticator: made by the driver, who has the key; None sends no `Gateway_Auth`.
        """
        nodes = config.nodes
        motors = [config.motors[d.motor] for d in config.drive]
        self.config = config
        self.nodes = nodes
        self.supervision = Supervision(nodes, HEARTBEAT_LIMIT_NS)
        planned = foreign.plans(config)
        taken = foreign.fitted(codec, planned)
        self.translator = Translator(planned, taken) if planned else None
        self.inbox = Inbox(taken, nodes, config.loop.period_ns, self.supervision)
        self.sum_limit_a = [0.1 * m.I_rated for m in motors]
        missing = [d.node for d in self.inbox.drives if not d.channels]
        if missing:
            raise ConfigError(str(codec.path), [f"no messages of drive {n}" for n in missing])
        self.bank = Bank(motors, config.estimator, _current_step_a(taken), config.loop.period_ns)
        self.motion = MotionSide(
            motors, config.estimator, _timing(self.inbox.drives), config.loop.period_ns
        )
        cells = calibration.of(config)
        temperatures = [d.channels.get("Temperatures") for d in self.inbox.drives]
        period = max((c.period_ns for c in temperatures if c), default=100 * MS)
        self.temperature_limit_ns = [c.limit_ns if c else 0 for c in temperatures]
        fitted = [d.sensors for d in config.drive]
        self.thermal = ThermalSide(
            len(nodes), period, config.thermal.window_s, cells, nodes, fitted,
            model=config.thermal.method == "model", limit_k=config.thermal.limit_k,
        )  # fmt: skip
        a, t = config.adhesion, config.thermal
        self.timing = {
            "adhesion": Timing(a.good_ms * MS, a.raise_ms * MS, a.clear_ms * MS),
            "severe": Timing(a.good_ms * MS, a.raise_severe_ms * MS, a.clear_ms * MS),
            "thermal": Timing(0, round(t.raise_s * SECOND), round(t.clear_s * SECOND)),
            # Good no sooner than the slowest message can have been heard for the first time.
            "comm": Timing(_slowest(self.inbox.drives), 0, COMM_CLEAR_NS),
            "estimator": ESTIMATOR,
            "sensor": SENSOR,
        }
        self.adhesion = AdhesionSide(a, motors, self.timing["adhesion"], config.loop.period_ns)
        self.flags = [{name: FlagState(since_ns=start_ns) for name in FLAGS} for _ in nodes]
        self.reports = [Report() for _ in nodes]
        own_hash = calibration.config_hash(config, codec.digest, cells)
        self.outbox = Outbox(codec, nodes, own_hash, config.loop.period_ns, authenticator)
        self.load = BusLoad(config.bus.bitrate, config.bus.data_bitrate, start_ns)
        told_apart = config.on_intruder == "tell" and authenticator is not None
        self.doubt = Doubt(config.loop.period_ns, told_apart=told_apart)
        self.lost = [False] * len(nodes)
        """Drives whose heartbeat was seen and has stopped."""
        self.latency_p99_us: float | None = None
        self.lateness_p99_us: float | None = None
        self.stops = config.on_intruder != "go_on" and not told_apart
        self.silent = False
        """Nothing is sent any more."""
        self.start_ns = start_ns
        self.view: GatewayView | None = None

    def note_timing(self, latency_p99_us: int, lateness_p99_us: int) -> None:
        """The driver's own measurements, for `Gateway_Info`."""
        self.latency_p99_us = latency_p99_us
        self.lateness_p99_us = lateness_p99_us

    def step(self, frames: Iterable[Frame] | Block, now: Nanos) -> list[Frame]:
        """Take the frames of one tick, give the frames to send. Never raises on wire data."""
        inbox = self.inbox
        own = inbox.counts["own"]
        if self.translator is None:
            heard = inbox.take(frames, now)
        else:
            heard = (frames if isinstance(frames, Block) else block_of(frames)).ordered()
            inbox.take(self.translator.take(heard, now, inbox.counts), now)
        self.doubt.tick(now, inbox.counts["own"] - own)
        # Our own frames are counted as they go out; in a log they stand a second time.
        self.load.add_block(heard, inbox.routes, now)
        self.lost = [self.supervision.life(node, now) is Life.LOST for node in self.nodes]
        inputs = [self._input_reason(k) for k in range(len(self.nodes))]
        # The older of a pair's two frames is stale first, by up to what they were apart.
        stale = [reason is Reason.STALE for reason in inputs]
        fresh = [d.fresh(now) and not old for d, old in zip(inbox.drives, stale, strict=True)]
        self.bank.advance(inbox.samples, inbox.restart, inputs, fresh, now)
        self.motion.take(inbox.readings, inbox.motions, self.bank.tracks.flux)
        measured = np.array([_measured_speed(drive, now) for drive in inbox.drives])
        wrong = self.motion.settle(measured, self.bank.sensors, self.bank.told)
        inputs = [worst([i, Reason.RANGE]) if w else i for i, w in zip(inputs, wrong, strict=True)]
        estimates = estimates_of(self.bank.told)
        adhesion = [flags["adhesion"] for flags in self.flags]
        commanded = [drive.commanded(now) for drive in inbox.drives]
        opinion = self.adhesion.judge(self.bank.told, inbox.slow, commanded, adhesion, now)
        self.thermal.take(inbox.temperatures, now, inbox.drives)
        drives = tuple(
            self._drive(k, estimates[k], opinion, inputs[k], now) for k in range(len(self.nodes))
        )
        silent, self.silent = self.silent, self.stops and self.doubt.intruder
        self.view = self._view(drives, opinion, now)
        # The tick that finds an intruder still says so.
        out = [] if silent else self.outbox.due(self.view)
        self.load.add(out)
        return out

    @property
    def decided_ns(self) -> Nanos | None:
        """Stamp of the newest sample that the last step's flags rest on; None before any."""
        stamps = [d.sample_ns for d in self.inbox.drives if d.sample_ns is not None]
        return max(stamps, default=None)

    def unknown_frames(self, now: Nanos) -> list[Frame]:
        """Flag frames that say unknown: sent thrice before an orderly stop."""
        if self.silent:
            return []
        drives = tuple(DriveView(node) for node in self.nodes)
        self.outbox.restart(now)
        view = self._view(drives, None, now)._replace(state=GatewayState.SILENT)
        names = ("Gateway_Adhesion", "Gateway_Faults", "Gateway_Status")
        wanted = {self.outbox.specs[name].can_id for name in names} | {self.outbox.auth.can_id}
        return [f for f in self.outbox.due(view) if f.can_id in wanted]

    def _input_reason(self, k: int) -> Reason:
        """Why this drive's currents and voltages cannot be believed; NONE if they can."""
        drive = self.inbox.drives[k]
        if not drive.electrical:
            return Reason.CONFIG
        reasons = [channel.state for channel in drive.electrical]
        if drive.sum_error > self.sum_limit_a[k]:
            reasons.append(Reason.RANGE)
        if self.lost[k]:
            reasons.append(Reason.STALE)
        return worst(reasons)

    def _drive(
        self, k: int, estimate: DriveEstimate, opinion: Opinion, cause: Reason, now: Nanos
    ) -> DriveView:
        drive = self.inbox.drives[k]
        lost = opinion.lost.item(k) if opinion.known.item(k) else None
        adhesion, reason = self._adhesion_evidence(estimate, lost, cause)
        report = self.thermal.report(k, now, self.temperature_limit_ns[k])
        if self.doubt.reason is Reason.INTRUDER:
            report = report._replace(thermal=Flag.UNKNOWN, reason=Reason.INTRUDER)
        if drive.sum_error > self.sum_limit_a[k] and report.sensor is not Flag.BAD:
            report = report._replace(
                sensor=Flag.BAD,
                fault_class=FaultClass.SENSOR_BIAS,
                fault_sensor=FaultSensor.CURRENT,
            )
        evidence = {
            "adhesion": adhesion,
            "thermal": report.thermal,
            "sensor": report.sensor,
            "comm": self._comm(k),
            "estimator": _estimator_flag(estimate.health),
        }
        flags = self.flags[k]
        for name, seen in evidence.items():
            state = flags[name]
            if seen is None:
                flags[name] = hold(state, self.config.loop.period_ns)
            elif state.flag is not seen or state.evidence is not seen:
                severe = name == "adhesion" and self.adhesion.severe[k]
                timing = self.timing["severe" if severe else name]
                flags[name] = advance(state, seen, now, timing)
        if flags["thermal"].flag is Flag.GOOD and report.thermal is not Flag.GOOD:
            report = report._replace(fault_class=self.reports[k].fault_class)
        self.reports[k] = report
        tracking = estimate.health in (Health.TRACKING, Health.PREDICTING)
        heard = self.thermal.heard_ns[k]
        return DriveView(
            node=drive.node,
            adhesion=flags["adhesion"].flag,
            adhesion_reason=reason if flags["adhesion"].flag is Flag.UNKNOWN else Reason.NONE,
            thermal=flags["thermal"].flag,
            thermal_reason=(
                (report.reason or Reason.STARTING)
                if flags["thermal"].flag is Flag.UNKNOWN
                else Reason.NONE
            ),
            sensor=flags["sensor"].flag,
            comm=flags["comm"].flag,
            estimator=flags["estimator"].flag,
            health=estimate.health,
            speed_rad_s=estimate.speed_rad_s if tracking else None,
            load_nm=estimate.load_nm if tracking else None,
            load_sigma_nm=estimate.load_sigma_nm if tracking else None,
            loss_probability=lost,
            nis=estimate.nis if tracking else None,
            age_ns=None if drive.sample_ns is None else now - drive.sample_ns,
            fault_class=report.fault_class,
            fault_sensor=report.fault_sensor,
            mixed_c=report.mixed_c,
            maisd_k=report.maisd_k,
            wear=report.wear,
            temperature_age_ns=None if heard is None else now - heard,
        )

    def _adhesion_evidence(
        self, estimate: DriveEstimate, lost: float | None, cause: Reason
    ) -> tuple[Flag | None, Reason]:
        """Evidence for one drive's adhesion flag (None: nothing changes) and, if unknown, why."""
        if (doubt := self.doubt.reason) is not Reason.NONE:
            return Flag.UNKNOWN, doubt
        if cause is not Reason.NONE:
            return Flag.UNKNOWN, cause
        if estimate.health is Health.DIVERGED:
            return Flag.UNKNOWN, Reason.DIVERGED
        if estimate.health is not Health.TRACKING:
            return Flag.UNKNOWN, estimate.reason
        if lost is None:
            return Flag.UNKNOWN, Reason.TOO_FEW_DRIVES
        a = self.config.adhesion
        seen = from_probability(lost, True, a.raise_probability, a.clear_probability)
        return seen, Reason.STARTING

    def _comm(self, k: int) -> Flag:
        """Bad once anything that was valid is stale, silent or corrupted, or we are not alone.

        Good once all that was heard, the electrical messages with it, has been valid (and for a
        cycle of the slowest message: before that, one that was not yet heard may follow).
        """
        drive = self.inbox.drives[k]
        if self.lost[k] or self.doubt.intruder:
            return Flag.BAD
        for channel in drive.channels.values():
            if channel.seen_valid and channel.state in COMM_CAUSES:
                return Flag.BAD
        unheard = [c for c in drive.channels.values() if not c.seen_valid]
        if not drive.electrical:  # mapped, and its inverter sends none
            return Flag.UNKNOWN if unheard else Flag.GOOD
        known = not any(c.heard or c in drive.electrical for c in unheard)
        return Flag.GOOD if known else Flag.UNKNOWN

    def _common_mode(self) -> Flag:
        flag = self.adhesion.common.flag
        doubted = flag is Flag.GOOD and self.doubt.reason is not Reason.NONE
        return Flag.UNKNOWN if doubted else flag

    def _state(self, drives: tuple[DriveView, ...], overrun: bool) -> GatewayState:
        if self.silent:
            return GatewayState.SILENT
        if overrun or any(d.adhesion is Flag.UNKNOWN for d in drives):
            idle = (Health.UNKNOWN, Health.CONVERGING)
            starting = all(d.health in idle for d in drives)
            return GatewayState.STARTING if starting else GatewayState.DEGRADED
        return GatewayState.RUNNING

    def _view(
        self, drives: tuple[DriveView, ...], opinion: Opinion | None, now: Nanos
    ) -> GatewayView:
        counts = self.inbox.counts
        recent = self.doubt.overrun
        return GatewayView(
            t_ns=now,
            drives=drives,
            detector=self.adhesion.detector.code,
            common_mode=Flag.UNKNOWN if opinion is None else self._common_mode(),
            common_load_nm=(
                opinion.common * self.adhesion.rated[0]
                if opinion is not None and opinion.known.any()
                else None
            ),
            adhesion_reason=worst([d.adhesion_reason for d in drives]),
            faults_reason=worst([d.thermal_reason for d in drives]),
            sensor=summary([d.sensor for d in drives]),
            comm=summary([d.comm for d in drives]),
            estimator=summary([d.estimator for d in drives]),
            overrun=Flag.BAD if recent else Flag.GOOD,
            state=self._state(drives, recent),
            deadline_misses=self.doubt.deadline_misses,
            rejected=sum([counts[c] for c in REJECTED]),
            lost=counts["lost"],
            bus_load_percent=self.load.percent(now),
            latency_p99_us=self.latency_p99_us,
            lateness_p99_us=self.lateness_p99_us,
        )


def _current_step_a(codec: Codec) -> float:
    """Resolution of the currents on the bus, A: its quantisation noise is part of R."""
    steps = [
        float(abs(signal.scale))
        for spec in codec.messages
        for signal in spec.signals
        if spec.kind in (ELECTRICAL[0], SAMPLES) and signal.name in ("Ia", "Ia_0")
    ]
    return max(steps, default=0.0)


def _timing(drives: Sequence[DriveInput]) -> Timebase:
    """How often currents and `Motion` come, and how finely the latter tells speed."""
    electrical = [d.electrical[0] for d in drives if d.electrical]
    motion = [d.motion for d in drives if d.motion is not None]
    spacing = [SAMPLE_NS if c.kind == SAMPLES else c.period_ns for c in electrical]
    sample_ns = max(spacing, default=SAMPLE_NS)
    steps = [c.spec.signals[c.picked[0]].scale for c in motion if c.picked]
    return Timebase(
        sample_ns / SECOND,
        max((c.period_ns for c in motion), default=10 * MS),
        max((abs(step) * RPM for step in steps), default=0.0),
    )


def _measured_speed(drive: DriveInput, now: Nanos) -> float:
    """Rotor speed, rad/s, if the drive sends it and it is fresh, else NaN."""
    motion, speed = drive.motion, drive.speed
    return speed if speed is not None and motion is not None and motion.fresh(now) else math.nan


def _slowest(drives: Sequence[DriveInput]) -> Nanos:
    """Longest cycle of any message."""
    return max(c.period_ns for d in drives for c in d.channels.values())


def _estimator_flag(health: Health) -> Flag:
    if health is Health.DIVERGED:
        return Flag.BAD
    return Flag.GOOD if health is Health.TRACKING else Flag.UNKNOWN
