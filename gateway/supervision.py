"""Who is alive on the bus and what they complained of: heartbeats and emergency messages.

May know: frames and times. May not know: clocks, sockets, what the flags make of it.
Memory is bounded whatever arrives. CiA 301: heartbeat 0x700 + node, one byte of NMT state;
EMCY 0x080 + node, error code (16 bit little endian), error register, five bytes of the maker.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from dbc.frame import ERROR, EXTENDED, FD, MS, REMOTE, Frame, Nanos

Ints = NDArray[np.int64]

NEVER: Nanos = -(1 << 63)
HEARTBEAT_BASE = 0x700
EMCY_BASE = 0x080
EMCY_KEPT = 16
ACTIVE_KEPT = 16
TIMEOUT_PERIODS: Final = 3
"""Consumer time-out in heartbeat periods."""
LONGEST_NS: Final[Nanos] = (1 << 16) * MS
"""Object 0x1017, the producer's period, has 16 bits of ms: what is longer is a pause."""
REPEAT_NS: Final[Nanos] = 10 * MS
"""A heartbeat so soon after another is no second one: a controller may repeat a frame."""
GAPS: Final = 5
"""The period is the median of so many gaps: two that are too long or too short change nothing."""

BOOT_UP, STOPPED, OPERATIONAL, PRE_OPERATIONAL = 0, 4, 5, 127
_TOGGLE = 0x80  # set in every second answer to node guarding, never in a heartbeat
_NOT_PLAIN = EXTENDED | REMOTE | ERROR | FD
_NODES = 128


class Life(IntEnum):
    """What the heartbeat says of a node. One without two heartbeats cannot be lost."""

    NEVER_SEEN = 0
    ALIVE = 1
    LOST = 2


class NodeState(NamedTuple):
    """One node as of a given time."""

    life: Life
    nmt_state: int
    """Last reported NMT state (0 boot-up, 4 stopped, 5 operational, 127 pre-operational); -1
    if never seen."""
    age_ns: Nanos
    """Since the last heartbeat; -1 if never seen."""


class Emergency(NamedTuple):
    """One emergency message."""

    t_ns: Nanos
    code: int
    register: int
    vendor: bytes


class EmcyLog:
    """Emergencies of one node: the last 16, the codes still active (at most 16), and counts."""

    __slots__ = ("_active", "received", "recent", "unlisted")

    def __init__(self) -> None:
        """Start empty."""
        self.recent: deque[Emergency] = deque(maxlen=EMCY_KEPT)
        self.received = 0
        self.unlisted = 0
        """Errors that did not fit the list of active codes."""
        self._active: dict[int, Nanos] = {}

    @property
    def active(self) -> tuple[int, ...]:
        """Error codes reported and not reset since, oldest first."""
        return tuple(self._active)

    def add(self, emergency: Emergency) -> None:
        """Note a message; a code 0x00xx resets all active ones."""
        self.received += 1
        self.recent.append(emergency)
        if emergency.code & 0xFF00 == 0:
            self._active.clear()
        elif emergency.code not in self._active:
            if len(self._active) < ACTIVE_KEPT:
                self._active[emergency.code] = emergency.t_ns
            else:
                self.unlisted += 1


class Beats(NamedTuple):
    """Heartbeats of N nodes, as arrays for the compiled receive loop. Times in ns.

    row (128,): place of a node by its number, -1 for none of ours; last_ns, state (N,): stamp and
    NMT state of its newest frame, NEVER and -1 before any; boots (N,); malformed (1,): frames of a
    wrong format.

    beat_ns (N,): the last heartbeat from which the next gap counts, NEVER if none does; gap_ns
    (N, GAPS): the last gaps between two heartbeats; gaps (N,): how many there were, -1 after an
    answer to node guarding; asked (N,): 1 after a node-guard request, until the next frame.

    limit_ns (N,): consumer time-out, 0 while the node is not supervised; timeout_ns (1,): the
    shortest; period_ns (1,): the configured period, 0 to follow the one that is heard.
    """

    row: Ints
    last_ns: Ints
    state: Ints
    boots: Ints
    malformed: Ints
    beat_ns: Ints
    gap_ns: Ints
    gaps: Ints
    asked: Ints
    limit_ns: Ints
    timeout_ns: Ints
    period_ns: Ints


