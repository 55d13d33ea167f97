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

from dbc.frame import ERROR, EXTENDED, FD, REMOTE, Frame, Nanos

FOREVER: Nanos = (1 << 63) - 1
HEARTBEAT_BASE = 0x700
EMCY_BASE = 0x080
EMCY_KEPT = 16
ACTIVE_KEPT = 16

BOOT_UP, STOPPED, OPERATIONAL, PRE_OPERATIONAL = 0, 4, 5, 127
_NMT_STATES = frozenset((BOOT_UP, STOPPED, OPERATIONAL, PRE_OPERATIONAL))
_NOT_PLAIN = EXTENDED | REMOTE | ERROR | FD


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


class Supervision:
    """Heartbeat consumer and emergency consumer for a fixed set of nodes."""

    def __init__(self, nodes: Iterable[int], timeout_ns: Nanos) -> None:
        """Supervise `nodes`; a node is lost when silent for longer than `timeout_ns`."""
        self.nodes = tuple(nodes)
        self._timeout_ns = timeout_ns
        self._last_ns: dict[int, Nanos] = {}
        self._state: dict[int, int] = {}
        self._heartbeat_of = {HEARTBEAT_BASE + n: n for n in self.nodes}
        self._emcy_of = {EMCY_BASE + n: n for n in self.nodes}
        self.ids = (*self._heartbeat_of, *self._emcy_of)
        """Identifiers of what it looks at."""
        self.emcy = {n: EmcyLog() for n in self.nodes}
        self.boots = dict.fromkeys(self.nodes, 0)
        """Boot-up messages per node; more than one means that the drive restarted."""
        self.malformed = 0
        """Heartbeats and emergencies of a supervised node with a wrong format."""

    def observe(self, frame: Frame) -> bool:
        """Take in a frame; True if it was a heartbeat or emergency of a supervised node.

        A malformed one is counted and is no sign of life.
        """
        node = self._heartbeat_of.get(frame.can_id)
        if node is not None:
            if frame.flags & (EXTENDED | ERROR):
                return False  # another identifier, or an error class
            self._heartbeat(node, frame)
            return True
        node = self._emcy_of.get(frame.can_id)
        if node is None or frame.flags & (EXTENDED | ERROR):
            return False
        data = frame.data
        if len(data) != 8 or frame.flags & _NOT_PLAIN:
            self.malformed += 1
        else:
            code = data[0] | data[1] << 8
            self.emcy[node].add(Emergency(frame.t_ns, code, data[2], data[3:]))
        return True

    def _heartbeat(self, node: int, frame: Frame) -> None:
        if len(frame.data) != 1 or frame.flags & _NOT_PLAIN:
            self.malformed += 1
            return
        state = frame.data[0] & 0x7F  # bit 7 toggles in node guarding
        if state not in _NMT_STATES:
            self.malformed += 1
            return
        if state == BOOT_UP:
            self.boots[node] += 1
        last = self._last_ns.get(node)
        if last is None or frame.t_ns >= last:
            self._last_ns[node] = frame.t_ns
            self._state[node] = state

    def none_lost(self, now_ns: Nanos) -> bool:
        """Whether `life` says lost of no node."""
        return now_ns < self.lost_ns

    @property
    def lost_ns(self) -> Nanos:
        """From when on `life` says lost of a node, if nothing comes until then."""
        last = self._last_ns
        return min(last.values()) + self._timeout_ns + 1 if last else FOREVER

    def life(self, node: int, now_ns: Nanos) -> Life:
        """Verdict on one node."""
        last = self._last_ns.get(node)
        if last is None:
            return Life.NEVER_SEEN
        return Life.LOST if now_ns - last > self._timeout_ns else Life.ALIVE

    def states(self, now_ns: Nanos) -> dict[int, NodeState]:
        """Verdict, NMT state and age per node."""
        return {
            node: NodeState(
                self.life(node, now_ns),
                self._state.get(node, -1),
                now_ns - self._last_ns[node] if node in self._last_ns else -1,
            )
            for node in self.nodes
        }
