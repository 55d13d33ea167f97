"""Rows of the display from the last accepted values of each message. Pure.

A value that is too old, not valid or contradictory is None or unknown, not the last good value.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import Final, TypeVar

from dbc.frame import MS, Nanos
from gateway.core.channel import RPM
from gateway.core.codes import FaultClass, FaultSensor, Flag, GatewayState, Health, Reason
from gateway.core.supervision import Life, NodeState
from gateway.core.view import DriveView, GatewayView
from gateway.monitor.model.snapshot import DriveRow, GatewayRow
from gateway.monitor.model.tracks import LEAST_LIMIT_NS, NOTHING, Seen, Track

Tracks = Mapping[str, Track]
Enum = TypeVar("Enum", bound=IntEnum)
NMT: Final = {0: "BootUp", 4: "Stopped", 5: "Operational", 127: "PreOperational"}
SILENT: Final = "Silent"
SET_FLAGS: Final = ("common_mode", "sensor_fault", "comm_fault", "estimator_fault", "overrun")
"""Flags of the train: fields of `GatewayRow`."""
_FLAGS: Final[dict[int | None, Flag]] = {1: Flag.GOOD, 2: Flag.BAD}
DETECTORS: Final = {
    1: "VariationalBayes", 2: "VariationalMessagePassing", 3: "KMeans", 4: "Median",
    5: "Switching",
}  # fmt: skip
"""Names for a shadow, which has only numbers; for frames the labels of the DBC are used."""


def heartbeat(state: NodeState | None) -> str | None:
    """NMT state by name; Silent if the heartbeat has stopped; None if it was never received."""
    if state is None or state.life is Life.NEVER_SEEN:
        return None
    return SILENT if state.life is Life.LOST else NMT.get(state.nmt_state, SILENT)


def flag(seen: Seen, name: str) -> Flag:
    """Flag from two antivalent bits: any value other than 1 and 2 is unknown."""
    return _FLAGS.get(seen.raw(name), Flag.UNKNOWN)


def chosen(kind: type[Enum], raw: int | None) -> Enum | None:
    """Member of an enumeration by its number; None if there is no such member."""
    try:
        return None if raw is None else kind(raw)
    except ValueError:
        return None


def _whole(seen: Seen, name: str) -> int | None:
    value = seen.number(name)
    return None if value is None else round(value)


def gateway_row(tracks: Tracks, now: Nanos) -> GatewayRow:
    """The row of the gateway, from its own frames."""
    four = [tracks[f"Gateway_{name}"] for name in ("Adhesion", "Faults", "Info", "Status")]
    adhesion, faults, info, status = [track.seen(now) for track in four]
    good_ns = four[0].good_ns
    alive = four[0].fresh(now) and now - good_ns <= LEAST_LIMIT_NS
    word = info.raw("ConfigHash")
    return GatewayRow(
        alive=alive,
        present=any(track.good_ns >= 0 for track in four),
        source="bus" if alive else "none",
        state=chosen(GatewayState, status.raw("State")),
        reason=chosen(Reason, adhesion.raw("Reason")),
        thermal_reason=chosen(Reason, faults.raw("Reason")),
        age_ms=adhesion.number("Age"),
        flags_age_ms=(now - good_ns) / MS if good_ns >= 0 else None,
        detector=adhesion.label("Detector"),
        common_mode=flag(adhesion, "CommonMode"),
        sensor_fault=flag(faults, "SensorFault"),
        comm_fault=flag(faults, "CommFault"),
        estimator_fault=flag(faults, "EstimatorFault"),
        overrun=flag(faults, "Overrun"),
        deadline_misses=_whole(status, "DeadlineMisses"),
        rejected=_whole(status, "RejectedFrames"),
        lost_frames=_whole(status, "LostFrames"),
        bus_load_pct=status.number("BusLoad"),
        config_hash=None if word is None else f"{word:06x}",
        latency_p99_us=info.number("LatencyP99"),
        lateness_p99_us=info.number("LatenessP99"),
    )


def flag_values(tracks: Tracks, node: int, now: Nanos) -> tuple[Flag, Flag, Health]:
    """Adhesion and thermal flag and health of one drive, from the gateway's frames."""
    estimate = tracks[f"Drive{node}_Estimate"].seen(now)
    return (
        flag(tracks["Gateway_Adhesion"].seen(now), f"Adhesion{node}"),
        flag(tracks["Gateway_Faults"].seen(now), f"Thermal{node}"),
        chosen(Health, estimate.raw("Health")) or Health.UNKNOWN,
    )


