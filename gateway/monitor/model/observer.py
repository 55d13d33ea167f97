"""The observer: from the frames of all nodes to a snapshot for the displays. Pure, bounded.

It receives the bus as any other node does, with the same codec and the same E2E rules, and sends
nothing. It works on its own time grid, one step per period from the first frame on, so that the
result does not depend on how the frames are divided between calls.

A shadow, a `Gateway` on the same frames, runs beside it. The uncertainty of the load torque, which
is not on the bus, is the shadow's, as long as the shadow agrees with the bus.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter, deque
from collections.abc import Iterable
from copy import deepcopy
from typing import Final

from dbc.codec import Codec
from dbc.e2e import counter_of
from dbc.frame import ERROR, FD, REMOTE, SECOND, Frame, Nanos
from dbc.frames import EMPTY, Block, block_of, join
from dbc.spec import EXTENDED_KEY, Match, MessageSpec
from gateway.core.busload import BusLoad
from gateway.core.codes import Health
from gateway.core.gateway import HEARTBEAT_LIMIT_NS, Gateway
from gateway.core.supervision import GATEWAY_NODE, Supervision
from gateway.core.view import GatewayView
from gateway.io.wire import BusState, bus_state
from gateway.monitor.model.incidents import ERROR as GRAVE
from gateway.monitor.model.incidents import MARK, WARNING, Happenings
from gateway.monitor.model.rows import (
    drive_row,
    flag_values,
    gateway_row,
    heartbeat,
    shadow_drive,
    shadow_gateway,
)
from gateway.monitor.model.schedule import Schedule
from gateway.monitor.model.snapshot import DriveRow, GatewayRow, Lateness, LinkRow, Snapshot
from gateway.monitor.model.traces import POINT_NS, Recent
from gateway.monitor.model.tracks import Track
from gateway.settings.config import Config

QUIET_NS: Final[Nanos] = 10 * SECOND
"""Time after the last frame, after which no state changes any more."""
MOST_HELD: Final = 20_000
"""Most frames that wait for the end of a period; only a log with odd stamps has more in one."""
AGREES: Final = 5
"""Past ticks in which the shadow's estimate may agree with the present one on the bus, which is
sent every 20 ms."""
TRACED: Final = ("adhesion", "thermal", "health")
SECOND_SENDERS: Final = ("repeated", "wrong_sequence")
SIGMAS: Final = 0.5
"""Largest difference of the shadow's load from that on the bus, as share of its uncertainty."""
STEP_NM: Final = 0.1
"""Resolution of `LoadTorque` on the bus."""


