"""Age of a channel for the thermal loop, which is still numba's; else `is_channel_fresh` in C."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dbc._lean import inlined

if TYPE_CHECKING:
    from gateway.channel import ChannelState

_NONE = 0  # Reason


@inlined
def fresh(c: int, now: int, state: ChannelState) -> bool:
    """True while channel c's last good value is within its limit and can be believed."""
    if c < 0:
        return False
    good = state.good_ns[c]
    return bool(good >= 0 and now - good <= state.limit_ns[c] and state.reason[c] == _NONE)