def drive_row(tracks: Tracks, node: int, now: Nanos) -> DriveRow:
    """The row of a drive, from frames about and by it; without heartbeat and shadow values."""
    estimate = tracks[f"Drive{node}_Estimate"].seen(now)
    thermal = tracks[f"Drive{node}_Thermal"].seen(now)
    adhesion, heat, health = flag_values(tracks, node, now)
    speed, lost = estimate.number("Speed"), estimate.number("LossProbability")
    row = DriveRow(
        node=node,
        adhesion=adhesion,
        thermal=heat,
        health=health,
        speed_rad_s=None if speed is None else speed * RPM,
        load_nm=estimate.number("LoadTorque"),
        loss_probability=None if lost is None else lost / 100.0,
        nis=estimate.number("Nis"),
        mixed_c=thermal.number("Tmixed"),
        maisd_k=thermal.number("Maisd"),
        fault_class=chosen(FaultClass, thermal.raw("FaultClass")) or FaultClass.UNKNOWN,
        fault_sensor=chosen(FaultSensor, thermal.raw("FaultSensor")),
        jumps=_whole(thermal, "Jumps"),
        degradation_k_h=thermal.number("DegradationRate"),
    )
    return _with_own_word(row, tracks, now)


def _with_own_word(row: DriveRow, tracks: Tracks, now: Nanos) -> DriveRow:
    """The row with the drive's own values, as far as the drive marks them as usable."""
    motion, points, status = (
        _own(tracks, f"Drive{row.node}_{kind}", now)
        for kind in ("Motion", "Temperatures", "Status")
    )
    speed = motion.number("Speed")
    return row._replace(
        measured_speed_rad_s=None if speed is None else speed * RPM,
        stator_c=points.number("Tstator"),
        drive_end_c=points.number("Tde"),
        non_drive_end_c=points.number("Tnde"),
        ambient_c=points.number("Tambient"),
        state=status.label("State"),
    )


def _own(tracks: Tracks, name: str, now: Nanos) -> Seen:
    """Values of a drive's own message; none if it marks them unusable or the DBC lacks it."""
    track = tracks.get(name)
    seen = NOTHING if track is None else track.seen(now)
    return seen if seen.usable else NOTHING


def shadow_gateway(row: GatewayRow, view: GatewayView) -> GatewayRow:
    """The row of the gateway with values of a shadow, for a bus without a gateway."""
    return row._replace(
        source="shadow", state=view.state, reason=view.adhesion_reason,
        thermal_reason=view.faults_reason, detector=DETECTORS.get(view.detector),
        common_mode=view.common_mode, sensor_fault=view.sensor, comm_fault=view.comm,
        estimator_fault=view.estimator, overrun=view.overrun, rejected=view.rejected,
        lost_frames=view.lost,
    )  # fmt: skip


def shadow_drive(row: DriveRow, view: DriveView) -> DriveRow:
    """The row of a drive with values of a shadow."""
    return row._replace(
        adhesion=view.adhesion, thermal=view.thermal, health=view.health,
        speed_rad_s=view.speed_rad_s, load_nm=view.load_nm, load_sigma_nm=view.load_sigma_nm,
        loss_probability=view.loss_probability, nis=view.nis, mixed_c=view.mixed_c,
        maisd_k=view.maisd_k, fault_class=view.fault_class, fault_sensor=view.fault_sensor,
        jumps=view.wear.jumps if view.wear.rate_k_h is not None else None,
        degradation_k_h=view.wear.rate_k_h,
    )  # fmt: skip
