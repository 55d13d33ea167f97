"""The core: `Gateway.step(frames, now) -> frames`.

What happens in a tick, and in which order, is in `gateway/core/tick.c`; the fields of the
records are in `gateway/core/records.h`. This module makes the records, and does what needs Python:
frames of other makers' drives, emergency messages, a detector that is not in the core,
authentication.

Five laws:
1. One `now` per tick, an integer of nanoseconds, passed in. Nothing below `gateway/io` reads a
   clock, a socket, an environment variable or a global random generator.
2. Same frames and same nows give the same bytes out.
3. `step` never raises on wire data or numbers: wire faults are counted, numeric faults reset
   that drive's filter and set its health. Exceptions mean a programming or configuration error.
4. Missing is not NaN: every input has a time stamp, and its age shows that it is missing. Inside
   the core NaN means "not known"; no NaN is sent, and none makes a flag good.
5. The truth never meets the estimate: `sim/` and `estimators/` do not import one another;
   parameters are frozen.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from _traction_core import ffi, lib
from numpy.typing import NDArray

from dbc.codec import Codec
from dbc.frame import MS, SECOND, Frame, Nanos
from dbc.frames import Block, block_of
from dbc.records import GATEWAY, TX_FRAME, Addressed, Records, point_to, pointer
from gateway.core import inputs
from gateway.core.adhesion import AdhesionMonitor
from gateway.core.busload import BusLoad
from gateway.core.channel import RPM, SAMPLE_NS
from gateway.core.codes import REJECTED, Flag, GatewayState
from gateway.core.estimate import Bank
from gateway.core.flags import FlagKind, Flags, Timing, rules, unknown_status
from gateway.core.inbox import ELECTRICAL, SAMPLES, DriveInput, Inbox
from gateway.core.integrity import INTRUDER_HOLD_NS, IntegrityMonitor
from gateway.core.motion import MotionMonitor, Timebase
from gateway.core.supervision import Supervision
from gateway.core.thermal import TemperatureMonitor
from gateway.core.transmit import Outbox
from gateway.core.view import GatewayView, drives_of, view_of
from gateway.mapping import lacks
from gateway.mapping import plan as foreign
from gateway.mapping.translate import Translator
from gateway.settings import calibration
from gateway.settings.config import Config

if TYPE_CHECKING:
    from dbc.secoc_sender import Authenticator

HEARTBEAT_LIMIT_NS: Final = 300 * MS
"""Shortest time-out of a drive's heartbeat; three of its periods if that is longer."""
COMM_CLEAR_NS: Final = 100 * MS
ESTIMATOR: Final = Timing(good_ns=0, raise_ns=0, clear_ns=200 * MS)
SENSOR: Final = Timing(good_ns=SECOND, raise_ns=0, clear_ns=5 * SECOND)
SENT: Final = 2048
"""Room for the gateway's own frames in a `run`; never less than for those of a tick."""


