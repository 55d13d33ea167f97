"""What a tick has sent, looked at as a receiver would: due, protected, and really handed over.

The loop's own word that it is alive is worth little if nothing leaves, so what feeds a watchdog
looks at the frames: all that were due, with the checksum and the counter that follow, and accepted
by the kernel or device. A bus that is down or full is no fault of the program: its state says so,
and no restart cures it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from dbc.frame import Frame, Nanos
from dbc.protection import Check, Receiver
from dbc.spec import MessageSpec
from gateway.drivers.canopen_node import HEARTBEAT_NS
from gateway.drivers.transport import HEARTBEAT_ID, SendResult

_OUR_FAULT = (SendResult.REFUSED, SendResult.FAILED)
MOST_NAMED = 3
"""Problems named of one tick; more of them say no more."""


class Outputs:
    """Judge of what the loop sends, tick by tick."""

    def __init__(
        self,
        specs: Iterable[MessageSpec],
        silent: Callable[[], bool] = lambda: False,
        *,
        listening: bool = False,
    ) -> None:
        """Take the cyclic messages that the core sends; `silent`: it holds them back on purpose.

        `listening`: the allow-list holds everything back, so a refusal is as it should be.
        """
        self._faults = (SendResult.FAILED,) if listening else _OUR_FAULT
        specs = tuple(specs)
        self._receivers = {spec.can_id: Receiver(spec) for spec in specs}
        self._cycles = {spec.can_id: spec.cycle_ns for spec in specs} | {HEARTBEAT_ID: HEARTBEAT_NS}
        self._sent_ns: dict[int, Nanos] = {}
        self.silent = silent

    def judge(self, sent: Sequence[Frame], results: Sequence[SendResult], now_ns: Nanos) -> str:
        """What is wrong with the frames of a tick, in one line; empty if nothing is.

        `results`: what became of each. `now_ns`: the time that the step got.
        """
        found = []
        for frame, result in zip(sent, results, strict=True):
            self._sent_ns[frame.can_id] = now_ns
            receiver = self._receivers.get(frame.can_id)
            if receiver is not None and receiver.check(frame.data) is not Check.OK:
                found.append(f"{frame.can_id:03X} has a wrong checksum or counter")
            if result in self._faults:
                found.append(f"{frame.can_id:03X} was {result.value}")
        wanted = (HEARTBEAT_ID,) if self.silent() else self._cycles
        for can_id in wanted:
            last = self._sent_ns.get(can_id)
            if last is None or now_ns - last >= self._cycles[can_id]:
                found.append(f"{can_id:03X} is due and was not made")
        more = len(found) - MOST_NAMED
        return "; ".join(found[:MOST_NAMED]) + (f" and {more} more" if more > 0 else "")
