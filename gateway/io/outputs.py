"""A receiver's check of the frames that a tick has sent: due, protected, accepted by the kernel.

A loop that runs but sends nothing must not feed a watchdog. So the watchdog depends on frames:
all that were due, with the next counter and a correct checksum, accepted by the kernel or device.
A bus that is down or full is not a fault of the program: the link's state shows it, and a restart
does not help. A frame that is too late to be sent counts as not sent. That happens to any process
now and then, so a message counts as missing only if several of its frames in a row are too late.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from dbc.e2e import Check, Receiver
from dbc.frame import MS, Frame, Nanos
from dbc.spec import MessageSpec
from gateway.core.supervision import HEARTBEAT_ID
from gateway.io.canopen_node import HEARTBEAT_NS
from gateway.io.transport import SendResult

_OUR_FAULT = (SendResult.REFUSED, SendResult.FAILED)
MOST_LATE = 2
"""Frames of a message in a row that may be too late to be sent."""
OFTEN_NS: Nanos = 100 * MS
"""Longest cycle time of a message that is checked for lateness: flags, state, estimates. Three late
frames in a row of a message sent once a second do not show that nothing is sent."""
MOST_NAMED = 3
"""Problems of one tick that are named; naming more would not help."""


class Outputs:
    """Check of the frames that the loop sends, tick by tick."""

    def __init__(
        self,
        specs: Iterable[MessageSpec],
        silent: Callable[[], bool] = lambda: False,
        *,
        listening: bool = False,
    ) -> None:
        """Take the cyclic messages that the core sends.

        `silent`: whether the core holds them back on purpose. `listening`: the allow-list refuses
        every frame, so a refusal is correct.
        """
        self._faults = (SendResult.FAILED,) if listening else _OUR_FAULT
        # A gateway that sends nothing cannot be late with it.
        self._too_late = None if listening else SendResult.LATE
        specs = tuple(specs)
        self._receivers = {spec.can_id: Receiver(spec) for spec in specs}
        self._cycles = {spec.can_id: spec.cycle_ns for spec in specs} | {HEARTBEAT_ID: HEARTBEAT_NS}
        self._made_ns: dict[int, Nanos] = {}
        self._late: dict[int, int] = {}
        """Late frames in a row by identifier; until the first is sent, more than `MOST_LATE`."""
        self.silent = silent

    def judge(self, sent: Sequence[Frame], results: Sequence[SendResult], now_ns: Nanos) -> str:
        """What is wrong with the frames of a tick, in one line; empty if nothing is.

        `results`: what became of each frame. `now_ns`: the time that was passed to the step.
        """
        found = []
        for frame, result in zip(sent, results, strict=True):
            can_id = frame.can_id
            self._made_ns[can_id] = now_ns
            late = self._late.get(can_id, MOST_LATE) + 1
            self._late[can_id] = late if result is self._too_late else 0
            receiver = self._receivers.get(can_id)
            if receiver is not None and receiver.check(frame.data) is not Check.OK:
                found.append(f"{can_id:03X} has a wrong checksum or counter")
            if result in self._faults:
                found.append(f"{can_id:03X} was {result.value}")
        wanted = (HEARTBEAT_ID,) if self.silent() else self._cycles
        for can_id in wanted:
            last = self._made_ns.get(can_id)
            if last is None or now_ns - last >= self._cycles[can_id]:
                found.append(f"{can_id:03X} is due but was not generated")
            elif self._late[can_id] > MOST_LATE and self._cycles[can_id] <= OFTEN_NS:
                found.append(f"{can_id:03X} is generated, but too late to be sent")
        more = len(found) - MOST_NAMED
        return "; ".join(found[:MOST_NAMED]) + (f" and {more} more" if more > 0 else "")
