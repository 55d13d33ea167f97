"""Compiled: signs of a second sender of one message. Its twin is itself, uncompiled."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dbc._lean import inlined
from gateway.channel import GUARD_NS, SECOND_SENDER, TOO_SOON

if TYPE_CHECKING:
    from gateway.channel import ChannelState


_LAST_NS = (1 << 63) - 1


@inlined
def note_foul(c: int, t: int, before: int, state: ChannelState) -> None:
    """A frame of channel c is repeated or out of sequence; one was heard at `before`, ns.

    So soon after another it is a second sender's. Three of them, and until a second has passed
    without any nothing of this message is believed.
    """
    if before < 0 or t - before >= TOO_SOON * state.period_ns[c]:
        return
    if t - state.foul_ns[c] > GUARD_NS:
        state.fouls[c] = 0
    state.fouls[c] += 1
    state.foul_ns[c] = t
    if state.fouls[c] >= SECOND_SENDER:
        state.guarded_ns[c] = min(t, _LAST_NS - GUARD_NS) + GUARD_NS
