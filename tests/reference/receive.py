"""The receiver in plain Python: what `gateway/core/receive.c` and its parts are compared with.

Objects with attributes, one frame at a time. Checksums, state machines and decoding have references
of their own; here they are the product's.
"""

from __future__ import annotations

import math
from collections import Counter
from types import SimpleNamespace as Record

import numpy as np
from _traction_core import ffi, lib

from dbc import e2e
from dbc.e2e import Check, SmState
from dbc.frame import ERROR, EXTENDED, FD, REMOTE, SECOND
from tests.reference.sample_clock import SampleClock

STARTING, STALE, CORRUPTED, SEQUENCE, RANGE, NOT_AVAILABLE = range(1, 7)
FAST = ("PhaseCurrents", "StatorVoltages", "Samples")
NEVER = -(1 << 63)
GUARD_NS, SECOND_SENDER, TOO_SOON, COPIES = SECOND, 3, 0.75, 6
"""After the last sign of a second sender no frame is used for so long; so many signs; share of a
counter step's time; sum at which identical frames are a sign."""


class Node:
    """Heartbeats of one node (CiA 301)."""

    def __init__(self) -> None:
        self.last_ns = self.since_ns = NEVER
        self.gaps: list[int] = []
        self.seen = 0
        self.limit_ns = self.boots = 0
        self.state, self.asked = -1, False


