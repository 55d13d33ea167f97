"""Compiled side of `inputs`: a loop over drives, so the twin is the same function uncompiled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dbc._lean import inlined, lean
from gateway.health import RANKS

if TYPE_CHECKING:
    from gateway.channel import ChannelState
    from gateway.inputs import Inputs, Places
    from gateway.pairing import PairState
    from gateway.slow import SlowState

_UNKNOWN, _GOOD, _BAD = 0, 1, 2  # Flag
_NONE, _STALE, _CORRUPTED, _SEQUENCE, _RANGE, _CONFIG = 0, 2, 3, 4, 5, 11  # Reason


@inlined
def worse(one: int, other: int) -> int:
    """`health.worst` of two reasons."""
    return one if RANKS[one] <= RANKS[other] else other


@inlined
def fresh(c: int, now: int, state: ChannelState) -> bool:
    """True while channel c's last good value is within its limit and can be believed."""
    if c < 0:
        return False
    good = state.good_ns[c]
    return bool(good >= 0 and now - good <= state.limit_ns[c] and state.reason[c] == _NONE)


@inlined
def _cause(k: int, lost: bool, suspect: bool, places: Places, state: ChannelState) -> int:
    """Why drive k's currents and voltages cannot be believed; _NONE if they can."""
    if places.electrical[k, 0] < 0:
        return _CONFIG
    found = _RANGE if suspect else _NONE
    for i in range(places.electrical.shape[1]):
        c = places.electrical[k, i]
        if c >= 0:
            found = worse(found, state.reason[c])
    return worse(found, _STALE) if lost else found


@inlined
def _comm(k: int, ill: bool, places: Places, state: ChannelState) -> int:
    """Bad once anything that was valid is stale, silent or corrupted, or we are not alone (ill).

    Good once all that was heard, the electrical messages with it, has been valid. (How long it must
    have been is the flag's timing: before a cycle of the slowest message, one that was not yet
    heard may follow.)
    """
    if ill:
        return _BAD
    unheard = missing = False
    for c in range(places.first[k], places.last[k]):
        if state.seen_valid[c]:
            if state.reason[c] in (_STALE, _CORRUPTED, _SEQUENCE):
                return _BAD
            continue
        unheard = True
        if state.heard_ns[c] >= 0:
            missing = True
        for i in range(places.electrical.shape[1]):
            if places.electrical[k, i] == c:
                missing = True
    if places.electrical[k, 0] < 0:  # mapped, and its inverter sends none
        return _UNKNOWN if unheard else _GOOD
    return _UNKNOWN if missing else _GOOD


@lean
def look(
    now: int, lost: NDArray[np.bool_], intruder: bool, places: Places, state: ChannelState,
    pairs: PairState, slow: SlowState, out: Inputs,
) -> None:  # fmt: skip
    """Fills `out` at the end of what came in. lost (N,): the heartbeat was seen and has stopped."""
    for k in range(lost.shape[0]):
        suspect = pairs.sum_error[k] > places.sum_limit_a[k]
        out.suspect[k] = suspect
        cause = _cause(k, lost[k], suspect, places, state)
        out.cause[k] = cause
        # The older of a pair's two frames is stale first, by up to what they were apart.
        sample = pairs.sample_ns[k]
        known = sample >= 0 and now - sample <= places.limit_ns[k]
        out.fresh[k] = known and cause != _STALE
        status, motion = places.status[k], places.motion[k]
        out.commanded[k] = not math.isnan(slow.command[k]) and fresh(status, now, state)
        out.speed[k] = slow.speed[k] if fresh(motion, now, state) else math.nan
        out.comm[k] = _comm(k, lost[k] or intruder, places, state)
