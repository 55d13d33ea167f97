"""The result of one tick as objects, for reports, displays and tests. The loop uses `Status`.

They are made on demand: a replay without a report asks for them once per change.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

from dbc.frame import Nanos
from gateway.core.codes import NEVER, FaultClass, FaultSensor, Flag, GatewayState, Health, Reason
from gateway.core.flags import Status

_FLAGS: Final = tuple(Flag)
_REASONS: Final = tuple(Reason)
_HEALTH: Final = tuple(Health)
_CLASSES: Final = tuple(FaultClass)
_SENSORS: Final = tuple(FaultSensor)
"""Members by number, because the enumerations' own look-up takes longer."""


class Wear(NamedTuple):
    """How a motor grows warmer than the others.

    rate_k_h, sigma_k_h: None while data are too few; hours: until the motor is at its limit, None
    if it may never be; jumps: steps of its sensors.
    """

    rate_k_h: float | None = None
    sigma_k_h: float | None = None
    hours: float | None = None
    jumps: int = 0


class DriveView(NamedTuple):
    """State of one drive at a tick. None means not known."""

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
    """Result of one tick: the drives, the set's own state, the counters."""

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


def drives_of(status: Status, nodes: Sequence[int], wear: Sequence[Wear]) -> tuple[DriveView, ...]:
    """View of every drive. wear: what is known of its degradation."""
    drives = status.drives
    rows = zip(
        nodes, drives["flag"]["state"].tolist(), drives[_WORDS].tolist(),
        drives[_NUMBERS].tolist(), drives[_AGES].tolist(), wear, strict=True,
    )  # fmt: skip
    return tuple(_drive(*row) for row in rows)


_WORDS: Final = ["adhesion_reason", "thermal_reason", "health", "fault_class", "fault_sensor"]
_NUMBERS: Final = ["speed_rad_s", "load_nm", "load_sigma_nm", "loss_probability", "nis", "mixed_c",
                   "maisd_k"]  # fmt: skip
_AGES: Final = ["age_ns", "temperature_age_ns"]


def _drive(
    node: int, flags: Sequence[int], words: tuple[int, ...], numbers: tuple[float, ...],
    ages: tuple[int, int], wear: Wear,
) -> DriveView:  # fmt: skip
    adhesion, thermal, comm, estimator, sensor = (_FLAGS[flag] for flag in flags)
    why, why_thermal, health, kind, whose = words
    speed, load, sigma, lost, nis, mixed, maisd = (_known(x) for x in numbers)
    own, temperature = (None if a == NEVER else a for a in ages)
    return DriveView(
        node, adhesion, _REASONS[why], thermal, _REASONS[why_thermal], sensor, comm, estimator,
        _HEALTH[health], speed, load, sigma, lost, nis, own, _CLASSES[kind], _SENSORS[whose],
        mixed, maisd, wear, temperature,
    )  # fmt: skip


def _known(number: float) -> float | None:
    # Quicker than math.isnan.
    return None if number != number else number  # noqa: PLR0124


def view_of(
    t_ns: Nanos,
    status: Status,
    drives: tuple[DriveView, ...],
    common_load_nm: float | None,
    **counts: Any,
) -> GatewayView:
    """View of the whole set. counts: the fields of `GatewayView` from `deadline_misses` on."""
    train = status.train[0]
    sensor, comm, estimator, overrun, common = (
        _FLAGS[train[name]] for name in ("sensor", "comm", "estimator", "overrun", "common_mode")
    )
    return GatewayView(
        t_ns, drives, int(train["detector"]), common, common_load_nm,
        _REASONS[train["adhesion_reason"]], _REASONS[train["faults_reason"]],
        sensor, comm, estimator, overrun, GatewayState(int(train["state"])), **counts,
    )  # fmt: skip