class Gateway(Addressed):
    """All state of the gateway. One object per bus; `step` is called once per tick.

    record: `struct gateway`, which `tick.c` works on.
    """

    pointer: Any

    def __init__(
        self,
        config: Config,
        codec: Codec,
        start_ns: Nanos,
        authenticator: Authenticator | None = None,
    ) -> None:
        """Raises ConfigError if configuration, calibration and DBC do not fit.

        authenticator: made by the driver, which has the key; None sends no `Gateway_Auth`.
        """
        nodes, tick_ns = config.nodes, config.loop.period_ns
        motors = [config.motors[d.motor] for d in config.drive]
        self.config, self.nodes, self.start_ns = config, nodes, start_ns
        self.supervision = Supervision(nodes, HEARTBEAT_LIMIT_NS, config.canopen.heartbeat_ns)
        planned, cells = config.all_of(
            lambda: foreign.plans(config), lambda: calibration.of(config)
        )
        self.calibration = cells
        creep = config.adhesion.send_creep
        taken = foreign.fitted(codec, planned, creep=creep)
        self.translator = Translator(planned, taken) if planned else None
        self.inbox = Inbox(taken, nodes, tick_ns, self.supervision, creep=creep)
        drives = self.inbox.drives
        missing = [d.node for d in drives if not d.channels]
        if missing:
            raise lacks.incomplete(config, codec.path, missing)
        self.bank = Bank(motors, config.estimator, _current_step_a(taken), tick_ns)
        places = self.inbox.places([0.1 * m.I_rated for m in motors])
        self.inputs = inputs.InputMonitor(self.inbox.receiver, places.channels)
        self.thermal = _thermal(config, drives, cells)
        limits_ns = [_limit_ns(d, "Temperatures") for d in drives]
        self.thermal.wire(places, limits_ns, [m.I_rated for m in motors])
        by = _rules(config, _slowest(drives))
        self.adhesion = AdhesionMonitor(config.adhesion, motors, by, tick_ns)
        self.motion = MotionMonitor(
            motors, config.estimator, _timing(drives), tick_ns, _current_step_a(taken),
            self.inbox.receiver, self.inputs, self.bank, self.adhesion.rotors,
        )  # fmt: skip
        self.flags = Flags(by, len(nodes), self.adhesion.detector.code, start_ns)
        self.status = self.flags.status
        own_hash = calibration.config_hash(config, codec.digest, cells)
        self.outbox = Outbox(codec, nodes, own_hash, tick_ns, authenticator, creep=creep)
        self.load = BusLoad(config.bus.bitrate, config.bus.data_bitrate, start_ns)
        authenticated = config.on_intruder == "tell" and authenticator is not None
        for_good = config.on_intruder in ("stop", "go_on")
        self.integrity = IntegrityMonitor(
            tick_ns, authenticated=authenticated, stops=config.on_intruder == "stop",
            intruder_hold_ns=None if for_good else INTRUDER_HOLD_NS,
        )  # fmt: skip
        self.peak: NDArray[np.float64] = np.full(len(nodes), np.nan)
        """(N,) largest probability of loss in the last `run`, of each drive; NaN: none."""
        self.sent = np.zeros(max(SENT, len(self.outbox.heads)), TX_FRAME)
        self.record = np.zeros(1, GATEWAY)
        self.record["period_ns"], self.record["drive_count"] = tick_ns, len(nodes)
        self.record["sent_capacity"], self.record["changed"] = len(self.sent), 1
        self.record["is_translated"] = self.translator is not None
        self.record["detects"] = self.adhesion.in_core
        self._capacity = 0
        """Frames of a tick that there is room for."""
        self._now: Nanos = start_ns
        self._view: GatewayView | None = None
        self.link()

    def link(self) -> None:
        """See `Addressed`."""
        point_to(self.record, {
            "receiver": self.inbox.receiver.record, "load": self.load.record,
            "integrity": self.integrity.record, "channels": self.inputs.channels,
            "inputs": self.inputs.status, "estimator": self.bank.record,
            "estimates": self.bank.estimates, "motion": self.motion.record,
            "adhesion": self.adhesion.record, "temperatures": self.thermal.record,
            "rules": self.flags.rules, "train_inputs": self.flags.train_inputs,
            "flag_inputs": self.flags.inputs, "evidence": self.flags.evidence,
            "status": self.status.drives, "train": self.status.train,
            "transmitter": self.outbox.record, "sent": self.sent, "peak": self.peak,
        })  # fmt: skip
        self.pointer = ffi.from_buffer("struct gateway *", self.record)
        self.keep_ticks(ffi.NULL)

    def keep_ticks(self, log: Any) -> None:
        """Write a row per tick into a `struct tick_log *` until it is full; NULL ends this.

        A copied gateway has no log, nor has one that was put into another state.
        """
        self._log = log
        self.pointer.log = log

    def resume(self, now: Nanos) -> None:
        """Go on with records taken from another gateway, whose last tick was at `now`."""
        self._now, self._view = now, None

    def note_timing(self, latency_p99_us: int, lateness_p99_us: int) -> None:
        """The driver's own measurements, for `Gateway_Info`."""
        self.outbox.note_timing(latency_p99_us, lateness_p99_us)

    def step(self, frames: Iterable[Frame] | Block, now: Nanos) -> list[Frame]:
        """Take the frames of one tick, give the frames to send. Never raises on wire data."""
        self._tick(frames if isinstance(frames, Block) else block_of(frames), now)
        out = self.outbox.frames_of(self.sent[: self.pointer.sent_count])
        if self.outbox.authenticator is not None:
            self.load.count(frame for frame in out if frame.can_id == self.outbox.auth.can_id)
        return out

    def _tick(self, block: Block, now: Nanos) -> None:
        if self.translator is not None:
            block = self._translated(self.translator, block, now)
        self._run_one(block, now)
        self._now, self._view = now, None

    def _run_one(self, block: Block, now: Nanos) -> None:
        """Run one tick with all frames of a block."""
        size = len(block.t_ns)
        if size > self._capacity:
            self._reserve(size)
        done = lib.run_one(self.pointer, size, *block.addresses(), now)
        if not done:
            block = block.ordered()
            done = lib.run_one(self.pointer, size, *block.addresses(), now)
        if done > 1:
            self._finish(block, 0, now)

    def run(self, block: Block, ends: NDArray[np.int64], now: Nanos) -> tuple[int, list[Block]]:
        """Run ticks at `now`, a period later and so on, one for each of ends (K,).

        Returns how many were run, and the frames to send. Tick k takes the frames from ends[k - 1]
        (0 for the first) to ends[k]. It stops after a tick in which a flag changed, or with a full
        log; the caller asks for the rest again. `peak` is that of the ticks that were run. Raises
        ValueError for ends outside this block.
        """
        ends = np.ascontiguousarray(ends, dtype=np.int64)
        sizes = np.diff(ends, prepend=0, append=block.size)
        if (sizes < 0).any():
            raise ValueError(f"ends {ends} of ticks in a block of {block.size} frames")
        if (most := int(sizes[:-1].max(initial=0))) > self._capacity:
            self._reserve(most)
        out: list[Block] = []
        done, peak = 0, np.full(len(self.nodes), np.nan)
        while done < len(ends) and not (done and (self.changed or lib.is_log_full(self._log))):
            first, at = int(ends[done - 1]) if done else 0, now + done * self.config.loop.period_ns
            if self.translator is None and self.outbox.authenticator is None:
                done += self._run(block.part(first, int(ends[-1])), ends[done:] - first, at)
                out.append(self.outbox.block_of(self.sent[: self.pointer.sent_count]))
            else:
                out.append(block_of(self.step(block.part(first, int(ends[done])), at)))
                done += 1
            np.fmax(peak, self.peak, out=peak)
        self.peak[:] = peak
        return done, out

    def _run(self, block: Block, ends: NDArray[np.int64], now: Nanos) -> int:
        """`run` in `tick.c`, then the Python part of its last tick; runs at least one tick."""
        each = pointer("int64_t", ends)
        done: int = lib.run(self.pointer, block.columns(), each, len(ends), now)
        if not done:
            block = block.part(0, int(ends[0])).ordered()
            done = lib.run(self.pointer, block.columns(), each, 1, now)
        first = int(ends[done - 2]) if done > 1 else 0
        self._now, self._view = now + (done - 1) * self.config.loop.period_ns, None
        self._finish(block, first, self._now)
        return done

    def _finish(self, block: Block, first: int, now: Nanos) -> None:
        """Python part of the last tick of a call; its frames begin at `first`."""
        if self.pointer.stage == lib.STAGE_DETECT:
            self.adhesion.ask_detector(self.bank.estimates)
            lib.finish_tick(self.pointer, now)
        if self.pointer.receiver.tick.emergencies:
            self.inbox.read_emergencies(block, first)

    def _reserve(self, frames: int) -> None:
        """Make room, in the receiver and for samples, for so many frames in a tick."""
        receiver = self.inbox.receiver
        if frames > receiver.rows:
            receiver.reserve(2 * frames)
        self.bank.reserve(receiver.sample_rows)
        self._capacity = receiver.rows

    def leave_out(self, frames: int) -> None:
        """Count frames of a log that were left out because of their time stamps."""
        self.inbox.added["received"] += frames
        self.inbox.added["time_back"] += frames
        self._note_rejected()

    def _note_rejected(self) -> None:
        self.outbox.note_rejected(sum(self.inbox.added[cause] for cause in REJECTED))

    def _translated(self, translator: Translator, block: Block, now: Nanos) -> Block:
        """Translate frames of one tick for the core; the bus load counts the original frames."""
        received = block.ordered()
        # Our own frames are counted when they are sent; in a log they appear a second time.
        self.load.add_block(received, self.inbox.receiver, now)
        taken = translator.translate(received, now, self.inbox.added)
        self._note_rejected()
        return taken.ordered()

    @property
    def changed(self) -> bool:
        """Whether a flag of any drive differs from the tick before; True at first."""
        return bool(self.pointer.changed)

    @property
    def begun(self) -> bool:
        """Whether a tick has been run."""
        return bool(self.pointer.begun)

    @property
    def now_ns(self) -> Nanos:
        """Time of the last tick."""
        return self._now

    @property
    def silent(self) -> bool:
        """Whether nothing is sent any more."""
        return self.integrity.silent

    @property
    def view(self) -> GatewayView | None:
        """Result of the last step, made on demand; None before the first."""
        if self._view is None and self.begun:
            opinion = self.adhesion.opinion
            common = opinion.common * self.adhesion.rated[0] if opinion.known.any() else None
            drives = drives_of(self.status, self.nodes, self.thermal.wear)
            counts, (latency, lateness) = self.inbox.counts, self.outbox.timing
            self._view = view_of(
                self._now, self.status, drives, common,
                deadline_misses=self.integrity.deadline_misses,
                rejected=sum(counts[cause] for cause in REJECTED), lost=counts["lost"],
                bus_load_percent=self.load.percent(self._now), latency_p99_us=latency,
                lateness_p99_us=lateness,
            )  # fmt: skip
        return self._view

    @property
    def says_good(self) -> bool:
        """Whether any flag of the last step is good."""
        each, train = self.status.drives["flag"]["state"], self.status.train
        sent = each[:, [FlagKind.ADHESION, FlagKind.THERMAL]]
        together = [train[name] for name in ("sensor", "comm", "estimator")]
        return bool((sent == Flag.GOOD).any()) or Flag.GOOD in together

    @property
    def decided_ns(self) -> Nanos | None:
        """Stamp of the newest sample behind the last step's flags; None before any."""
        newest = int(self.inbox.receiver.drives["sample_ns"].max())
        return newest if newest >= 0 else None

    def unknown_frames(self, now: Nanos) -> list[Frame]:
        """Frames in which all flags are unknown: sent three times before an orderly stop."""
        if self.silent:
            return []
        unknown = unknown_status(len(self.nodes), self.adhesion.detector.code)
        unknown.train["state"] = GatewayState.SILENT
        unknown.train["overrun"] = Flag.BAD if self.integrity.overrun else Flag.GOOD
        self.outbox.restart(now)
        names = ("Gateway_Adhesion", "Gateway_Faults", "Gateway_Status")
        wanted = {self.outbox.specs[name].can_id for name in names} | {self.outbox.auth.can_id}
        return [f for f in self.outbox.due(unknown, now) if f.can_id in wanted]