class Observer:
    """All state of a monitor. Frames enter by `add_frames` only; memory is always bounded."""

    def __init__(self, codec: Codec, config: Config, *, show_shadow: bool = False) -> None:
        """Raises ConfigError if configuration, calibration and DBC do not fit together.

        show_shadow: without a gateway on the bus, show flags and estimates of the shadow, marked.
        """
        self.codec = codec
        self.config = config
        self.nodes = config.nodes
        self._show_shadow = show_shadow
        self._period_ns = config.loop.period_ns
        wanted = (0, *config.nodes)
        specs = [s for s in codec.messages if s.node in wanted and (s.node or s.is_gateway)]
        self.tracks = {s.name: Track(codec, s, self._period_ns) for s in specs}
        self._by_key = {s.key: self.tracks[s.name] for s in specs}
        self._own = {
            n: [t for t in self.tracks.values() if t.spec.node == n and not t.spec.is_gateway]
            for n in config.nodes
        }
        self._quiet_ns = max([QUIET_NS, *(t.limit_ns for t in self.tracks.values())]) + SECOND
        self._supervision = Supervision(
            (*config.nodes, GATEWAY_NODE), HEARTBEAT_LIMIT_NS, config.canopen.heartbeat_ns
        )
        self._emergencies = dict.fromkeys(self._supervision.nodes, 0)
        self._happenings = Happenings()
        self._recent = Recent(config.nodes)
        self._schedule = Schedule(codec.by_name["Gateway_Adhesion"].cycle_ns)
        self.counts: Counter[str] = Counter()
        """Frames by cause: `believed` (accepted), canopen, unknown_id, and reasons of rejection."""
        self._received = self._window = 0
        self._frames_s: float | None = None
        self._bus_state = self._last_bus_state = BusState.ACTIVE
        self._doubled: set[str] = set()
        """Names of messages that two nodes send."""
        self._hash: str | None = None
        self._load = BusLoad(config.bus.bitrate, config.bus.data_bitrate, 0)
        self._window_ns: Nanos = 0
        self.first_ns: Nanos | None = None
        self._now: Nanos = 0
        self._received_ns: Nanos = 0
        self._held = EMPTY
        # Made here, because it checks the configuration; replaced at the first frame.
        self._shadow = Gateway(config, codec, 0)
        self._own_hash = f"{self._shadow.outbox.config_hash:06x}"
        self._estimates: dict[int, deque[tuple[Health, float, float]]] = {
            n: deque(maxlen=AGREES) for n in config.nodes
        }

    def add_frames(self, frames: Iterable[Frame] | Block, now: Nanos) -> None:
        """Process frames received until `now`, in calls of any size. Never raises on wire data."""
        block = frames if isinstance(frames, Block) else block_of(frames)
        good = (block.t_ns >= 0) & (block.t_ns <= now)
        if not good.all():
            self.counts["time_back"] += int(block.size - good.sum())
            block = block.pick(good)
        if self.first_ns is None:
            if not block.size:
                return
            self._begin(int(block.t_ns.min()))
        held = join(self._held, block.ordered())
        self._held = EMPTY
        if block.size and not bool((held.t_ns[1:] >= held.t_ns[:-1]).all()):
            held = held.ordered()
        stamps, done = held.t_ns.tolist(), 0
        while True:
            following = self._now + self._period_ns
            if following > now:
                break
            end = bisect_right(stamps, following, done)
            if end == done and following - self._received_ns > self._quiet_ns:
                # No state can change before the next frame.
                until = min(now, stamps[done] if done < len(stamps) else now)
                self._now += max((until - self._now) // self._period_ns, 1) * self._period_ns
                if self._now < until:
                    continue
                end = bisect_right(stamps, self._now, done)
                if end == done:
                    continue
                following = self._now
            self._now = following
            self._tick(held.part(done, end), following)
            done = end
        kept = min(held.size, done + MOST_HELD)
        self.counts["flood"] += held.size - kept
        self._held = held.part(done, kept) if done < kept else EMPTY

    def copy(self) -> Observer:
        """A copy of the state; codec and configuration, which never change, are shared."""
        shared = (self.codec, self.config, self.codec.messages, *self.codec.messages)
        return deepcopy(self, {id(item): item for item in shared})

    def note_dropped(self, frames: int) -> None:
        """Count frames of a log that were dropped because their time goes back."""
        self.counts["time_back"] += frames

    def snapshot(self, now: Nanos) -> Snapshot:
        """The state at the last step of the grid up to `now`."""
        self.add_frames(EMPTY, now)
        at = self._now
        gateway, drives = self._rows(at)
        return Snapshot(
            t_s=(at - self.first_ns) / SECOND if self.first_ns is not None else 0.0,
            gateway=gateway,
            drives=drives,
            link=self._link(at),
            lateness=self._schedule.lateness() if gateway.present else Lateness(),
            events=tuple(self._happenings.events),
            history=self._recent.traces(),
        )

    def _begin(self, first_ns: Nanos) -> None:
        self.first_ns = first_ns
        # The first step is at the first frame itself.
        self._now = first_ns - self._period_ns
        self._window_ns = self._received_ns = first_ns
        self._happenings.begin(first_ns)
        self._load = BusLoad(self.config.bus.bitrate, self.config.bus.data_bitrate, first_ns)
        self._shadow = Gateway(self.config, self.codec, first_ns)

    def _tick(self, block: Block, now: Nanos) -> None:
        if block.size:
            self._received_ns = now
            self._received += block.size
            self._window += block.size
        if now - self._window_ns >= SECOND:
            self._frames_s = self._window * SECOND / (now - self._window_ns)
            self._window, self._window_ns = 0, now
        self._load.add_block(block, None, now)
        stamps, ids, flags = block.t_ns.tolist(), block.can_id.tolist(), block.flags.tolist()
        lengths = block.length.tolist()
        for k, (t_ns, can_id, mark, length) in enumerate(
            zip(stamps, ids, flags, lengths, strict=True)
        ):
            track = self._by_key.get(can_id | (EXTENDED_KEY if mark & 1 else 0))
            if track is None or mark & (ERROR | REMOTE):
                self._other(block.frame(k))
                continue
            spec = track.spec
            match = _match(spec, mark, length)
            data = block.data[k, :length].tobytes()
            cause = track.add_frame(match, data, t_ns)
            self.counts[cause or "believed"] += 1
            if cause in SECOND_SENDERS and track.doubled(t_ns) and spec.name not in self._doubled:
                self._doubled.add(spec.name)
                text = f"two nodes send {spec.name}: both are rejected"
                self._happenings.note(t_ns, GRAVE, spec.node or None, text)
            if cause is None and spec.name == "Gateway_Adhesion":
                counter = counter_of(spec, data)
                self._schedule.observe(t_ns, 0 if counter is None else counter)
        self._shadow.step(block, now)
        self._note(now)

    def _other(self, frame: Frame) -> None:
        """Process heartbeats, emergencies, error frames, and frames that no message claims."""
        if frame.flags & ERROR:
            self.counts["error_frame"] += 1
            self._bus_state = bus_state(frame, self._bus_state)
            return
        known = self._supervision.observe(frame)
        remote = bool(frame.flags & REMOTE) and not known
        self.counts["canopen" if known else "remote" if remote else "unknown_id"] += 1
        node = frame.can_id & 0x7F
        if known and node in self._emergencies:
            log = self._supervision.emcy[node]
            if log.received > self._emergencies[node]:
                self._emergencies[node] = log.received
                self._happenings.emergency(None if node == GATEWAY_NODE else node, log.recent[-1])

    def _note(self, now: Nanos) -> None:
        """End a step: add events for changes, and every `POINT_NS` a point to the traces."""
        happenings, view = self._happenings, self._shadow.view
        if view is not None:
            for d in view.drives:
                if d.load_nm is not None and d.load_sigma_nm is not None:
                    self._estimates[d.node].append((d.health, d.load_nm, d.load_sigma_nm))
                else:
                    self._estimates[d.node].clear()
        gateway = gateway_row(self.tracks, now)
        shown = self._instead(gateway)
        if shown is not None:
            gateway = shadow_gateway(gateway, shown)
        if self._bus_state is not self._last_bus_state:
            self._last_bus_state = self._bus_state
            happenings.link(now, self._bus_state)
        happenings.gateway(now, gateway)
        gone = gateway.present and gateway.source == "none"
        for k, node in enumerate(() if gone else self.nodes):
            if shown is None:
                values, mark = flag_values(self.tracks, node, now), ""
            else:
                drive = shown.drives[k]
                values, mark = (drive.adhesion, drive.thermal, drive.health), MARK
            for name, value in zip(TRACED, values, strict=True):
                happenings.state(now, name, node, value, mark)
        for node in self.nodes:
            status = self.tracks.get(f"Drive{node}_Status")
            if status is not None:
                happenings.drive_state(now, node, status.seen(now).label("State"))
        for node, state in self._supervision.states(now).items():
            happenings.heartbeat(
                now, node, None if node == GATEWAY_NODE else node, heartbeat(state)
            )
        if (word := gateway.config_hash) is not None and word != self._hash:
            self._hash = word
            if word != self._own_hash:
                text = (
                    f"gateway has configuration {word}, this monitor {self._own_hash}: no sigma is "
                    "shown"
                )
                happenings.note(now, WARNING, None, text)
        for name in [name for name in self._doubled if not self.tracks[name].doubled(now)]:
            self._doubled.remove(name)
        if self.first_ns is not None and (now - self.first_ns) % POINT_NS < self._period_ns:
            self._recent.append((now - self.first_ns) / SECOND, self._rows(now)[1])

    def _instead(self, gateway: GatewayRow) -> GatewayView | None:
        """The shadow's view if it is shown in place of a gateway, else None."""
        return self._shadow.view if self._show_shadow and not gateway.alive else None

    def _rows(self, now: Nanos) -> tuple[GatewayRow, tuple[DriveRow, ...]]:
        states = self._supervision.states(now)
        gateway = gateway_row(self.tracks, now)._replace(
            heartbeat=heartbeat(states.get(GATEWAY_NODE))
        )
        view = self._shadow.view
        shown = self._instead(gateway)
        if shown is not None:
            gateway = shadow_gateway(gateway, shown)
        rows = []
        for k, node in enumerate(self.nodes):
            row = drive_row(self.tracks, node, now)
            if shown is not None:
                row = shadow_drive(row, shown.drives[k])
            elif view is not None:
                row = row._replace(load_sigma_nm=self._sigma(row))
            good_ns = max((t.good_ns for t in self._own[node]), default=-1)
            rows.append(
                row._replace(
                    heartbeat=heartbeat(states.get(node)),
                    rejected=sum([t.rejected for t in self._own[node]]),
                    age_s=(now - good_ns) / SECOND if good_ns >= 0 else None,
                )
            )
        return gateway, tuple(rows)

    def _sigma(self, row: DriveRow) -> float | None:
        """The shadow's uncertainty, if one of its latest estimates agrees with that on the bus.

        None if the gateway has another configuration: then they would agree only by chance.
        """
        if row.load_nm is None or self._hash not in (None, self._own_hash):
            return None
        near = [
            (abs(load - row.load_nm), sigma)
            for health, load, sigma in self._estimates[row.node]
            if health is row.health
        ]
        if not near:
            return None
        off, sigma = min(near)
        return sigma if off <= STEP_NM + SIGMAS * sigma else None

    def _link(self, now: Nanos) -> LinkRow:
        silent = self.first_ns is not None and now - self._received_ns > 2 * SECOND
        used = ("believed", "canopen", "unknown_id", "not_yet_valid")
        return LinkRow(
            state=self._bus_state,
            bus_load_pct=0.0 if silent else self._load.percent(now),
            frames_s=0.0 if silent else self._frames_s,
            received=self._received,
            error_frames=self.counts["error_frame"],
            rejected={k: n for k, n in sorted(self.counts.items()) if n and k not in used},
        )


def _match(spec: MessageSpec, flags: int, length: int) -> Match:
    if not spec.has_format(bool(flags & FD)):
        return Match.WRONG_FORMAT
    return Match.OK if length == spec.length else Match.WRONG_LENGTH