def beats(nodes: tuple[int, ...], timeout_ns: Nanos, period_ns: Nanos = 0) -> Beats:
    """State before the first frame. timeout_ns, period_ns: of all nodes; see `Beats`."""
    n = len(nodes)
    row, last_ns, beat_ns = np.full(_NODES, -1), np.full(n, NEVER), np.full(n, NEVER)
    row[list(nodes)] = range(n)
    state, gap_ns = np.full(n, -1), np.zeros((n, GAPS), dtype=np.int64)
    boots, gaps, asked, limit_ns = (np.zeros(n, dtype=np.int64) for _ in range(4))
    malformed = np.zeros(1, dtype=np.int64)
    return Beats(
        row, last_ns, state, boots, malformed, beat_ns, gap_ns, gaps, asked, limit_ns,
        np.array([timeout_ns]), np.array([period_ns]),
    )  # fmt: skip


def note_beat(k: int, t_ns: Nanos, length: int, plain: bool, byte: int, beats: Beats) -> None:
    """A frame with the heartbeat's identifier of node k; one of a wrong format is counted only.

    plain: neither FD nor remote; byte: its first. A gap between two heartbeats is noted unless it
    says nothing of the period: a boot-up or a node-guard answer stands at one of its ends, or a
    change of state, which some drives report at once. A node that answers node guarding produces
    no heartbeat (CiA 301), so it is not supervised until it sends three.
    """
    state = byte & 0x7F
    known = state in (BOOT_UP, STOPPED, OPERATIONAL, PRE_OPERATIONAL)
    if not (plain and length == 1 and known):
        beats.malformed[0] += 1
        return
    if state == BOOT_UP:
        beats.boots[k] += 1
    if t_ns < beats.last_ns[k]:
        return
    answer = byte & _TOGGLE != 0
    if answer:
        beats.gaps[k] = -1
        beats.limit_ns[k] = 0
    before = beats.beat_ns[k]
    if answer or beats.asked[k] != 0 or state == BOOT_UP:
        beats.beat_ns[k] = NEVER
    elif before == NEVER or state != beats.state[k]:
        beats.beat_ns[k] = t_ns
    elif t_ns - before >= REPEAT_NS:
        beats.beat_ns[k] = t_ns
        if t_ns - before <= LONGEST_NS:
            beats.gap_ns[k, beats.gaps[k] % GAPS] = t_ns - before
            beats.gaps[k] += 1
            period = beats.period_ns[0] if beats.period_ns[0] > 0 else heard_period(k, beats)
            if beats.gaps[k] > 0:
                beats.limit_ns[k] = max(beats.timeout_ns[0], TIMEOUT_PERIODS * period)
    beats.asked[k] = 0
    # A drive that boots again and again has no heartbeat.
    if state != BOOT_UP or beats.limit_ns[k] == 0:
        beats.last_ns[k] = t_ns
    beats.state[k] = state


@register_jitable
def heard_period(k: int, beats: Beats) -> int:
    """Median of node k's last gaps, ns; of an even number the longer of the middle two; 0: none."""
    n = min(beats.gaps[k], GAPS)
    for i in range(n):
        gap, rank = beats.gap_ns[k, i], 0
        for j in range(n):
            other = beats.gap_ns[k, j]
            rank += other < gap or (other == gap and j < i)
        if rank == n // 2:
            return int(gap)
    return 0


def note_guarding(can_id: int | np.int64, beats: Beats) -> None:
    """A remote frame: with a node's heartbeat identifier it is a node-guard request to it."""
    node = can_id - HEARTBEAT_BASE
    if 0 <= node < _NODES and beats.row[node] >= 0:
        beats.asked[beats.row[node]] = 1


