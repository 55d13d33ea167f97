"""Many ticks of a gateway in few calls: what a replay is made of.

Most ticks hold nothing that only `Gateway.step` can do: no emergency, no heartbeat that is overdue,
no second that the thermal model waits for, no detector but the default. Those are done by one
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
from gateway import stretch
from gateway._direct import Direct
from gateway._ticks_kernels import HEARD, several
from gateway.core import Gateway
from gateway.health import REJECTED, Flag, Reason
from gateway.receiving import NAMES
from gateway.stretch import Filtering, Judging, Left, Receiving, Saying, Warming
from gateway.view import Counted

REJECTS: Final = np.array([name in REJECTED for name in NAMES])
FRAMES: Final = 512
"""Of ours that there is room for in a call."""

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


class Ticks:
    """Steps of one gateway; it may be stepped by others in between."""

    def __init__(self, gateway: Gateway) -> None:
        self.gateway = gateway
        self._possible = (
            gateway.adhesion.in_core
            and gateway.translator is None
            and gateway.outbox.authenticator is None
        )
        self._period_ns = gateway.config.loop.period_ns
        self._went = stretch.went(FRAMES, len(gateway.outbox.heads), len(gateway.nodes))
        # By number of message: a frame of it, which costs what they all cost.
        heads = [
            Frame(0, can_id, bytes(size), flags) for can_id, size, flags in gateway.outbox.heads
        ]
        self._cost_s = np.array([gateway.load.cost_s(frame) for frame in heads])
        self._heads = block_of(heads)
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
            until, whole = self._until(at), 0
            if until > at:
                rest = block.part(first, int(ends[-1]))
                whole, frames = self._few(rest, ends[done:] - first, at, until)
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

    def _until(self, now: Nanos) -> Nanos:
        """No tick before it needs more than the compiled loop; `now` or less if this one does.

        Closes the second of the bus load that is over, which else would be such a tick.
        """
        gateway = self.gateway
        if not (self._possible and gateway.begun and gateway.calm and gateway.doubt.none(now)):
            return now
        gateway.load.close(now)
        return min(gateway.thermal.alone_ns, gateway.load.window_ns)

    def _few(self, block: Block, ends: Ints, now: Nanos, until: Nanos) -> tuple[int, list[Block]]:
        """As `run`, for ticks before `until`; none if the first wants a step of its own."""
        gateway, went = self.gateway, self._went
        inbox, outbox = gateway.inbox, gateway.outbox
        inbox.begin()
        counted = gateway.counted(now)
        outbox.note_counts(counted)
        left = Left(*self._several(
            block.t_ns, block.can_id, block.flags, block.length, block.data, ends, now, until,
            self._receiving(), self._filtering(), self._judging(),
            self._warming(), self._saying(counted), went,
        ))  # fmt: skip
        gateway.load.busy_s, inbox.seen = left.busy_s, left.seen
        inbox.counts["received"] += went.tally.item(0)
        # No count of none: single steps leave none either.
        if decoded := went.tally.item(1):
            inbox.counts["decoded"] += decoded
        went.tally[:] = 0
        done, out = left.done, [self._frames(left.frames, now)]
        at = now + done * self._period_ns
        if done:
            outbox.note_sent(at - self._period_ns)
            gateway.doubt.tick(at - self._period_ns, 0)
            gateway.note(gateway.adhesion.opinion, at - self._period_ns)
            gateway.changed = left.changed
        own = inbox.counts["own"]
        inbox.count()
        if left.stage == HEARD:
            part = block.part(left.first, int(ends[done]))
            inbox.note(part)
            last = gateway.heard(part, inbox.counts["own"] - own, at)
            return done + 1, [*out, block_of(last)]
        return done, out

    def _frames(self, rows: int, now: Nanos) -> Block:
        """What has gone out, tick by tick."""
        went, heads = self._went, self._heads
        message = went.message[:rows]
        out = blank(rows, heads.names)
        out.t_ns[:] = now + went.tick[:rows] * self._period_ns
        out.can_id[:], out.flags[:] = heads.can_id[message], heads.flags[message]
        out.length[:], out.data[:] = heads.length[message], went.payload[:rows]
        return out

    def _receiving(self) -> Receiving:
        gateway = self.gateway
        receiver, load = gateway.inbox.receiver, gateway.load
        return Receiving(
            self._period_ns, receiver.address, receiver.tick, receiver.counters, receiver.state,
            receiver.wiring, receiver.pairs, receiver.slow, receiver.scratch,
            gateway.supervision.address, load.busy_s, load.classic_s, load.fd_s,
            gateway.inputs.channels.ctypes.data, gateway.inputs.status.ctypes.data, gateway.places,
        )  # fmt: skip

    def _filtering(self) -> Filtering:
        bank, motion = self.gateway.bank, self.gateway.motion
        bank.make_room(len(self.gateway.inbox.room.drive))
        return Filtering(
            self.gateway.inputs.columns, bank.address, bank.told, motion.address,
            motion.implausible,
        )  # fmt: skip

    def _judging(self) -> Judging:
        side = self.gateway.adhesion
        return Judging(
            side.address, self.gateway.inbox.receiver.drives.ctypes.data, side.loss_probability,
            side.loss_known, side.severe, side.uncertain, side.rules, side.common_mode,
        )  # fmt: skip

    def _warming(self) -> Warming:
        gateway, thermal = self.gateway, self.gateway.thermal
        summed = thermal.learning or thermal.heat is not None
        return Warming(thermal.warmth, summed, gateway.temperature_limit_ns)

    def _saying(self, counted: Counted) -> Saying:
        gateway, outbox, flags = self.gateway, self.gateway.outbox, self.gateway.flags
        # The loop ends where there is a reason against all flags, an overrun or an intruder.
        flags.note_train(Reason.NONE, Flag.UNKNOWN, silent=False, overrun=False)
        return Saying(
            gateway.findings, flags.train_inputs, flags.inputs, flags.evidence, flags.status,
            outbox.counts, outbox.sheet, outbox.e2e_config, outbox.memory, outbox.room,
            self._cost_s, counted.rejected, counted.lost, REJECTS,
        )  # fmt: skip
