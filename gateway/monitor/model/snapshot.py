"""All data that a monitor shows at one time. None means not known; no value is ever NaN.

Every form of the monitor (terminal, page, metrics) shows these data and no others.
Times are seconds since the first received frame.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import IntEnum
from typing import Any, Final, NamedTuple

from gateway.core.codes import FaultClass, FaultSensor, Flag, GatewayState, Health, Reason
from gateway.reports.record import ADHESION, COMMON, FAULT, camel


class DriveRow(NamedTuple):
    """One drive: values that the gateway sends about it, and values that it sends itself.

    All are the last accepted ones; a value older than its limit is unknown.
    """

    node: int
    adhesion: Flag = Flag.UNKNOWN
    thermal: Flag = Flag.UNKNOWN
    health: Health = Health.UNKNOWN
    speed_rad_s: float | None = None
    """Estimate of the gateway."""
    measured_speed_rad_s: float | None = None
    """Measured by the drive itself."""
    load_nm: float | None = None
    load_sigma_nm: float | None = None
    """Not on the bus: from the shadow, if its load agrees with that on the bus."""
    loss_probability: float | None = None
    """0 .. 1."""
    nis: float | None = None
    stator_c: float | None = None
    drive_end_c: float | None = None
    non_drive_end_c: float | None = None
    ambient_c: float | None = None
    mixed_c: float | None = None
    maisd_k: float | None = None
    fault_class: FaultClass = FaultClass.UNKNOWN
    fault_sensor: FaultSensor | None = None
    jumps: int | None = None
    degradation_k_h: float | None = None
    state: str | None = None
    """`Drive_Status.State` by its name in the DBC: Off, Ready, Operation, Fault."""
    heartbeat: str | None = None
    """BootUp, Stopped, Operational, PreOperational; Silent: received before, but has stopped;
    None: never received."""
    rejected: int = 0
    """Frames with the drive's identifiers and a wrong checksum, counter, length or format."""
    age_s: float | None = None
    """Time since the drive's last good frame."""


class GatewayRow(NamedTuple):
    """The gateway itself and the flags of the train."""

    alive: bool = False
    """Whether a flag frame not older than 100 ms was received."""
    present: bool = False
    """Whether any frame of a gateway was accepted since the start; if not, the bus has none."""
    source: str = "none"
    """Origin of the flags and estimates in the rows: `bus`, `shadow` (a gateway that runs in the
    monitor, and is marked as such), `none`."""
    state: GatewayState | None = None
    reason: Reason | None = None
    """Reason of the adhesion flags."""
    thermal_reason: Reason | None = None
    age_ms: float | None = None
    """Age of the oldest sample used for the adhesion flags, as the gateway sends it."""
    flags_age_ms: float | None = None
    """Time since the last accepted flag frame."""
    detector: str | None = None
    common_mode: Flag = Flag.UNKNOWN
    sensor_fault: Flag = Flag.UNKNOWN
    comm_fault: Flag = Flag.UNKNOWN
    estimator_fault: Flag = Flag.UNKNOWN
    overrun: Flag = Flag.UNKNOWN
    deadline_misses: int | None = None
    rejected: int | None = None
    lost_frames: int | None = None
    bus_load_pct: float | None = None
    config_hash: str | None = None
    """Six hexadecimal digits."""
    latency_p99_us: float | None = None
    lateness_p99_us: float | None = None
    heartbeat: str | None = None
    """As in `DriveRow`."""


class LinkRow(NamedTuple):
    """The state of the bus as seen by the monitor."""

    state: str = "active"
    """From error frames: `active`, `warning`, `passive`, `bus-off`; `absent`, `down`: no interface
    to listen to."""
    bus_load_pct: float | None = None
    """Measured here over the last full second, worst-case stuffing."""
    frames_s: float | None = None
    received: int = 0
    error_frames: int = 0
    unread: int = 0
    """Frames that the kernel dropped because this monitor did not read in time."""
    rejected: Mapping[str, int] = {}
    """By cause; only causes that occurred."""


class Lateness(NamedTuple):
    """Lateness of the `Gateway_Adhesion` frames against their schedule, as seen on the bus.

    counts[k]: frames with edges_us[k] <= t < edges_us[k + 1]; edges are powers of two, and one
    more than counts.
    """

    edges_us: tuple[int, ...] = ()
    counts: tuple[int, ...] = ()
    total: int = 0
    p99_us: int | None = None
    largest_us: int | None = None


class Event(NamedTuple):
    """One event. level: `info`, `warning`, `error`."""

    t_s: float
    level: str
    drive: int | None
    text: str


class Trace(NamedTuple):
    """Recent values of one drive every 100 ms, oldest first; all tuples have the same length."""

    node: int
    t_s: tuple[float, ...] = ()
    speed_rad_s: tuple[float | None, ...] = ()
    load_nm: tuple[float | None, ...] = ()
    load_sigma_nm: tuple[float | None, ...] = ()
    loss_probability: tuple[float | None, ...] = ()
    adhesion: tuple[Flag, ...] = ()


class Snapshot(NamedTuple):
    """The state at one time. drives: in the order of the configuration."""

    t_s: float
    gateway: GatewayRow
    drives: tuple[DriveRow, ...]
    link: LinkRow
    lateness: Lateness
    events: tuple[Event, ...]
    """The last 200 events, oldest first."""
    span_s: tuple[float, float] | None = None
    """First and last time for a seek; None on a bus."""
    history: tuple[Trace, ...] = ()
    """A trace of the last 60 s for each drive."""


_WORDS: Final[Mapping[str, Mapping[Flag, str]]] = {"adhesion": ADHESION, "common_mode": COMMON}


def word(name: str, value: IntEnum) -> str:
    """Name of an enumeration's member in the DBC; for a flag it depends on the field, `name`."""
    if isinstance(value, Flag):
        return _WORDS.get(name, FAULT)[value]
    return camel(value.name)


def as_json(snapshot: Snapshot) -> dict[str, Any]:
    """The snapshot without `history` for JSON: keys are names of fields; None: not known."""
    plain: dict[str, Any] = _plain("", snapshot._replace(history=()))
    del plain["history"]
    return plain


def _plain(name: str, value: object) -> Any:
    if isinstance(value, IntEnum):
        return word(name, value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if hasattr(value, "_asdict"):
        return {key: _plain(key, inner) for key, inner in value._asdict().items()}
    if isinstance(value, Mapping):
        return {str(key): _plain(name, inner) for key, inner in value.items()}
    if isinstance(value, tuple):
        return [_plain(name, inner) for inner in value]
    return value
