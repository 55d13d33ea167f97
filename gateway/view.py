"""What one tick says, as objects: for reports, displays and tests. The loop works on `said`.

Made when somebody asks, which a replay without a report does once a change.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

from dbc.frame import Nanos
from gateway.health import NEVER, FaultClass, FaultSensor, Flag, GatewayState, Health, Reason
from gateway.heatside import Wear
from gateway.said import Said, Whole

_FLAGS: Final = tuple(Flag)
_REASONS: Final = tuple(Reason)
_HEALTH: Final = tuple(Health)
_CLASSES: Final = tuple(FaultClass)
_SENSORS: Final = tuple(FaultSensor)
"""By number: the enumerations' own look-up takes longer."""


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


class Counted(NamedTuple):
    """What `Gateway_Status` and `Gateway_Info` say beside the state. None: not known."""

    deadline_misses: int
    rejected: int
    lost: int
    bus_load_percent: float | None
    latency_p99_us: float | None
    lateness_p99_us: float | None


def drives_of(said: Said, nodes: Sequence[int], wear: Sequence[Wear]) -> tuple[DriveView, ...]:
    """Of every drive. wear: what is known of its degradation."""
    words = zip(
        said.adhesion.tolist(), said.adhesion_reason.tolist(), said.thermal.tolist(),
        said.thermal_reason.tolist(), said.sensor.tolist(), said.comm.tolist(),
        said.estimator.tolist(), said.health.tolist(), said.fault_class.tolist(),
        said.fault_sensor.tolist(), strict=True,
    )  # fmt: skip
    numbers = zip(
        said.speed.tolist(), said.load.tolist(), said.sigma.tolist(), said.lost.tolist(),
        said.nis.tolist(), said.mixed_c.tolist(), said.maisd_k.tolist(), strict=True,
    )  # fmt: skip
    ages = zip(said.age_ns.tolist(), said.temperature_age_ns.tolist(), strict=True)
    rows = zip(nodes, words, numbers, ages, wear, strict=True)
    return tuple(_drive(*row) for row in rows)


def _drive(
    node: int, word: tuple[int, ...], number: tuple[float, ...], age: tuple[int, int], wear: Wear
) -> DriveView:
    adhesion, why, thermal, why_thermal, sensor, comm, estimator, health, kind, whose = word
    speed, load, sigma, lost, nis, mixed, maisd = (_known(x) for x in number)
    own, temperature = (None if a == NEVER else a for a in age)
    return DriveView(
        node, _FLAGS[adhesion], _REASONS[why], _FLAGS[thermal], _REASONS[why_thermal],
        _FLAGS[sensor], _FLAGS[comm], _FLAGS[estimator], _HEALTH[health], speed, load, sigma, lost,
        nis, own, _CLASSES[kind], _SENSORS[whose], mixed, maisd, wear, temperature,
    )  # fmt: skip


def _known(number: float) -> float | None:
    # Quicker than math.isnan.
    return None if number != number else number  # noqa: PLR0124


def view_of(
    t_ns: Nanos,
    said: Said,
    drives: tuple[DriveView, ...],
    common_load_nm: float | None,
    counted: Counted,
) -> GatewayView:
    """Of the whole set."""
    whole = said.whole.tolist()
    sensor, comm, estimator, overrun, common = (
        _FLAGS[whole[k]]
        for k in (Whole.SENSOR, Whole.COMM, Whole.ESTIMATOR, Whole.OVERRUN, Whole.COMMON_MODE)
    )
    return GatewayView(
        t_ns, drives, whole[Whole.DETECTOR], common, common_load_nm,
        _REASONS[whole[Whole.ADHESION_REASON]], _REASONS[whole[Whole.FAULTS_REASON]],
        sensor, comm, estimator, overrun, GatewayState(whole[Whole.STATE]), *counted,
    )  # fmt: skip
