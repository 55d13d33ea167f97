"""A snapshot as Prometheus metrics. Pure. An unknown value has no sample, not a NaN.

Names and units follow <https://prometheus.io/docs/practices/naming/>: base units, in the name. A
flag is 0 unknown, 1 good, 2 bad, as on the bus. A state has a sample for each possible state, named
by a label: the present state is 1, the others are 0; all are 0 while it is not known.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from enum import IntEnum
from functools import partial
from typing import TYPE_CHECKING, Final

from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
)
from prometheus_client.registry import Collector

from gateway.core.codes import FaultClass, GatewayState, Health, Reason
from gateway.monitor.model.rows import SET_FLAGS
from gateway.monitor.model.snapshot import DriveRow, GatewayRow, Lateness, LinkRow, Snapshot, word

if TYPE_CHECKING:
    from prometheus_client import Metric

    from gateway.monitor.feed import Feed

PREFIX: Final = "traction_gateway_"
FLAG_HELP: Final = "0 unknown, 1 good, 2 bad"
POINTS: Final = {
    "stator": "stator_c", "drive_end": "drive_end_c", "non_drive_end": "non_drive_end_c",
    "ambient": "ambient_c", "mixed": "mixed_c",
}  # fmt: skip
DRIVE_GAUGES: Final = (
    ("speed_radians_per_second", "speed_rad_s", "Estimated mechanical speed"),
    ("measured_speed_radians_per_second", "measured_speed_rad_s", "The drive's own speed"),
    ("load_torque_newton_meters", "load_nm", "Estimated load torque"),
    (
        "load_torque_sigma_newton_meters",
        "load_sigma_nm",
        "Standard deviation of the load torque, from the shadow gateway",
    ),
    ("loss_probability_ratio", "loss_probability", "Probability that adhesion is lost"),
    ("nis", "nis", "Normalised innovation squared of the estimator"),
    ("maisd_kelvin", "maisd_k", "MAISD: moving average inter-state standard deviation"),
    ("temperature_jumps", "jumps", "Jumps of temperature sensors, as the gateway counts them"),
    ("degradation_kelvin_per_hour", "degradation_k_h", "Trend of the thermal deviation"),
    ("last_frame_age_seconds", "age_s", "Since the drive's last good frame"),
)
DRIVE_STATES: Final = {
    "state": ("Off", "Ready", "Operation", "Fault"),
    "heartbeat": ("BootUp", "Stopped", "Operational", "PreOperational", "Silent"),
}
LINK_STATES: Final = ("active", "warning", "passive", "bus-off", "absent", "down")
LEVELS: Final = ("info", "warning", "error")
US: Final = 1e-6
REPORTED: Final = "as the gateway reports it"
Samples = Iterable[tuple[tuple[str, ...], float | None]]
"""Label values and a number for each sample; a number of None gives no sample."""


class FeedCollector(Collector):
    """The newest picture of a feed, at each scrape; without metrics of it before the first."""

    def __init__(self, feed: Feed) -> None:
        """feed: only read, never changed."""
        self._feed = feed

    def collect(self) -> Iterable[Metric]:
        """Yield all metrics."""
        feed = self._feed
        if feed.picture is not None:
            yield from of_snapshot(feed.picture.shown)
        viewers: Samples = [((), feed.viewers)]
        yield _gauge("monitor_viewers", "Pages that look at this monitor", viewers)
        refused: Samples = [((cause,), n) for cause, n in sorted(feed.counts.items())]
        yield _counter("monitor_refused", "Viewers and requests turned away", refused, ("cause",))
        events: Samples = [((level,), feed.happened[level]) for level in LEVELS]
        yield _counter("events", "Events seen, by level", events, ("level",))


def of_snapshot(shown: Snapshot) -> Iterator[Metric]:
    """Yield all metrics of a snapshot."""
    yield from _of_gateway(shown.gateway)
    yield from _of_drives(shown.drives)
    yield from _of_link(shown.link)
    if shown.lateness.counts:
        yield _histogram(shown.lateness)


def _of_gateway(row: GatewayRow) -> Iterator[Metric]:
    labels = {"config_hash": row.config_hash, "detector": row.detector, "source": row.source}
    text = "Configuration hash and detector that the gateway reports, and their source"
    about = InfoMetricFamily(PREFIX.rstrip("_"), text)
    about.add_metric([], {key: value for key, value in labels.items() if value is not None})
    yield about
    flags: Samples = [((name,), int(getattr(row, name))) for name in SET_FLAGS]
    yield _gauge("flag", f"Flags of the set: {FLAG_HELP}", flags, ("flag",))
    state = [((), _name(row.state))]
    yield _state("state", "State of the gateway", _names(GatewayState), state)
    reasons = [(("adhesion",), _name(row.reason)), (("thermal",), _name(row.thermal_reason))]
    yield _state("reason", "Why flags are unknown", _names(Reason), reasons, ("flags",))
    for name, text, value, scale in (
        ("alive", "1 if flags of the last 100 ms were received", int(row.alive), 1),
        ("heard", "1 if a gateway was ever seen on this bus", int(row.present), 1),
        ("sample_age_seconds", "Oldest sample that the flags rest on", row.age_ms, 1e-3),
        ("flags_age_seconds", "Since the last accepted flag frame", row.flags_age_ms, 1e-3),
        ("latency_p99_seconds", f"Reception to flag, {REPORTED}", row.latency_p99_us, US),
        ("lateness_p99_seconds", f"Ticks behind time, {REPORTED}", row.lateness_p99_us, US),
        ("reported_bus_load_ratio", f"Bus load, {REPORTED}", row.bus_load_pct, 0.01),
    ):
        yield _gauge(name, text, [((), None if value is None else value * scale)])
    for name, text, count in (
        ("deadline_misses", "Ticks missed", row.deadline_misses),
        ("rejected_frames", "Frames rejected", row.rejected),
        ("lost_frames", "Frames lost", row.lost_frames),
    ):
        # To Prometheus a saturated counter that starts again is like any restart.
        yield _counter(name, f"{text}, {REPORTED}; saturates at 4094", [((), count)])


def _of_drives(rows: Iterable[DriveRow]) -> Iterator[Metric]:
    drives = [(str(row.node), row) for row in rows]
    for name in ("adhesion", "thermal"):
        flags: Samples = [((drive,), int(getattr(row, name))) for drive, row in drives]
        text = f"{name.capitalize()} flag of a drive: {FLAG_HELP}"
        yield _gauge(f"drive_{name}", text, flags, ("drive",))
    for name, field, text in DRIVE_GAUGES:
        values: Samples = [((drive,), getattr(row, field)) for drive, row in drives]
        yield _gauge(f"drive_{name}", text, values, ("drive",))
    points: Samples = [
        ((drive, point), getattr(row, field))
        for drive, row in drives
        for point, field in POINTS.items()
    ]
    text = "Temperatures of a drive; `mixed` is the estimator's state"
    yield _gauge("drive_temperature_celsius", text, points, ("drive", "point"))
    for name, kind, text in (
        ("health", Health, "Health of a drive's estimate"),
        ("fault_class", FaultClass, "Kind of thermal fault"),
    ):
        samples = [((drive,), _name(getattr(row, name))) for drive, row in drives]
        yield _state(f"drive_{name}", text, _names(kind), samples, ("drive",))
    for name, every in DRIVE_STATES.items():
        own = [((drive,), getattr(row, name)) for drive, row in drives]
        yield _state(f"drive_{name}", f"The drive's own {name}", every, own, ("drive",))
    rejected: Samples = [((drive,), row.rejected) for drive, row in drives]
    text = "Frames of a drive that failed protection, seen here"
    yield _counter("drive_rejected_frames", text, rejected, ("drive",))


def _of_link(row: LinkRow) -> Iterator[Metric]:
    yield _state("link_state", "Bus state seen by this monitor", LINK_STATES, [((), row.state)])
    load = None if row.bus_load_pct is None else row.bus_load_pct / 100
    text = "Measured bus load, worst-case stuffing"
    yield _gauge("link_bus_load_ratio", text, [((), load)])
    yield _gauge("link_frames_per_second", "Frames received", [((), row.frames_s)])
    for name, text, count in (
        ("link_received_frames", "Frames received", row.received),
        ("link_error_frames", "Error frames received", row.error_frames),
        ("link_unread_frames", "Frames that the kernel dropped before this monitor", row.unread),
    ):
        yield _counter(name, text, [((), count)])
    rejected: Samples = [((cause,), count) for cause, count in row.rejected.items()]
    yield _counter("link_rejected_frames", "Frames that were not used", rejected, ("cause",))


def _histogram(late: Lateness) -> Metric:
    """Cumulative histogram by upper edge, without a sum: values inside a bin are not known."""
    buckets, below = [], 0
    for edge_us, count in zip(late.edges_us[1:], late.counts, strict=True):
        below += count
        buckets.append((repr(edge_us / 1e6), float(below)))
    buckets.append(("+Inf", float(max(late.total, below))))
    family = HistogramMetricFamily(
        PREFIX + "flag_lateness_seconds",
        "How far behind its schedule each flag frame came, seen on the bus",
        buckets=buckets,
    )
    family.add_sample(family.name + "_count", {}, buckets[-1][1])
    return family


def _family(
    kind: type[GaugeMetricFamily | CounterMetricFamily], name: str, text: str, samples: Samples,
    labels: tuple[str, ...] = (),
) -> Metric:  # fmt: skip
    family = kind(PREFIX + name, text, labels=labels)
    for values, number in samples:
        if number is not None:
            family.add_metric(values, number)
    return family


_gauge = partial(_family, GaugeMetricFamily)
_counter = partial(_family, CounterMetricFamily)
"""A counter; the client adds `_total` to its name."""


def _state(
    name: str,
    text: str,
    every: Iterable[str],
    current: Iterable[tuple[tuple[str, ...], str | None]],
    labels: tuple[str, ...] = (),
) -> Metric:
    """A sample for each state; its label is the metric's name without `drive_` and `link_`."""
    label = name.removeprefix("drive_").removeprefix("link_")
    numbers: Samples = [
        ((*values, state), int(state == now)) for values, now in current for state in every
    ]
    return _gauge(name, text, numbers, (*labels, label))


def _names(kind: type[IntEnum]) -> tuple[str, ...]:
    return tuple([word("", member) for member in kind])


def _name(value: IntEnum | None) -> str | None:
    return None if value is None else word("", value)
