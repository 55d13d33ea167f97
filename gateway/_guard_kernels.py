"""Signs of a second sender of one message. Compiled for the receive loop; its twin is itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dbc._lean import inlined
from dbc.e2e import MAX_DELTA
from gateway.channel import COPIES, GUARD_NS, SECOND_SENDER, TOO_SOON

if TYPE_CHECKING:
    from gateway.channel import ChannelState


_LAST_NS = (1 << 63) - 1


def note_counter(c: int, t: int, steps: int, copy: bool, state: ChannelState) -> None:
    """Note the counter of a frame of channel c, stamp t ns, whose checksum is right.

    steps: how far it is ahead of the last one, a whole turn if it is the same; copy: the frame is
    the last one once more, byte for byte. Each step takes the sender a period, so a jump that
    took less is a second sender's, or a restart's, which is rare. Copies are a controller's that
    repeats a frame, as long as there are few. After enough signs nothing of this message is
    used until `GUARD_NS` after the last.
    """
    if copy:
        state.copies[c] = min(state.copies[c] + 2, COPIES + 1)
        if state.copies[c] < COPIES:
            return
        state.fouls[c] = SECOND_SENDER
    else:
        since = t - state.counted_ns[c]
        state.counted_ns[c] = t
        if steps <= MAX_DELTA:
            state.copies[c] = max(state.copies[c] - 1, 0)
            return
        if since >= TOO_SOON * steps * state.period_ns[c]:
            return
        if t - state.foul_ns[c] > GUARD_NS:
            state.fouls[c] = 0
        state.fouls[c] += 1
    state.foul_ns[c] = t
    if state.fouls[c] >= SECOND_SENDER:
        state.guarded_ns[c] = min(t, _LAST_NS - GUARD_NS) + GUARD_NS


note_foul = inlined(note_counter)
