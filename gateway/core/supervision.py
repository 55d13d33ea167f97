"""Heartbeats and emergency messages: which nodes are alive, and which errors they reported.

May know: frames and times. May not know: clocks, sockets, flags.
Memory is bounded whatever arrives. CiA 301: heartbeat 0x700 + node, one byte of NMT state;
EMCY 0x080 + node, error code (16 bit little endian), error register, five bytes of the maker.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
from _traction_core import ffi, lib

from dbc.frame import ERROR, EXTENDED, FD, REMOTE, Frame, Nanos
from dbc.records import HEARTBEAT, SUPERVISION, Addressed
from gateway.core.codes import NEVER

HEARTBEAT_BASE: Final = 0x700
EMCY_BASE: Final = 0x080
GATEWAY_NODE: Final = 32
HEARTBEAT_ID: Final = HEARTBEAT_BASE + GATEWAY_NODE
EMCY_ID: Final = EMCY_BASE + GATEWAY_NODE
TIMEOUT_PERIODS: Final[int] = lib.TIMEOUT_PERIODS
"""Consumer time-out in heartbeat periods."""
EMCY_KEPT = 16
_NOT_PLAIN = EXTENDED | REMOTE | ERROR | FD


class Life(IntEnum):
    """State of a node by its heartbeat. A node cannot be lost before its second heartbeat."""

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
    """Emergencies of one node: the last 16, and their number."""

    __slots__ = ("received", "recent")

    def __init__(self) -> None:
        """Start empty."""
        self.recent: deque[Emergency] = deque(maxlen=EMCY_KEPT)
        self.received = 0

    def note(self, emergency: Emergency) -> None:
        """Note a message."""
        self.received += 1
        self.recent.append(emergency)


class Supervision(Addressed):
    """Heartbeat consumer and emergency consumer for a fixed set of nodes."""

    def __init__(self, nodes: Iterable[int], timeout_ns: Nanos, period_ns: Nanos = 0) -> None:
        """Supervise each of `nodes` from its second heartbeat on.

        A node is lost after three periods of silence, at least `timeout_ns`. period_ns: of the
        heartbeats; 0: the period that is measured.
        """
        self.nodes = tuple(nodes)
        self.heartbeats = np.zeros(len(self.nodes), HEARTBEAT)
        """`struct heartbeat` of each node."""
        self.heartbeats["last_ns"] = self.heartbeats["since_ns"] = NEVER
        self.heartbeats["state"] = -1
        self.record = np.zeros(1, SUPERVISION)
        self.record["timeout_ns"], self.record["period_ns"] = timeout_ns, period_ns
        self.record["row"] = -1
        self.record["row"][0, list(self.nodes)] = range(len(self.nodes))
        self.link()
        self._row = {n: k for k, n in enumerate(self.nodes)}
        self._heartbeat_of = {HEARTBEAT_BASE + n: n for n in self.nodes}
        self._emcy_of = {EMCY_BASE + n: n for n in self.nodes}
        self.ids = (*self._heartbeat_of, *self._emcy_of)
        """Identifiers of the frames that it reads."""
        self.emcy = {n: EmcyLog() for n in self.nodes}
        self._malformed = 0

    def link(self) -> None:
        """Put the heartbeats' address into the record, and take the record's for the core."""
        self.record["nodes"] = self.heartbeats.ctypes.data
        self.address = self.record.ctypes.data
        self.pointer = ffi.from_buffer("struct supervision *", self.record)

    @property
    def malformed(self) -> int:
        """Heartbeats and emergencies of a supervised node with a wrong format."""
        return self._malformed + int(self.record[0]["malformed"])

    def observe(self, frame: Frame) -> bool:
        """Take in a frame; True if it was a heartbeat, node guarding or emergency of our nodes.

        A malformed frame is counted and is no sign of life.
        """
        node = self._heartbeat_of.get(frame.can_id)
        data, plain = frame.data, not frame.flags & _NOT_PLAIN
        if node is not None:
            if frame.flags & (EXTENDED | ERROR):
                return False  # another identifier, or an error class
            if frame.flags & REMOTE:
                lib.on_node_guard(self.pointer, frame.can_id)
                return True
            first = data[0] if data else 0
            row = self._row[node]
            lib.on_heartbeat(self.pointer, row, frame.t_ns, len(data), plain, first)
            return True
        node = self._emcy_of.get(frame.can_id)
        if node is None or frame.flags & (EXTENDED | ERROR):
            return False
        if len(data) != 8 or not plain:
            self._malformed += 1
        else:
            code = data[0] | data[1] << 8
            self.emcy[node].note(Emergency(frame.t_ns, code, data[2], data[3:]))
        return True

    def _is_lost(self, row: int, now_ns: Nanos) -> bool:
        return bool(lib.is_node_lost(self.pointer, row, now_ns))

    def life(self, node: int, now_ns: Nanos) -> Life:
        """State of life of one node."""
        row = self._row.get(node)
        if row is None or int(self.heartbeats["last_ns"][row]) == NEVER:
            return Life.NEVER_SEEN
        return Life.LOST if self._is_lost(row, now_ns) else Life.ALIVE

    def states(self, now_ns: Nanos) -> dict[int, NodeState]:
        """State of life, NMT state and age per node."""
        out = {}
        for k, node in enumerate(self.nodes):
            last = int(self.heartbeats["last_ns"][k])
            age = -1 if last == NEVER else now_ns - last
            out[node] = NodeState(self.life(node, now_ns), int(self.heartbeats["state"][k]), age)
        return out