class Supervision:
    """Heartbeats of all nodes."""

    def __init__(self, nodes, timeout_ns, period_ns=0):
        self.nodes = {n: Node() for n in nodes}
        self.timeout_ns, self.period_ns, self.malformed = timeout_ns, period_ns, 0

    def heartbeat(self, node, t_ns, length, plain, byte):
        n, state = self.nodes[node], byte & 0x7F
        if not plain or length != 1 or state not in (0, 4, 5, 127):
            self.malformed += 1
            return
        n.boots += state == 0
        if t_ns < n.last_ns:
            return
        answer = byte >= 0x80
        if answer:
            n.seen, n.limit_ns = -1, 0
        before = n.since_ns
        if answer or n.asked or state == 0:
            n.since_ns = NEVER
        elif before == NEVER or state != n.state:
            n.since_ns = t_ns
        elif t_ns - before >= 10_000_000:
            n.since_ns = t_ns
            if t_ns - before <= 65_536_000_000:
                self._gap(n, t_ns - before)
        n.asked = False
        if state != 0 or n.limit_ns == 0:
            n.last_ns = t_ns
        n.state = state

    def _gap(self, n, gap):
        """The five places of a ring; -1 is the last of them."""
        n.gaps += [0] * (5 - len(n.gaps))
        n.gaps[n.seen % 5] = gap
        n.seen += 1
        if n.seen > 0:
            known = sorted(n.gaps[: min(n.seen, 5)])
            period = self.period_ns or known[len(known) // 2]
            n.limit_ns = max(self.timeout_ns, 3 * period)

    def any_lost(self, now):
        return any(0 < n.limit_ns < now - n.last_ns for n in self.nodes.values())


class Channel:
    """One message of one drive."""

    def __init__(self, spec, drive, tick_ns, used):
        self.spec, self.drive, self.kind = spec, drive, spec.kind
        columns = {s.name: k for k, s in enumerate(spec.signals)}
        self.columns = [columns[name] for name in used if name in columns]
        self.quality = columns.get("Quality")
        self.limit_ns = 3 * spec.cycle_ns + tick_ns
        self.steps = max(1, round(spec.cycle_ns / 125_000))
        self.config, self.e2e = e2e.configs([spec]), e2e.states(1)
        self.received = self.accepted = self.good = -1
        self.rejected = self.fault = 0
        self.reason, self.was_valid, self.last = STARTING, False, bytes(spec.length)
        self.counter_ns = self.error_ns = self.until = -1
        self.repeats = self.errors = 0

    def pointer(self, kind, array):
        return ffi.from_buffer(f"struct {kind} *", array)

    def cycle(self, check):
        return lib.e2e_sm_check(self.pointer("e2e_state", self.e2e), check)

    def guard(self, t, steps, copy):
        """Signs of a second sender."""
        if copy:
            self.repeats = min(self.repeats + 2, COPIES + 1)
            if self.repeats < COPIES:
                return
            self.errors = SECOND_SENDER
        else:
            since, self.counter_ns = t - self.counter_ns, t
            if steps <= 3:
                self.repeats = max(self.repeats - 1, 0)
                return
            if since >= TOO_SOON * steps * self.spec.cycle_ns:
                return
            if t - self.error_ns > GUARD_NS:
                self.errors = 0
            self.errors += 1
        self.error_ns = t
        if self.errors >= SECOND_SENDER:
            self.until = min(t + GUARD_NS, (1 << 63) - 1)

    def verify(self, data, t, counts):
        check = lib.e2e_check(self.pointer("e2e_config", self.config),
                              self.pointer("e2e_state", self.e2e), data)  # fmt: skip
        if not self.spec.profile:
            self.accepted, self.was_valid = t, True
            return True
        missed = int(self.e2e["missed"][0])
        for _ in range(missed):
            self.cycle(Check.NO_NEW_DATA)
        state = self.cycle(check)
        if check != Check.ERROR:
            own = data[: self.spec.length]
            copy = own == self.last and check == Check.REPEATED
            self.last = own
            self.guard(t, int(self.e2e["step"][0]), copy)
        if check <= Check.OK_SOME_LOST:
            self.accepted = t
            counts["lost"] += missed
            self.was_valid |= state == SmState.VALID
            if state == SmState.INVALID or t < self.until:
                counts["not_yet_valid"] += 1
                return False
            return True
        self.rejected = self.fault = CORRUPTED if check == Check.ERROR else SEQUENCE
        counts[Check(check).name.lower()] += 1
        return False

    def judge(self, now):
        """Why it is unknown; 0 if it is not."""
        state = self.e2e["state"][0]
        if self.received < 0:
            return STARTING
        if now - self.received > self.limit_ns:
            return STALE
        if now < self.until:
            return SEQUENCE
        if self.spec.profile and state != SmState.VALID:
            return self.fault or (STALE if state == SmState.INVALID else STARTING)
        if self.accepted < 0 or now - self.accepted > self.limit_ns:
            return self.rejected or STALE
        return self.rejected if self.rejected in (RANGE, NOT_AVAILABLE) else 0


class Receiver:
    """All channels of a codec."""

    def __init__(self, codec, nodes, tick_ns, used, timeout_ns, max_gap_ns):
        self.codec, self.max_gap_ns, self.nodes = codec, max_gap_ns, nodes
        self.counts: Counter[str] = Counter()
        self.supervision = Supervision(nodes, timeout_ns)
        self.channels = {}
        kinds = ("PhaseCurrents", "StatorVoltages", "Samples", "Motion", "Status", "Temperatures")
        for k, node in enumerate(nodes):
            for kind in kinds:
                spec = codec.by_name.get(f"Drive{node}_{kind}")
                if spec is not None:
                    self.channels[spec.key] = Channel(spec, k, tick_ns, used[kind])
        self.own = {s.key for s in codec.own(creep=False)} | {0x720, 0x0A0}
        self.drives = [
            Record(pending={}, counter=0, sample_ns=-1, current_sum=0.0, speed=math.nan,
                   command=math.nan, before=math.nan, irms=math.nan, operating=True,
                   command_ns=0, emergency_ns=-1, steady=True, clock=None)
            for _ in nodes
        ]  # fmt: skip

    def take(self, frames, now):
        """Frames of a tick, in order; fills samples, readings, restart, emergencies."""
        self.samples, self.readings, self.restart = [], [], set()
        self.temperatures, self.emergencies, accepted = [], [], []
        for k, frame in enumerate(frames):
            channel = self.route(k, frame, now)
            if channel is not None and channel.verify(
                frame.data.ljust(64, b"\0"), frame.t_ns, self.counts
            ):
                accepted.append((channel, frame))
        for channel, frame in accepted:
            self.note(channel, frame)
        self.time_out(now)

    def time_out(self, now):
        for channel in self.channels.values():
            if channel.accepted >= 0 and now - channel.accepted > channel.limit_ns:
                channel.cycle(Check.NO_NEW_DATA)
            channel.reason = channel.judge(now)

    def route(self, k, frame, now):
        t, flags = frame.t_ns, frame.flags
        if flags & (ERROR | REMOTE):
            self.counts["error_frame" if flags & ERROR else "remote"] += 1
            node = self.supervision.nodes.get(frame.can_id - 0x700)
            if node is not None and not flags & (ERROR | EXTENDED):
                node.asked = True
            return None
        key = frame.can_id | (1 << 31 if flags & EXTENDED else 0)
        channel = self.channels.get(key)
        if key in self.own:
            self.counts["own"] += 1
        elif t < 0 or t > now or (channel is not None and t < channel.accepted):
            self.counts["time_back"] += 1
        elif channel is not None:
            return self.fits(channel, frame)
        elif key - 0x700 in self.supervision.nodes:
            first = frame.data[0] if frame.data else 0
            self.supervision.heartbeat(key - 0x700, t, len(frame.data), not flags & FD, first)
            self.counts["canopen"] += 1
        elif key - 0x080 in self.supervision.nodes:
            self.emergencies.append(k)
            self.emergency(key - 0x080, frame)
        else:
            self.counts["unknown_id"] += 1
        return None

    def emergency(self, node, frame):
        """The first of a second that reports an error."""
        drive = self.drives[list(self.supervision.nodes).index(node)]
        error = len(frame.data) == 8 and not frame.flags & FD and any(frame.data[:2])
        if error and (drive.emergency_ns < 0 or frame.t_ns - drive.emergency_ns >= 10**9):
            drive.emergency_ns = frame.t_ns

    def fits(self, channel, frame):
        channel.received = frame.t_ns
        if len(frame.data) == channel.spec.length and bool(frame.flags & FD) == channel.spec.is_fd:
            return channel
        self.counts["wrong_length"] += 1
        channel.cycle(Check.ERROR)
        channel.rejected = channel.fault = CORRUPTED
        return None

    def note(self, channel, frame):
        """Use the values of an accepted frame."""
        row = np.frombuffer(frame.data.ljust(64, b"\0"), np.uint8).reshape(1, 64)
        values, validities = self.codec.decode_rows(np.array([channel.spec.index], np.int32), row)
        width = len(channel.spec.signals)
        value, validity = values[0, :width].tolist(), validities[0, :width].tolist()
        usable = channel.quality is None or value[channel.quality] in (1.0, 2.0)
        found = 0
        said = [validity[k] for k in channel.columns]
        if not usable or 1 in said:
            found = NOT_AVAILABLE
        elif set(said) - {0, 4}:
            found = RANGE
        used = [value[k] for k in channel.columns]
        if channel.kind == "Temperatures":
            channel.rejected = 0 if usable else NOT_AVAILABLE
            if usable and any(validity[k] == 0 for k in channel.columns):
                channel.good = frame.t_ns
            self.temperatures.append(channel.spec.name)
        elif channel.kind in ("Motion", "Status"):
            why = found
            if usable:
                known = [v if how == 0 else math.nan for v, how in zip(used, said, strict=True)]
                if self.use(channel, frame, known):
                    channel.good = frame.t_ns
                why = {0: 0, 1: NOT_AVAILABLE}.get(said[0], RANGE)
            channel.rejected = why
        else:
            if not found and channel.kind == "Samples" and int(used[0]) % 8:
                found = RANGE
            if not found:
                channel.good = frame.t_ns
                self.use(channel, frame, used)
            channel.rejected = found
        self.counts[{0: "decoded", RANGE: "range", NOT_AVAILABLE: "not_available"}[found]] += 1

    def use(self, channel, frame, used):
        drive, t = self.drives[channel.drive], frame.t_ns
        if channel.kind == "Motion":
            if math.isnan(used[0]):
                return False
            drive.speed = used[0] * (2.0 * math.pi / 60.0)
            angle = used[2] * (math.pi / 180.0) if len(used) > 2 else math.nan
            if not math.isnan(used[1]):
                self.readings.append((channel.drive, t, drive.speed, used[1], angle))
        elif channel.kind == "Status":
            if math.isnan(used[0]) and math.isnan(used[1]):
                return False
            before = used[0] if math.isnan(drive.command) else drive.command
            drive.steady = abs(used[0] - before) <= 0.5 + 0.05 * abs(used[0])
            drive.command, drive.before, drive.irms, drive.command_ns = used[0], before, used[1], t
            drive.operating = len(used) < 3 or math.isnan(used[2]) or used[2] == 2.0
        elif channel.kind == "Samples":
            self.block(channel, drive, used, t)
        else:
            self.pair(channel, drive, used, t, frame.data[1] & 15)
        return True

    def pair(self, channel, drive, used, t, counter):
        kind, period = channel.kind, channel.spec.cycle_ns
        if kind == "PhaseCurrents":
            a, b, c = used
            drive.current_sum += 0.05 * (abs(a + b + c) - drive.current_sum)
            used = [(2.0 * a - b - c) / 3.0, (b - c) / math.sqrt(3.0)]
        drive.pending[kind, counter] = (t, used)
        other_kind = "StatorVoltages" if kind == "PhaseCurrents" else "PhaseCurrents"
        other = drive.pending.get((other_kind, counter))
        if other is None:
            return
        if abs(other[0] - t) > 8 * period:
            del drive.pending[other_kind if other[0] < t else kind, counter]
            self.counts["unpaired"] += 1
            return
        y, u = (
            drive.pending.pop(("PhaseCurrents", counter)),
            drive.pending.pop(("StatorVoltages", counter)),
        )
        newer = max(t, other[0])
        missing = self.gap(channel, drive, counter, 16, newer, complex(*u[1]))
        if missing is not None:
            self.samples.append(
                (channel.drive, *u[1], *y[1], channel.steps, missing * channel.steps)
            )

    def block(self, channel, drive, used, t):
        newest = complex(*used[31:33])
        missing = self.gap(channel, drive, int(used[0]) // 8, 8192, t, newest)
        if missing is None:
            return
        for k in range(8):
            a, b, u_a, u_b = used[1 + 4 * k : 5 + 4 * k]
            gap = 8 * missing if k == 0 else 0
            y_b = (a + 2.0 * b) / math.sqrt(3.0)
            self.samples.append((channel.drive, u_a, u_b, a, y_b, 1, gap))

    def gap(self, channel, drive, counter, values, t, u):
        """Cycles missing before a sample of this voltage; None for one that is late."""
        missing, period = 0, channel.spec.cycle_ns
        if drive.sample_ns < 0 or t - drive.sample_ns > self.max_gap_ns:
            self.restart.add(channel.drive)
            drive.clock = SampleClock(t, u, period, self.max_gap_ns)
        else:
            delta = (counter - drive.counter) % values
            turns = round(((t - drive.sample_ns) / period - delta) / values)
            missing = delta + values * turns - 1
            if missing < 0:
                self.counts["late"] += 1
                return None
            left_out = drive.clock.step(t - drive.sample_ns, u, missing + 1)
            self.counts["left_out"] += left_out
            missing += left_out
        drive.counter, drive.sample_ns = counter, t
        return missing
