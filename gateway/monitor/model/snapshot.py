"""What a monitor shows at one moment. None means not known; nothing here is ever NaN.

Every form of the monitor (terminal, page, metrics) draws from these and from nothing else.
Times are seconds since the first frame that was seen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import IntEnum
from typing import Any, Final, NamedTuple

from gateway.core.codes import FaultClass, FaultSensor, Flag, GatewayState, Health, Reason
from gateway.reports.record import ADHESION, FAULT, camel

COMMON: Final = {Flag.UNKNOWN: "Unknown", Flag.GOOD: "NotDetected", Flag.BAD: "AllDrives"}


class DriveRow(NamedTuple):
    """One drive: what the gateway says of it, and what it says itself.

    Everything is as last believed; what is older than its limit is unknown.
    """

    node: int
    adhesion: Flag = Flag.UNKNOWN
    thermal: Flag = Flag.UNKNOWN
    health: Health = Health.UNKNOWN
    speed_rad_s: float | None = None
    """The gateway's estimate."""
    measured_speed_rad_s: float | None = None
    """The drive's own word."""
    load_nm: float | None = None
    load_sigma_nm: float | None = None
    """Not on the bus: of a gateway run beside it, where that one agrees."""
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
    """BootUp, Stopped, Operational, PreOperational; Silent: was heard and has stopped; None:
    never heard."""
    rejected: int = 0
    """Frames with its identifiers that failed checksum, counter, length or format."""
    age_s: float | None = None
    """Since its last good frame."""


class GatewayRow(NamedTuple):
    """The gateway itself and the flags of the whole set."""

    alive: bool = False
    """Flags newer than 100 ms were heard."""
    present: bool = False
    """Any believed frame of a gateway since the start: without it there is none on this bus."""
    source: str = "none"
    """Whose flags and estimates the rows have: `bus`, `shadow` (a gateway that runs in the monitor
    and is told as such), `none`."""
    state: GatewayState | None = None
    reason: Reason | None = None
    """Of the adhesion flags."""
    thermal_reason: Reason | None = None
    age_ms: float | None = None
    """Oldest sample that the adhesion flags rest on, by the gateway's own word."""
    flags_age_ms: float | None = None
    """Since the last believed flag frame."""
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
    """As of a drive."""
    authenticated: bool | None = None
    """None: nobody checked."""


class LinkRow(NamedTuple):
    """The bus as the monitor finds it."""

    state: str = "active"
    """As error frames tell it: `active`, `warning`, `passive`, `bus-off`; `absent`, `down`: no
    interface to listen to."""
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
    """How far behind its schedule each `Gateway_Adhesion` frame came, as seen on the bus.

    counts[k] lies in edges_us[k] <= t < edges_us[k + 1]; powers of two, so one edge more.
    """

    edges_us: tuple[int, ...] = ()
    counts: tuple[int, ...] = ()
    total: int = 0
    p99_us: int | None = None
    largest_us: int | None = None


class Event(NamedTuple):
    """One thing that happened. level: `info`, `warning`, `error`."""

    t_s: float
    level: str
    drive: int | None
    text: str


class Trace(NamedTuple):
    """The recent past of one drive, a point every 100 ms, oldest first; all tuples are as long."""

    node: int
    t_s: tuple[float, ...] = ()
    speed_rad_s: tuple[float | None, ...] = ()
    load_nm: tuple[float | None, ...] = ()
    load_sigma_nm: tuple[float | None, ...] = ()
    loss_probability: tuple[float | None, ...] = ()
    adhesion: tuple[Flag, ...] = ()


class Snapshot(NamedTuple):
    """One moment. drives: in the order of the configuration."""

    t_s: float
    gateway: GatewayRow
    drives: tuple[DriveRow, ...]
    link: LinkRow
    lateness: Lateness
    events: tuple[Event, ...]
    """The last 200 of them, oldest first."""
    span_s: tuple[float, float] | None = None
    """From where to where one can seek; None on a bus."""
    history: tuple[Trace, ...] = ()
    """A trace per drive, of the last 60 s."""


_WORDS: Final[Mapping[str, Mapping[Flag, str]]] = {
    "adhesion": ADHESION,
    "common_mode": COMMON,
}


def word(name: str, value: IntEnum) -> str:
    """An enumeration's name as the DBC has it; a flag's depends on the field, `name`."""
    if isinstance(value, Flag):
        return _WORDS.get(name, FAULT)[value]
    return camel(value.name)


def as_json(snapshot: Snapshot, *, history: bool = False) -> dict[str, Any]:
    """The snapshot as plain JSON: keys are the fields' names, None where nothing is known.

    history: with the traces, which are large; else the key is left out.
    """
    if not history:
        snapshot = snapshot._replace(history=())
    plain: dict[str, Any] = _plain("", snapshot)
    if not history:
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
