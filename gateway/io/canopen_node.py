"""The gateway as CANopen node 32: own heartbeat, own emergencies, and NMT start if it is master.

Pure logic, stepped by the loop that sends the flags, so a hung loop sends no heartbeat either.
There is no SDO server and no SDO client: nobody can write to the gateway, and it writes to nobody.
The formats are those of CiA 301; a test compares them with those of the `canopen` package.
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Iterable, Sequence
from enum import IntEnum
from struct import Struct
from typing import Final

from dbc.frame import ERROR, EXTENDED, MS, REMOTE, SECOND, Frame, Nanos
from dbc.frames import Block
from gateway.core.supervision import EMCY_ID, HEARTBEAT_BASE, HEARTBEAT_ID
from gateway.io.transport import NMT_ID

log = logging.getLogger(__name__)

HEARTBEAT_NS: Nanos = 100 * MS
EMCY_INHIBIT_NS: Nanos = 20 * MS
"""Shortest time between two of the gateway's emergencies: a flapping fault cannot fill the bus."""
START_REPEAT_NS: Nanos = SECOND
"""Pause before the NMT start to a drive that is still pre-operational is repeated."""
LISTEN_NS: Nanos = 200 * MS
"""Time of listening for another master before the first NMT command."""

_BOOT_UP, _OPERATIONAL, _PRE_OPERATIONAL = b"\x00", b"\x05", b"\x7f"
"""NMT states, as heartbeats carry them."""
_START: Final = 1
_EMCY: Final = Struct("<HB5s")
"""Error code, error register, five manufacturer-specific bytes."""


class GatewayError(IntEnum):
    """Error codes the gateway reports (CiA 301 table of emergency codes)."""

    OVERRUN = 0x6100  # internal software: a tick of the loop was missed
    COMMUNICATION = 0x8130  # heartbeat, protection or silence of a drive
    INTRUDER = 0x8150  # another node sends the gateway's identifiers
    SENSOR = 0x5030  # sensor hardware
    ESTIMATOR = 0xFF01  # manufacturer-specific: an estimator diverged


_REGISTER_BIT = {0x50: 0x20, 0x81: 0x10, 0xFF: 0x80}  # device profile, communication, manufacturer
_GENERIC = 0x01


def error_register(codes: Iterable[int]) -> int:
    """Object 0x1001 for a set of active error codes."""
    register = 0
    for code in codes:
        register |= _GENERIC | _REGISTER_BIT.get(code >> 8, 0)
    return register


def meant(block: Block) -> list[Frame]:
    """The frames of a block that a `CanopenNode` evaluates: NMT commands and heartbeats."""
    service = block.can_id & 0x780
    wanted = (block.can_id == NMT_ID) | (service == HEARTBEAT_BASE)
    return list(block.pick(wanted).frames()) if wanted.any() else []


class CanopenNode:
    """Node 32: heartbeat every 100 ms, emergencies on change, NMT start only when master."""

    def __init__(self, nodes: Iterable[int] = (), *, nmt_master: bool = False) -> None:
        """Start the drives `nodes` if `nmt_master`, else never make an NMT frame.

        Raises ValueError for node 0, the broadcast address.
        """
        self._master = nmt_master
        self._drive_of = {HEARTBEAT_BASE + node: node for node in nodes}
        if 0 in self._drive_of.values():
            msg = "node 0 is the broadcast address: NMT commands are node-addressed only"
            raise ValueError(msg)
        self._start_ns: Nanos | None = None
        self._next_heartbeat_ns: Nanos = 0
        self._next_emcy_ns: Nanos = 0
        self._errors: frozenset[int] = frozenset()
        self._announced: frozenset[int] = frozenset()
        self._waiting: dict[int, Nanos] = {}  # pre-operational drive -> time of its next start
        self.another_master = False
        """True for good once an NMT command was received: from then on the gateway sends none."""

    def set_errors(self, codes: Collection[int]) -> None:
        """Set the errors that are active now; the next steps announce the changes."""
        if codes != self._errors:
            self._errors = frozenset(codes)

    def step(self, frames: Sequence[Frame], now_ns: Nanos) -> list[Frame]:
        """Take in received frames; return at most a heartbeat, an emergency and the starts due."""
        out: list[Frame] = []
        if self._start_ns is None:
            self._start_ns = self._next_heartbeat_ns = now_ns
            out.append(Frame(now_ns, HEARTBEAT_ID, _BOOT_UP))
        for frame in frames:
            self._observe(frame, now_ns)
        if now_ns >= self._next_heartbeat_ns:
            out.append(Frame(now_ns, HEARTBEAT_ID, _OPERATIONAL))
            late = now_ns - self._next_heartbeat_ns
            self._next_heartbeat_ns += (late // HEARTBEAT_NS + 1) * HEARTBEAT_NS
        self._emergency(now_ns, out)
        if self._waiting and now_ns >= self._start_ns + LISTEN_NS:
            self._starts(now_ns, out)
        return out

    def _observe(self, frame: Frame, now_ns: Nanos) -> None:
        if frame.flags & (EXTENDED | REMOTE | ERROR):
            return
        if frame.can_id == NMT_ID:
            if self._master and not self.another_master:
                log.warning(
                    "another NMT master on the bus (%s): no drive will be started from here",
                    frame.data.hex(" "),
                )
            self.another_master = True
            return
        node = self._drive_of.get(frame.can_id) if self._master else None
        if node is not None and len(frame.data) == 1:
            if frame.data[0] & 0x7F == _PRE_OPERATIONAL[0]:
                self._waiting.setdefault(node, now_ns)
            else:
                self._waiting.pop(node, None)

    def _starts(self, now_ns: Nanos, out: list[Frame]) -> None:
        for node, due_ns in self._waiting.items():
            if now_ns < due_ns:
                continue
            self._waiting[node] = now_ns + START_REPEAT_NS
            if self.another_master:
                log.warning("drive %d is not started: there is another NMT master", node)
            else:
                out.append(Frame(now_ns, NMT_ID, bytes((_START, node))))

    def _emergency(self, now_ns: Nanos, out: list[Frame]) -> None:
        """At most one emergency: the next error that appeared, or the reset when none is left."""
        if self._errors == self._announced or now_ns < self._next_emcy_ns:
            return
        appeared = sorted(self._errors - self._announced)
        if appeared:
            code = appeared[0]
            # Errors that ended while others remain are dropped without a frame (CiA 301: optional).
            self._announced = (self._announced & self._errors) | {code}
        elif self._errors:
            self._announced = self._errors
            return
        else:
            code = 0
            self._announced = frozenset()
        self._next_emcy_ns = now_ns + EMCY_INHIBIT_NS
        payload = _EMCY.pack(code, error_register(self._errors), bytes(5))
        out.append(Frame(now_ns, EMCY_ID, payload))