def _thermal(
    config: Config, drives: Sequence[DriveInput], cells: calibration.Calibration | None
) -> TemperatureMonitor:
    """Monitor of the motors' temperatures."""
    cycles = [d.channels["Temperatures"].period_ns for d in drives if "Temperatures" in d.channels]
    return TemperatureMonitor(
        len(drives), max(cycles, default=100 * MS), config.thermal.window_s, cells, config.nodes,
        [d.sensors for d in config.drive],
        model=config.thermal.method == "model", limit_k=config.thermal.limit_k,
    )  # fmt: skip


def _limit_ns(drive: DriveInput, kind: str) -> Nanos:
    """Age limit of a message; 0 where the drive sends none."""
    channel = drive.channels.get(kind)
    return channel.limit_ns if channel else 0


def _rules(config: Config, slowest_ns: Nanos) -> Records:
    """Rules from evidence to flags; slowest_ns: cycle of the slowest message."""
    a, t = config.adhesion, config.thermal
    raise_ms, severe_ms = a.raised_after_ms
    adhesion = Timing(a.good_ms * MS, raise_ms * MS, a.clear_ms * MS)
    timing = [
        adhesion,
        Timing(0, round(t.raise_s * SECOND), round(t.clear_s * SECOND)),
        # Good no sooner than the slowest message can have been received for the first time.
        Timing(slowest_ns, 0, COMM_CLEAR_NS),
        ESTIMATOR,
        SENSOR,
    ]
    severe = adhesion._replace(raise_ns=severe_ms * MS)
    return rules(timing, severe, a.raise_probability, a.clear_probability, config.loop.period_ns)


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
    """How often currents and `Motion` come, and the latter's resolution of speed."""
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
