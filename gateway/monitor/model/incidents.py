"""Events for the displays: each change once, the last 200 of them. Pure."""

from __future__ import annotations

from collections import deque
from enum import IntEnum
from typing import Final

from dbc.frame import SECOND, Nanos
from gateway.core.codes import Flag, GatewayState, Health, Reason
from gateway.core.supervision import Emergency
from gateway.monitor.model.rows import SET_FLAGS
from gateway.monitor.model.snapshot import Event, GatewayRow, word

KEPT: Final = 200
OFTEN: Final = 4
"""Most events of one kind in a second: a fluttering state must not displace all other events."""
NO_FLAGS: Final = "gateway's flags no longer received"
MARK: Final = " (shadow)"
INFO, WARNING, ERROR = "info", "warning", "error"
_LEVELS: Final[dict[type[IntEnum], dict[int, str]]] = {
    Flag: {Flag.BAD: ERROR, Flag.UNKNOWN: WARNING},
    Health: {
        Health.UNKNOWN: WARNING,
        Health.PREDICTING: WARNING,
        Health.DIVERGED: ERROR,
        Health.INPUT_INVALID: WARNING,
    },
    Reason: {Reason.INTRUDER: ERROR},
    GatewayState: {GatewayState.DEGRADED: WARNING, GatewayState.SILENT: ERROR},
}
"""By type first, because members of different enumerations are equal as numbers."""


def level_of(value: IntEnum) -> str:
    """Level of the event of a new state."""
    return _LEVELS.get(type(value), {}).get(value, INFO)


class Happenings:
    """Compares each state with the one before, and keeps the changes as events."""

    def __init__(self) -> None:
        self.events: deque[Event] = deque(maxlen=KEPT)
        self._first_ns: Nanos = 0
        self._last: dict[tuple[str, int], object] = {}
        self._often: dict[tuple[str, int], list[int]] = {}
        """For each kind: begin of a second, number of events in it, number left out."""

    def begin(self, first_ns: Nanos) -> None:
        """Set the time from which the times of events count."""
        self._first_ns = first_ns

    def note(self, t_ns: Nanos, level: str, drive: int | None, text: str) -> None:
        """Add an event, without a limit of rate."""
        self.events.append(Event((t_ns - self._first_ns) / SECOND, level, drive, text))

    def changed(self, name: str, drive: int, value: object) -> bool:
        """Whether a value differs from the last one of this name and drive, of which few exist."""
        before = self._last.get((name, drive), self)
        self._last[name, drive] = value
        return before is not self and before != value

    def often(self, t_ns: Nanos, name: str, drive: int, level: str, text: str) -> None:
        """Add an event of a frequent kind: at most `OFTEN` a second, with the number left out."""
        window = self._often.setdefault((name, drive), [t_ns, 0, 0])
        if t_ns - window[0] >= SECOND:
            window[:2] = t_ns, 0
        if window[1] >= OFTEN:
            window[2] += 1
            return
        window[1] += 1
        if window[2]:
            text += f" ({window[2]} earlier ones suppressed)"
            window[2] = 0
        self.note(t_ns, level, drive or None, text)

    def state(self, t_ns: Nanos, name: str, drive: int, value: IntEnum, mark: str = "") -> None:
        """Add an event if a flag or state of a drive (0: train) changed; mark: end of its text."""
        if self.changed(name, drive, value):
            text = f"{name.replace('_', ' ')} {word(name, value)}{mark}"
            self.often(t_ns, name, drive, level_of(value), text)

    def gateway(self, t_ns: Nanos, row: GatewayRow) -> None:
        """Add events for changed flags and states of the gateway and train.

        If the gateway's frames stop, this is one event; the flags then unknown give no others.
        """
        if self.changed("alive", 0, row.alive):
            text = "gateway's flags received" if row.alive else NO_FLAGS
            self.often(t_ns, "alive", 0, INFO if row.alive else ERROR, text)
        if row.source == "none" and row.present:
            return
        mark = MARK if row.source == "shadow" else ""
        for name in SET_FLAGS:
            self.state(t_ns, name, 0, getattr(row, name), mark)
        if row.reason is not None:
            self.state(t_ns, "reason", 0, row.reason, mark)
        if row.state is not None:
            self.state(t_ns, "gateway", 0, row.state, mark)
        if row.deadline_misses is not None and self.changed("misses", 0, row.deadline_misses):
            self.often(t_ns, "misses", 0, WARNING, f"ticks missed so far: {row.deadline_misses}")

    def heartbeat(self, t_ns: Nanos, node: int, drive: int | None, state: str | None) -> None:
        """Add an event if the NMT state (or Silent) of a node changed; drive: None: the gateway."""
        if self.changed("heartbeat", node, state) and state is not None:
            level = ERROR if state == "Silent" else INFO
            what = "heartbeat lost" if state == "Silent" else f"heartbeat: {state}"
            self.often(t_ns, "heartbeat", drive or 0, level, what if drive else f"gateway {what}")

    def emergency(self, drive: int | None, seen: Emergency) -> None:
        """Add an event for an emergency message. A code 0x00xx means that the error is over."""
        over = seen.code & 0xFF00 == 0
        text = "emergency over" if over else f"emergency {seen.code:04X}"
        text += "" if over else f", register {seen.register:02X}"
        text = text if drive else f"gateway {text}"
        self.often(seen.t_ns, "emergency", drive or 0, INFO if over else ERROR, text)

    def drive_state(self, t_ns: Nanos, drive: int, state: str | None) -> None:
        """Add an event if `Drive_Status.State`, by name, changed; None is ignored."""
        if state is not None and self.changed("state", drive, state):
            level = ERROR if state == "Fault" else INFO
            self.often(t_ns, "state", drive, level, f"drive {state}")

    def link(self, t_ns: Nanos, state: str) -> None:
        """Add an event for a changed state of the bus."""
        self.often(t_ns, "link", 0, INFO if state == "active" else ERROR, f"bus {state}")
