"""Compiled side of `slow`: what a good `Motion` or `Status` row leaves behind."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from dbc._lean import inlined
from gateway.slow import RPM, STEADY_NM, STEADY_SHARE

if TYPE_CHECKING:
    from gateway.pairing import Wiring
    from gateway.receiving import Scratch
    from gateway.slow import Readings, SlowState

_MOTION = 3  # pairing.Kind
_READINGS, _CHANGED = range(2)  # slow.Count
_OPERATION = 2  # Status.State
_RADIANS = math.pi / 180.0


@inlined
def keep(
    row: int, c: int, wiring: Wiring, scratch: Scratch, slow: SlowState, readings: Readings
) -> None:
    """Keep the values of a good `Motion` or `Status` row."""
    d, t = wiring.drive[c], scratch.t_ns[row]
    first = scratch.value[row, wiring.columns[c, 0]]
    second = scratch.value[row, wiring.columns[c, 1]]
    third = math.nan
    if wiring.points[c] > 2:
        third = scratch.value[row, wiring.columns[c, 2]]
    slow.came[_CHANGED] += 1
    if wiring.kind[c] == _MOTION:
        n = slow.came[_READINGS]
        slow.came[_READINGS] += 1
        slow.speed[d] = first * RPM
        readings.drive[n], readings.t_ns[n] = d, t
        readings.speed[n], readings.torque[n] = slow.speed[d], second
        readings.angle[n] = third * _RADIANS
        return
    before = first if math.isnan(slow.command[d]) else slow.command[d]
    slow.steady[d] = abs(first - before) <= STEADY_NM + STEADY_SHARE * abs(first)
    slow.command[d], slow.before[d], slow.irms[d] = first, before, second
    slow.operating[d] = math.isnan(third) or third == _OPERATION
    slow.command_ns[d] = t
