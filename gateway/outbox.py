"""From flags and estimates to frames: what is due, encoded, counted and protected.

May know: the message set and `now`. Every value that is not known goes out as its
not-available code or as `Unknown`; nothing is ever repeated from an earlier tick.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final, NamedTuple

from dbc.codec import Codec, MessageSpec
from dbc.frame import BRS, FD, MS, Frame, Nanos
from dbc.protection import protect
from gateway.health import FaultClass, FaultSensor, Flag, GatewayState, Health, Reason
from gateway.heatside import Wear

if TYPE_CHECKING:
    from dbc.authentication import Authenticator

VOUCHED: Final = ("Gateway_Adhesion", "Gateway_Faults")
"""What `Gateway_Auth` follows, where flags are authenticated."""
MOST_JUMPS = 14
"""One below the code for not available."""
Value = float | int | None


class DriveView(NamedTuple):
    """What the gateway knows of one drive at a tick. None means not known."""

    node: int
    adhesion: Flag = Flag.UNKNOWN
    adhesion_reason: Reason = Reason.STARTING
    thermal: Flag = Flag.UNKNOWN
    thermal_reason: Reason = Reason.STARTING
    sensor: Flag = Flag.UNKNOWN
    comm: Flag = Flag.UNKNOWN
    estimator: Flag = Flag.UNKNOWN
    health: Health = Health.UNKNOWN
    speed_rad_s: float | None = None
    load_nm: float | None = None
    load_sigma_nm: float | None = None
    loss_probability: float | None = None
    nis: float | None = None
    age_ns: Nanos | None = None
    fault_class: FaultClass = FaultClass.UNKNOWN
    fault_sensor: FaultSensor = FaultSensor.NONE
    mixed_c: float | None = None
    maisd_k: float | None = None
    wear: Wear = Wear()
    temperature_age_ns: Nanos | None = None


class GatewayView(NamedTuple):
    """Everything one tick says: the drives, the set's own state, the counters."""

    t_ns: Nanos
    drives: tuple[DriveView, ...]
    detector: int
    common_mode: Flag
    common_load_nm: float | None
    adhesion_reason: Reason
    faults_reason: Reason
    sensor: Flag
    comm: Flag
    estimator: Flag
    overrun: Flag
    state: GatewayState
    deadline_misses: int
    rejected: int
    lost: int
    bus_load_percent: float | None
    latency_p99_us: float | None
    lateness_p99_us: float | None


RPM = 60.0 / (2.0 * 3.141592653589793)


def _oldest(ages: list[Nanos | None]) -> Nanos | None:
    """Age of the oldest newest sample; None while any drive has none."""
    known = [age for age in ages if age is not None]
    return max(known) if len(known) == len(ages) and known else None


