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

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from dbc.block import Block, block_of
from dbc.codec import Codec
from dbc.frame import MS, SECOND, Frame, Nanos
from estimators.detect import Opinion
from gateway import calibration, foreign, inputs, said
from gateway._direct import Direct
from gateway._flags_kernels import fill_inputs
from gateway.adhesion import AdhesionMonitor
from gateway.bank import Bank
from gateway.busload import BusLoad
from gateway.channel import SAMPLE_NS
from gateway.config import Config, ConfigError
from gateway.doubt import INTRUDER_HOLD_NS, Doubt
from gateway.flags import FlagKind, Flags, Timing, rules, unknown_status
from gateway.health import REJECTED, Flag, GatewayState
from gateway.inbox import ELECTRICAL, SAMPLES, DriveInput, Inbox
from gateway.motion import MotionMonitor, Timebase
from gateway.outbox import Outbox
from gateway.slow import RPM
from gateway.supervision import Life, Supervision
from gateway.thermal import ThermalSide
from gateway.translate import Translator
from gateway.view import Counted, GatewayView, drives_of, view_of

if TYPE_CHECKING:
    from dbc.authentication import Authenticator

HEARTBEAT_LIMIT_NS: Final = 300 * MS
"""Shortest time-out of a drive's heartbeat; three of its periods if that is longer."""
COMM_CLEAR_NS: Final = 100 * MS
ESTIMATOR: Final = Timing(good_ns=0, raise_ns=0, clear_ns=200 * MS)
SENSOR: Final = Timing(good_ns=SECOND, raise_ns=0, clear_ns=5 * SECOND)


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
        self.supervision = Supervision(nodes, HEARTBEAT_LIMIT_NS, config.canopen.heartbeat_ns)
        planned = foreign.plans(config)
        taken = foreign.fitted(codec, planned)
        self.translator = Translator(planned, taken) if planned else None
        self.inbox = Inbox(taken, nodes, config.loop.period_ns, self.supervision)
        missing = [d.node for d in self.inbox.drives if not d.channels]
        if missing:
            raise ConfigError(str(codec.path), [f"no messages of drive {n}" for n in missing])
        self.bank = Bank(motors, config.estimator, _current_step_a(taken), config.loop.period_ns)
        self.places = self.inbox.places([0.1 * m.I_rated for m in motors])
        self.inputs = inputs.InputMonitor(self.inbox.receiver, self.places.channels)
        cells = calibration.of(config)
        temperatures = [d.channels.get("Temperatures") for d in self.inbox.drives]
        period = max((c.period_ns for c in temperatures if c), default=100 * MS)
        limits = [c.limit_ns if c else 0 for c in temperatures]
        self.temperature_limit_ns = np.array(limits, dtype=np.int64)
        fitted = [d.sensors for d in config.drive]
        self.thermal = ThermalSide(
            len(nodes), period, config.thermal.window_s, cells, nodes, fitted,
            model=config.thermal.method == "model", limit_k=config.thermal.limit_k,
        )  # fmt: skip
        a, t = config.adhesion, config.thermal
        adhesion = Timing(a.good_ms * MS, a.raise_ms * MS, a.clear_ms * MS)
        timing = [
            adhesion,
            Timing(0, round(t.raise_s * SECOND), round(t.clear_s * SECOND)),
            # Good no sooner than the slowest message can have been heard for the first time.
            Timing(_slowest(self.inbox.drives), 0, COMM_CLEAR_NS),
            ESTIMATOR,
            SENSOR,
        ]
        severe = adhesion._replace(raise_ns=a.raise_severe_ms * MS)
        tick_ns = config.loop.period_ns
        by = rules(timing, severe, a.raise_probability, a.clear_probability, tick_ns)
        self.adhesion = AdhesionMonitor(a, motors, by, tick_ns)
        self.motion = MotionMonitor(
            motors, config.estimator, _timing(self.inbox.drives), tick_ns, _current_step_a(taken),
            self.inbox.receiver, self.inputs, self.bank, self.adhesion.rotors,
        )  # fmt: skip
        self.flags = Flags(by, len(nodes), self.adhesion.detector.code, start_ns)
        self.status = self.flags.status
        self.changed = True
        """Whether a flag of any drive is another than in the tick before."""
        self.findings = said.findings(len(nodes))
        self._fill_inputs = Direct(fill_inputs)
        own_hash = calibration.config_hash(config, codec.digest, cells)
        self.outbox = Outbox(codec, nodes, own_hash, config.loop.period_ns, authenticator)
        self.load = BusLoad(config.bus.bitrate, config.bus.data_bitrate, start_ns)
        told_apart = config.on_intruder == "tell" and authenticator is not None
        for_good = config.on_intruder in ("stop", "go_on")
        self.doubt = Doubt(
            config.loop.period_ns, told_apart=told_apart,
            intruder_hold_ns=None if for_good else INTRUDER_HOLD_NS,
        )  # fmt: skip
        self._any_lost = False
        self.latency_p99_us: float | None = None
        self.lateness_p99_us: float | None = None
        self.stops = config.on_intruder == "stop"
        self.silent = False
        """Nothing is sent any more."""
        self.start_ns = start_ns
        self._now: Nanos = start_ns
        self._opinion: Opinion | None = None
        self._view: GatewayView | None = None

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
        return self.heard(heard, inbox.counts["own"] - own, now)

    def heard(self, heard: Block, own: int, now: Nanos) -> list[Frame]:
        """The rest of a step once its frames are in, `own` of them ours; see `step`."""
        inbox = self.inbox
        self.doubt.tick(now, own)
        # Our own frames are counted as they go out; in a log they stand a second time.
        self.load.add_block(heard, inbox.receiver, now)
        if self._any_lost or self.supervision.any_lost(now):
            lives = [self.supervision.life(node, now) for node in self.nodes]
            self.inputs.status["heartbeat_lost"] = [life is Life.LOST for life in lives]
            self._any_lost = Life.LOST in lives
        self.inputs.assess(self.doubt.intruder, now)
        bank, told, drives = self.bank, self.bank.told, self.flags.status.drives
        bank.make_room(len(inbox.room.drive))
        bank.run(inbox.receiver.pointer, self.inputs.status, now)
        self.motion.observe(now)
        opinion = self.adhesion.detect(told, self.inputs.status, inbox.receiver.drives, drives, now)
        return self.judged(opinion, now)

    def judged(self, opinion: Opinion, now: Nanos) -> list[Frame]:
        """The rest of a step once adhesion has been judged."""
        inbox, inputs, told = self.inbox, self.inputs.columns, self.bank.told
        intruder, wrong = self.doubt.intruder, self.motion.implausible
        self.thermal.hear(inbox, self.places, now)
        self.thermal.tell(now, self.temperature_limit_ns, self.findings)
        silent, self.silent = self.silent, self.stops and intruder
        flags = self.flags
        self._fill_inputs(
            inputs, wrong, self.adhesion.uncertain, told, opinion.lost, opinion.known,
            self.adhesion.severe, self.findings, inbox.pairs.sample_ns, flags.inputs,
        )  # fmt: skip
        common_mode = self.adhesion.common_mode["state"].item()
        flags.note_train(self.doubt.reason, common_mode, self.silent, self.doubt.overrun)
        flags.collect_evidence()
        self.changed = flags.debounce(now) or self._opinion is None
        flags.publish(now)
        self.note(opinion, now)
        if self.outbox.wants_counts(now):
            self.outbox.note_counts(self.counted(self._now))
        # The tick that finds an intruder still says so.
        out = [] if silent else self.outbox.due(self.status, now)
        self.load.add(out)
        return out

    def note(self, opinion: Opinion, now: Nanos) -> None:
        """What the tick at `now` was about; nothing has been put into words yet."""
        self._now, self._opinion, self._view = now, opinion, None

    @property
    def calm(self) -> bool:
        """Whether all drives' heartbeats are heard that ever were, and we may send."""
        return not (self._any_lost or self.silent)

    @property
    def begun(self) -> bool:
        """Whether there was a step."""
        return self._opinion is not None

    @property
    def view(self) -> GatewayView | None:
        """What the last step says; None before the first. Made when it is asked for."""
        if self._view is None and self._opinion is not None:
            opinion = self._opinion
            common = opinion.common * self.adhesion.rated[0] if opinion.known.any() else None
            drives = drives_of(self.status, self.nodes, self.thermal.wear)
            self._view = view_of(self._now, self.status, drives, common, self.counted(self._now))
        return self._view

    @property
    def says_good(self) -> bool:
        """Whether any flag of the last step says good."""
        each, train = self.status.drives["flag"]["state"], self.status.train
        sent = each[:, [FlagKind.ADHESION, FlagKind.THERMAL]]
        together = [train[name] for name in ("sensor", "comm", "estimator")]
        return bool((sent == Flag.GOOD).any()) or Flag.GOOD in together

    @property
    def decided_ns(self) -> Nanos | None:
        """Stamp of the newest sample that the last step's flags rest on; None before any."""
        newest = int(self.inbox.pairs.sample_ns.max())
        return newest if newest >= 0 else None

    def unknown_frames(self, now: Nanos) -> list[Frame]:
        """Flag frames that say unknown: sent thrice before an orderly stop."""
        if self.silent:
            return []
        unknown = unknown_status(len(self.nodes), self.adhesion.detector.code)
        unknown.train["state"] = GatewayState.SILENT
        unknown.train["overrun"] = Flag.BAD if self.doubt.overrun else Flag.GOOD
        self.outbox.restart(now)
        self.outbox.note_counts(self.counted(self._now))
        names = ("Gateway_Adhesion", "Gateway_Faults", "Gateway_Status")
        wanted = {self.outbox.specs[name].can_id for name in names} | {self.outbox.auth.can_id}
        return [f for f in self.outbox.due(unknown, now) if f.can_id in wanted]

    def counted(self, now: Nanos) -> Counted:
        """What the frames of a tick at `now` say of the frames so far."""
        counts = self.inbox.counts
        return Counted(
            self.doubt.deadline_misses, sum(counts[c] for c in REJECTED), counts["lost"],
            self.load.percent(now), self.latency_p99_us, self.lateness_p99_us,
        )  # fmt: skip


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


def _slowest(drives: Sequence[DriveInput]) -> Nanos:
    """Longest cycle of any message."""
    return max(c.period_ns for d in drives for c in d.channels.values())