def any_lost(now_ns: Nanos, beats: Beats) -> bool:
    """Whether a supervised node has been silent for longer than its time-out."""
    for k in range(beats.last_ns.shape[0]):
        if 0 < beats.limit_ns[k] < now_ns - beats.last_ns[k]:
            return True
    return False


class Supervision:
    """Heartbeat consumer and emergency consumer for a fixed set of nodes."""

    def __init__(self, nodes: Iterable[int], timeout_ns: Nanos, period_ns: Nanos = 0) -> None:
        """Supervise each of `nodes` from its second heartbeat on.

        It is lost after three periods of silence, at least `timeout_ns`. period_ns: of the
        heartbeats; 0 follows the period that is heard.
        """
        self.nodes = tuple(nodes)
        self.beats = beats(self.nodes, timeout_ns, period_ns)
        self._row = {n: k for k, n in enumerate(self.nodes)}
        self._heartbeat_of = {HEARTBEAT_BASE + n: n for n in self.nodes}
        self._emcy_of = {EMCY_BASE + n: n for n in self.nodes}
        self.ids = (*self._heartbeat_of, *self._emcy_of)
        """Identifiers of what it looks at."""
        self.emcy = {n: EmcyLog() for n in self.nodes}
        self._malformed = 0

    @property
    def boots(self) -> dict[int, int]:
        """Boot-up messages per node; more than one means that the drive restarted."""
        return dict(zip(self.nodes, self.beats.boots.tolist(), strict=True))

    @property
    def malformed(self) -> int:
        """Heartbeats and emergencies of a supervised node with a wrong format."""
        return self._malformed + self.beats.malformed.item()

    def observe(self, frame: Frame) -> bool:
        """Take in a frame; True if it was a heartbeat, node guarding or emergency of our nodes.

        A malformed one is counted and is no sign of life.
        """
        node = self._heartbeat_of.get(frame.can_id)
        data, plain = frame.data, not frame.flags & _NOT_PLAIN
        if node is not None:
            if frame.flags & (EXTENDED | ERROR):
                return False  # another identifier, or an error class
            if frame.flags & REMOTE:
                note_guarding(frame.can_id, self.beats)
                return True
            first = data[0] if data else 0
            note_beat(self._row[node], frame.t_ns, len(data), plain, first, self.beats)
            return True
        node = self._emcy_of.get(frame.can_id)
        if node is None or frame.flags & (EXTENDED | ERROR):
            return False
        if len(data) != 8 or not plain:
            self._malformed += 1
        else:
            code = data[0] | data[1] << 8
            self.emcy[node].add(Emergency(frame.t_ns, code, data[2], data[3:]))
        return True

    def any_lost(self, now_ns: Nanos) -> bool:
        """Whether `life` says lost of any node."""
        return any_lost(now_ns, self.beats)

    def life(self, node: int, now_ns: Nanos) -> Life:
        """Verdict on one node."""
        row = self._row.get(node)
        last = NEVER if row is None else self.beats.last_ns.item(row)
        if last == NEVER:
            return Life.NEVER_SEEN
        limit_ns = self.timeout_ns(node)
        return Life.LOST if 0 < limit_ns < now_ns - last else Life.ALIVE

    def timeout_ns(self, node: int) -> Nanos:
        """Silence of a supervised node that is longer is a loss, ns; 0: it is not supervised."""
        row = self._row.get(node)
        return 0 if row is None else self.beats.limit_ns.item(row)

    def states(self, now_ns: Nanos) -> dict[int, NodeState]:
        """Verdict, NMT state and age per node."""
        out = {}
        for k, node in enumerate(self.nodes):
            last = self.beats.last_ns.item(k)
            age = -1 if last == NEVER else now_ns - last
            out[node] = NodeState(self.life(node, now_ns), self.beats.state.item(k), age)
        return out
