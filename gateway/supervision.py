"""Who is alive on the bus and what they complained of: heartbeats and emergency messages.

May know: frames and times. May not know: clocks, sockets, what the flags make of it.
Memory is bounded whatever arrives. CiA 301: heartbeat 0x700 + node, one byte of NMT state;
EMCY 0x080 + node, error code (16 bit little endian), error register, five bytes of the maker.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.frame import ERROR, EXTENDED, FD, REMOTE, Frame, Nanos

Ints = NDArray[np.int64]

NEVER: Nanos = -(1 << 63)
HEARTBEAT_BASE = 0x700
EMCY_BASE = 0x080
EMCY_KEPT = 16
ACTIVE_KEPT = 16

BOOT_UP, STOPPED, OPERATIONAL, PRE_OPERATIONAL = 0, 4, 5, 127
_NOT_PLAIN = EXTENDED | REMOTE | ERROR | FD
_NODES = 128


class Life(IntEnum):
    """What the heartbeat says of a node. Never seen is not supervised, so it is no fault."""

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
    """Heartbeats of N nodes, as arrays for the compiled receive loop.

    row (128,): place of a node by its number, -1 for none of ours; last_ns, state (N,): of the
    newest heartbeat, NEVER and -1 before any; boots (N,); malformed (1,): of a wrong format;
    timeout_ns (1,): silence that is longer is a loss.
    """

    row: Ints
    last_ns: Ints
    state: Ints
    boots: Ints
    malformed: Ints
    timeout_ns: Ints


def beats(nodes: tuple[int, ...], timeout_ns: Nanos) -> Beats:
    """Nothing heard yet."""
    row, last_ns = np.full(_NODES, -1), np.full(len(nodes), NEVER)
    row[list(nodes)] = range(len(nodes))
    state, boots = np.full(len(nodes), -1), np.zeros(len(nodes), dtype=np.int64)
    return Beats(row, last_ns, state, boots, np.zeros(1, dtype=np.int64), np.array([timeout_ns]))


def note_beat(k: int, t_ns: Nanos, length: int, plain: bool, byte: int, beats: Beats) -> None:
    """A heartbeat of node k; one of a wrong format is counted, and is no sign of life.

    plain: neither FD nor remote; byte: its first.
    """
    state = byte & 0x7F  # bit 7 toggles in node guarding
    known = state in (BOOT_UP, STOPPED, OPERATIONAL, PRE_OPERATIONAL)
    if not (plain and length == 1 and known):
        beats.malformed[0] += 1
        return
    if state == BOOT_UP:
        beats.boots[k] += 1
    if t_ns >= beats.last_ns[k]:
        beats.last_ns[k] = t_ns
        beats.state[k] = state


def any_lost(now_ns: Nanos, beats: Beats) -> bool:
    """Whether a node has been silent for too long; one that was never heard is not supervised."""
    for k in range(beats.last_ns.shape[0]):
        last = beats.last_ns[k]
        if last != NEVER and now_ns - last > beats.timeout_ns[0]:
            return True
    return False


class Supervision:
    """Heartbeat consumer and emergency consumer for a fixed set of nodes."""

    def __init__(self, nodes: Iterable[int], timeout_ns: Nanos) -> None:
        """Supervise `nodes`; a node is lost when silent for longer than `timeout_ns`."""
        self.nodes = tuple(nodes)
        self.beats = beats(self.nodes, timeout_ns)
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
        """Take in a frame; True if it was a heartbeat or emergency of a supervised node.

        A malformed one is counted and is no sign of life.
        """
        node = self._heartbeat_of.get(frame.can_id)
        data, plain = frame.data, not frame.flags & _NOT_PLAIN
        if node is not None:
            if frame.flags & (EXTENDED | ERROR):
                return False  # another identifier, or an error class
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
        return Life.LOST if now_ns - last > self.beats.timeout_ns.item() else Life.ALIVE

    def states(self, now_ns: Nanos) -> dict[int, NodeState]:
        """Verdict, NMT state and age per node."""
        out = {}
        for k, node in enumerate(self.nodes):
            last = self.beats.last_ns.item(k)
            age = -1 if last == NEVER else now_ns - last
            out[node] = NodeState(self.life(node, now_ns), self.beats.state.item(k), age)
        return out
