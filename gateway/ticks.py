"""Many ticks of a gateway in few calls: what a replay is made of.

Most ticks hold nothing that only `Gateway.step` can do: no emergency, no pause,
no detector but the default. Those are done by one
compiled loop over them, others one by one; a tick that turns out to need more in its midst is
finished by the gateway from there. The same frames go out as of single steps, and the same state is
left (`tests/unit/test_ticks.py`).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from dbc.block import Block, blank, block_of
from dbc.frame import Frame, Nanos
from estimators.detect import Opinion
from estimators.detect.variational import VariationalDetector
from gateway import stretch
from gateway._direct import Direct
from gateway._ticks_kernels import FILTERED, HEARD, several
from gateway.adhesion import (
    LEARN_NS,
    PASSING,
    PROBABLY_GOOD,
    SETTLED_NS,
    SEVERE,
    SEVERE_SPREADS,
)
from gateway.core import Gateway
from gateway.stretch import Filtering, Judging, Left, Receiving, Saying

FRAMES: Final = 512
"""Of ours that there is room for in a call."""

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


class Ticks:
    """Steps of one gateway; it may be stepped by others in between."""

    def __init__(self, gateway: Gateway) -> None:
        self.gateway = gateway
        detector, n = gateway.adhesion.detector, len(gateway.nodes)
        self._detector = detector if isinstance(detector, VariationalDetector) else None
        self._possible = (
            self._detector is not None
            and gateway.translator is None
            and gateway.outbox.authenticator is None
        )
        self._period_ns = gateway.config.loop.period_ns
        self._lost, self._known = np.zeros(n), np.zeros(n, dtype=np.bool_)
        self._rough = np.zeros((4, n))
        self._went = stretch.went(FRAMES, len(gateway.outbox.heads), n)
        # By number of message: a frame of it.
        self._heads = block_of(
            [Frame(0, can_id, bytes(size), flags) for can_id, size, flags in gateway.outbox.heads]
        )
        self._several = Direct(several)

    def run(self, block: Block, ends: Ints, now: Nanos) -> tuple[int, list[Block]]:
        """Ticks at `now`, a period later and so on, one for each of ends (K,).

        Gives their number, and what goes out.
        Tick k takes the frames from ends[k - 1] (0 for the first) to ends[k]. Ends behind the first
        tick in which a flag changed: those that are left are the caller's to ask for again.
        `peak` is of the ticks that were done.
        """
        self.peak[:] = np.nan
        gateway, out, done = self.gateway, [], 0  # type: tuple[Gateway, list[Block], int]
        while done < len(ends) and not (done and gateway.changed):
            first, at = int(ends[done - 1]) if done else 0, now + done * self._period_ns
            whole = 0
            if self._compiled:
                rest = block.part(first, int(ends[-1]))
                whole, frames = self._few(rest, ends[done:] - first, at)
                out += frames
            if not whole:
                whole = 1
                out.append(block_of(gateway.step(block.part(first, int(ends[done])), at)))
            # Of a tick that was finished here; of others once more.
            np.fmax(self.peak, gateway.status.drives["loss_probability"], out=self.peak)
            done += whole
        return done, out

    @property
    def peak(self) -> Array:
        """(N,) largest probability of loss that the last `run` said of each drive; NaN: none."""
        return self._went.peak

    @property
    def _compiled(self) -> bool:
        """Whether the compiled loop may try the next tick."""
        gateway = self.gateway
        return self._possible and gateway.begun

    def _few(self, block: Block, ends: Ints, now: Nanos) -> tuple[int, list[Block]]:
        """As `run`; none if the first tick wants a step of its own."""
        gateway, went = self.gateway, self._went
        inbox, outbox, adhesion = gateway.inbox, gateway.outbox, gateway.adhesion
        inbox.begin()
        outbox.note_counts(gateway.counted(now))
        left = Left(*self._several(
            block.t_ns, block.can_id, block.flags, block.length, block.data, ends, now,
            self._receiving(), self._filtering(), self._judging(), self._saying(), went,
        ))  # fmt: skip
        inbox.seen = left.seen
        adhesion.learn_ns = left.learn_ns
        inbox.counts["received"] += went.tally.item(0)
        # No count of none: single steps leave none either.
        if decoded := went.tally.item(1):
            inbox.counts["decoded"] += decoded
        went.tally[:] = 0
        done, out = left.done, [self._frames(left.frames)]
        at = now + done * self._period_ns
        if done:
            room = adhesion.room
            gateway.note(Opinion(room.lost, room.known, left.common), at - self._period_ns)
            gateway.changed = left.changed
        inbox.count()
        if left.stage == HEARD:
            part = block.part(left.first, int(ends[done]))
            inbox.note(part)
            last = gateway.heard(part, inbox.receiver.received().own, at)
            return done + 1, [*out, block_of(last)]
        if left.stage == FILTERED:
            inbox.motions, inbox.samples = left.motions, inbox.room.first(left.samples)
            gateway.bank.begin(gateway.inputs.cause, gateway.inputs.fresh)
            return done + 1, [*out, block_of(gateway.estimated(at))]
        return done, out

    def _frames(self, rows: int) -> Block:
        """What has gone out, tick by tick."""
        sent, heads = self._went.frames[:rows], self._heads
        message = sent["message"]
        out = blank(rows, heads.names)
        out.t_ns[:], out.data[:] = sent["t_ns"], sent["data"]
        out.can_id[:], out.flags[:] = heads.can_id[message], heads.flags[message]
        out.length[:] = heads.length[message]
        return out

    def _receiving(self) -> Receiving:
        gateway = self.gateway
        receiver, load = gateway.inbox.receiver, gateway.load
        return Receiving(
            self._period_ns, receiver.address, receiver.tick, receiver.state,
            receiver.wiring, receiver.pairs, receiver.slow, receiver.scratch, receiver.readings,
            receiver.room, gateway.supervision.address, load.record.ctypes.data,
            gateway.doubt.record, gateway.supervision.lost, gateway.places,
        )  # fmt: skip

    def _filtering(self) -> Filtering:
        bank, motion = self.gateway.bank, self.gateway.motion
        return Filtering(
            self.gateway.inputs, bank.believed, bank.constants, bank.room, motion.memory,
            motion.limits, self.gateway.plausibility, self.gateway.plausibility_limits,
        )  # fmt: skip

    def _judging(self) -> Judging:
        assert self._detector is not None
        side, flags = self.gateway.adhesion, self.gateway.flags
        return Judging(
            flags.adhesion["state"], flags.adhesion["since_ns"], side.tick_s, side.rotors,
            side.train, side.reference, side.own, PASSING, SEVERE, SEVERE_SPREADS, side.at,
            side.responses, side.trust, side.room, side.rules, side.common_mode,
            self._detector.table, self._detector.sweeps, self._lost, self._known, self._rough,
            side.learn_ns, LEARN_NS, SETTLED_NS, PROBABLY_GOOD,
        )  # fmt: skip

    def _saying(self) -> Saying:
        gateway, flags = self.gateway, self.gateway.flags
        return Saying(
            gateway.thermal.record.ctypes.data, flags.train_inputs, flags.inputs, flags.evidence,
            flags.status, gateway.outbox.record.ctypes.data,
        )  # fmt: skip