class Outbox:
    """The gateway's own messages: schedule and counters. `due` is the only mutator."""

    def __init__(
        self,
        codec: Codec,
        nodes: tuple[int, ...],
        config_hash: int,
        tick_ns: Nanos,
        authenticator: Authenticator | None = None,
    ) -> None:
        """The set of messages is fixed here; nothing else can ever be sent."""
        # A real tick wakes a little later than the one that the grid counts from, or a little
        # less late: what is due within half a tick is due now.
        self.tick_ns, self.slack_ns = tick_ns, tick_ns // 2
        self.config_hash = config_hash
        self.codec = codec
        self.counters: dict[str, int] = {}
        self.last_faults: tuple[object, ...] | None = None
        names = [f"Gateway_{n}" for n in ("Adhesion", "Faults", "Info", "Status")]
        self.places = {
            f"Drive{node}_{kind}": (k, kind)
            for k, node in enumerate(nodes)
            for kind in ("Estimate", "Thermal")
        }
        names += self.places
        self.specs: dict[str, MessageSpec] = {name: codec.by_name[name] for name in names}
        self.next_ns: dict[str, Nanos] = {}
        self.authenticator = authenticator
        self.auth = codec.by_name["Gateway_Auth"]
        self.vouched = {self.specs[name].can_id: self.specs[name].key for name in VOUCHED}

    def restart(self, now: Nanos) -> None:
        """Everything is due now; the cycles count from here."""
        self.next_ns = dict.fromkeys(self.specs, now)
        self.last_faults = None

    def due(self, view: GatewayView) -> list[Frame]:
        """Frames of this tick, in the order of their ids; after each flag frame its `Auth`."""
        now = view.t_ns
        if not self.next_ns:
            self.restart(now)
        faults = _faults_key(view)
        if faults != self.last_faults:
            self.next_ns["Gateway_Faults"] = now
        frames = []
        for name, start in self.next_ns.items():
            spec = self.specs[name]
            # What goes out with every tick does so however late the first one was.
            if now + self.slack_ns < start and spec.cycle_ns > self.tick_ns:
                continue
            # The grid stays, however late a tick is; what was missed is not sent later.
            behind = max(now - start, 0) // spec.cycle_ns
            self.next_ns[name] = start + spec.cycle_ns * (1 + behind)
            frames.append(self._frame(spec, self._values(name, view), now))
        self.last_faults = faults
        frames.sort(key=lambda frame: frame.can_id)
        return frames if self.authenticator is None else self._vouch(self.authenticator, frames)

    def _vouch(self, authenticator: Authenticator, frames: list[Frame]) -> list[Frame]:
        out = []
        for frame in frames:
            out.append(frame)
            key = self.vouched.get(frame.can_id)
            if key is not None:
                freshness, mac = authenticator.sign(key, frame.data)
                values = {"Freshness": freshness, "Mac": mac}
                out.append(self._frame(self.auth, values, frame.t_ns))
        return out

    def _frame(self, spec: MessageSpec, values: Mapping[str, Value], t_ns: Nanos) -> Frame:
        payload = self.codec.encode(spec, values)
        counter = self.counters.get(spec.name, 0)
        self.counters[spec.name] = counter + 1
        protect(spec, payload, counter)
        flags = (FD | (BRS if spec.brs else 0)) if spec.is_fd else 0
        return Frame(t_ns, spec.can_id, bytes(payload), flags)

    def _values(self, name: str, view: GatewayView) -> Mapping[str, Value]:
        place = self.places.get(name)
        if place is not None:
            index, kind = place
            drive = view.drives[index]
            return _estimate(drive) if kind == "Estimate" else _thermal(drive)
        if name == "Gateway_Adhesion":
            return _adhesion(view)
        if name == "Gateway_Faults":
            return _faults(view)
        if name == "Gateway_Info":
            return {
                "ConfigHash": self.config_hash,
                "LatencyP99": view.latency_p99_us,
                "LatenessP99": view.lateness_p99_us,
            }
        return {
            "State": view.state,
            "DeadlineMisses": view.deadline_misses,
            "RejectedFrames": view.rejected,
            "LostFrames": view.lost,
            "BusLoad": view.bus_load_percent,
        }


def _adhesion(view: GatewayView) -> dict[str, Value]:
    values: dict[str, Value] = {f"Adhesion{d.node}": d.adhesion for d in view.drives}
    age = _oldest([d.age_ns for d in view.drives])
    values["Reason"] = view.adhesion_reason
    values["Detector"] = view.detector
    values["CommonMode"] = view.common_mode
    values["Age"] = None if age is None else min(254, age // MS)
    return values


def _faults_key(view: GatewayView) -> tuple[object, ...]:
    """What counts as a change of the faults frame."""
    flags = tuple(d.thermal for d in view.drives)
    return (flags, view.sensor, view.comm, view.estimator, view.overrun)


def _faults(view: GatewayView) -> dict[str, Value]:
    values: dict[str, Value] = {f"Thermal{d.node}": d.thermal for d in view.drives}
    age = _oldest([d.temperature_age_ns for d in view.drives])
    values["Reason"] = view.faults_reason
    values["SensorFault"] = view.sensor
    values["CommFault"] = view.comm
    values["EstimatorFault"] = view.estimator
    values["Overrun"] = view.overrun
    values["Age"] = None if age is None else min(2540, 10 * (age // (10 * MS)))
    return values


def _estimate(drive: DriveView) -> dict[str, Value]:
    speed, nis, lost = drive.speed_rad_s, drive.nis, drive.loss_probability
    return {
        "Health": drive.health,
        "Speed": None if speed is None else speed * RPM,
        "LoadTorque": drive.load_nm,
        "LossProbability": None if lost is None else 100.0 * lost,
        "Nis": None if nis is None else min(nis, 25.4),
    }


def _thermal(drive: DriveView) -> dict[str, Value]:
    return {
        "FaultClass": drive.fault_class,
        "Tmixed": drive.mixed_c,
        "Maisd": drive.maisd_k,
        "FaultSensor": drive.fault_sensor,
        "Jumps": min(drive.wear.jumps, MOST_JUMPS) if drive.wear.rate_k_h is not None else None,
        "DegradationRate": drive.wear.rate_k_h,
    }
