"""Compiled side of `thermal`: readings, temperature cycles, reports. Twins are `.py_func`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dbc._lean import inlined, lean
from estimators import _maisd_kernels as maisd
from gateway._inputs_kernels import fresh
from gateway._sensors_kernels import (
    add_reading,
    add_value,
    fault,
    fault_sensor,
    not_yet_valid,
    received_ns,
    sensor_values,
)

if TYPE_CHECKING:
    from gateway.channel import ChannelState
    from gateway.inputs import Places
    from gateway.receiving import Scratch, Wiring
    from gateway.said import Findings
    from gateway.slow import SlowState
    from gateway.warmth import Averages, Seconds, Warmth

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

_NEVER = -(1 << 63)
FOREVER = (1 << 63) - 1
_NEXT, _CYCLES, _AT, _FULL, _STIRRED, _UNTIL = range(6)  # warmth.Beat
_UNCALIBRATED, _MAISD, _MODEL = range(3)  # warmth.Method
_AS_IT_IS = -1  # warmth
_UNKNOWN, _GOOD, _BAD = 0, 1, 2  # Flag
_FINE, _STARTING, _STALE, _NOT_AVAILABLE, _TOO_FEW, _CONFIG = 0, 1, 2, 6, 8, 11  # Reason
_NO_CLASS, _NO_FAULT, _OVERHEATING, _COOLING_LOSS, _BEARING = range(5)  # FaultClass
_POINTS, AMBIENT = 3, 3
_VALID = 0  # dbc.codec


@lean
def hear(seen: int, scratch: Scratch, wiring: Wiring, warmth: Warmth) -> None:
    """The temperatures of a tick, `seen` rows of `scratch`; see `Inbox.temperatures`."""
    drives, ambient, configured = warmth.drives, warmth.seconds.ambient, warmth.averages.configured
    for i in range(seen):
        row = scratch.seen[i]
        c = scratch.channel[row]
        j, t, quality = wiring.drive[c], scratch.t_ns[row], wiring.quality[c]
        usable = quality < 0 or scratch.value[row, quality] in (1.0, 2.0)
        add_reading(j, t, drives)
        # Each point by itself: one dead sensor must not silence the other three.
        for k in range(_POINTS):
            column = wiring.columns[c, k]
            if usable and scratch.validity[row, column] == _VALID and configured[j, k]:
                value = scratch.value[row, column]
                add_value(j, k, t, value, round(value * 10.0), drives)
        column = wiring.columns[c, AMBIENT]
        valid = usable and scratch.validity[row, column] == _VALID
        ambient[j] = scratch.value[row, column] if valid else math.nan


@inlined
def _add(j: int, k: int, value: float, seconds: Seconds) -> None:
    seconds.total[j, k] += value
    seconds.number[j, k] += 1.0


@inlined
def add_up(
    now: int, values: Array, believed: Bools, places: Places, state: ChannelState, slow: SlowState,
    seconds: Seconds, beat: Ints,
) -> bool:  # fmt: skip
    """One temperature cycle of a second; true where it is the last, and `seconds.mean` is filled.

    values (N, P) degC of sensors that are `believed` (N, P).
    """
    for j in range(believed.shape[0]):
        any_believed = False
        for k in range(_POINTS):
            if believed[j, k]:
                any_believed = True
                _add(j, k, values[j, k], seconds)
        if not math.isnan(slow.command[j]) and fresh(places.status[j], now, state):
            # Of the amplitude.
            _add(j, _POINTS, 2.0 * (slow.irms[j] * slow.irms[j]), seconds)
        if not math.isnan(slow.speed[j]) and fresh(places.motion[j], now, state):
            _add(j, _POINTS + 1, abs(slow.speed[j]), seconds)
        if any_believed and math.isfinite(seconds.ambient[j]):
            _add(j, _POINTS + 2, seconds.ambient[j], seconds)
    beat[_AT] += 1
    if beat[_AT] < seconds.every:
        return False
    beat[_AT] = 0
    for j in range(seconds.mean.shape[0]):
        for k in range(seconds.mean.shape[1]):
            number = seconds.number[j, k]
            seconds.mean[j, k] = seconds.total[j, k] / number if number > 0.0 else math.nan
            seconds.total[j, k] = seconds.number[j, k] = 0.0
    return True


@inlined
def _average(cycle: int, values: Array, averages: Averages) -> None:
    """The windows advance."""
    mean, known = averages.mean, averages.known
    maisd.take(
        averages.ring, cycle, values, averages.believed, mean, averages.number, known
    )  # fmt: skip
    for j in range(mean.shape[0]):
        for k in range(mean.shape[1]):
            known[j, k] &= averages.believed[j, k]
            apart, gain = mean[j, k] - averages.offset[j, k], averages.gain[j, k]
            # Of a sensor that stood still while the fleet was learnt from; nobody raises here.
            averages.centred[j, k] = apart / gain if gain != 0.0 else apart * math.inf
    maisd.compare(
        averages.centred, known, averages.ranked, averages.spread, averages.deviation
    )  # fmt: skip


@lean
def advance(
    came: bool, now: int, summed: bool, places: Places, state: ChannelState, slow: SlowState,
    warmth: Warmth,
) -> bool:  # fmt: skip
    """Once per temperature cycle, believe and average; true where a second is complete.

    came: there were readings in this tick; summed: somebody wants to know of seconds.
    """
    beat, averages = warmth.beat, warmth.averages
    if came:
        beat[_STIRRED] = 1
        if beat[_NEXT] == _NEVER:
            beat[_NEXT] = now
    due = beat[_NEXT]
    if due == _NEVER or now < due:
        return False
    beat[_NEXT] = due + warmth.period_ns * (1 + (now - due) // warmth.period_ns)
    beat[_STIRRED], beat[_FULL] = 1, 0
    for j in range(warmth.kept_ns.shape[0]):
        warmth.kept_ns[j] = _NEVER
    values = averages.value
    sensor_values(now, warmth.drives, values, averages.believed)
    full = summed and add_up(
        now, values, averages.believed, places, state, slow, warmth.seconds, beat
    )
    if full:
        beat[_FULL] = 1
    _average(beat[_CYCLES], values, averages)
    beat[_CYCLES] += 1
    return full


@inlined
def _blank(j: int, reason: int, out: Findings) -> None:
    """Nothing is known of drive j."""
    out.thermal[j] = out.sensor[j] = _UNKNOWN
    out.reason[j] = reason
    out.fault_class[j], out.fault_sensor[j] = _NO_CLASS, 0
    out.mixed_c[j] = out.maisd_k[j] = out.rate_k_h[j] = math.nan
    out.jumps[j] = 0


@inlined
def _mixed(j: int, averages: Averages) -> float:
    """Mean of the believed window averages, degC."""
    total, count = 0.0, 0
    for k in range(averages.known.shape[1]):
        if averages.known[j, k]:
            total += averages.mean[j, k]
            count += 1
    return total / count if count else math.nan


@inlined
def _largest(spread: Array) -> float:
    """The largest MAISD, K; NaN where there is none."""
    found = math.nan
    for k in range(spread.shape[0]):
        if math.isfinite(spread[k]) and not found >= spread[k]:
            found = spread[k]
    return found


@inlined
def _unlike(j: int, warmth: Warmth, out: Findings) -> None:
    """MAISD says that the fleet differs; the deviation says which motor it is."""
    averages, fitted = warmth.averages, warmth.averages.configured
    reason = _FINE
    hot = 0
    for k in range(_POINTS):
        if fitted[j, k] and not averages.known[j, k]:
            reason = _STARTING
        elif fitted[j, k] and reason == _FINE and not math.isfinite(averages.deviation[j, k]):
            reason = _TOO_FEW
        beyond = averages.deviation[j, k] > averages.apart_k[k]
        if beyond and averages.spread[k] > averages.limit_k[k]:
            hot |= 1 << k
    out.reason[j] = reason
    if reason != _FINE:
        return
    out.thermal[j] = _BAD if hot else _GOOD
    if not hot:
        out.fault_class[j] = _NO_FAULT
    elif not hot & 1:
        out.fault_class[j] = _BEARING
    else:
        out.fault_class[j] = _COOLING_LOSS if hot > 1 else _OVERHEATING


@inlined
def _judge(j: int, now: int, warmth: Warmth) -> None:
    """Judge drive j anew, fills its row of `kept`."""
    out, model = warmth.kept, warmth.model
    _blank(j, _STARTING, out)
    out.mixed_c[j] = _mixed(j, warmth.averages)
    out.maisd_k[j] = _largest(warmth.averages.spread)
    out.rate_k_h[j], out.jumps[j] = model.rate_k_h[j], model.jumps[j]
    kind = fault(j, now, warmth.drives)
    if kind != _NO_FAULT:
        out.sensor[j], out.reason[j] = _BAD, _NOT_AVAILABLE
        out.fault_class[j], out.fault_sensor[j] = kind, fault_sensor(j, now, warmth.drives)
        return
    out.sensor[j] = _UNKNOWN if not_yet_valid(j, warmth.drives) else _GOOD
    if warmth.method == _UNCALIBRATED:
        out.reason[j] = _CONFIG
    elif warmth.method == _MAISD:
        _unlike(j, warmth, out)
    else:
        out.thermal[j], out.reason[j] = model.thermal[j], model.reason[j]
        out.fault_class[j], out.fault_sensor[j] = model.fault_class[j], model.fault_sensor[j]
        if model.sensor[j] != _AS_IT_IS:
            out.sensor[j] = model.sensor[j]


@inlined
def report_one(j: int, now: int, limit_ns: int, warmth: Warmth, out: Findings) -> int:
    """Evidence for one motor at `now`, fills its row; until when it stands if nothing comes.

    limit_ns: how old its temperatures may be.
    """
    heard, kept = received_ns(j, warmth.drives), warmth.kept
    out.heard_ns[j] = heard
    warmth.fresh[j] = heard != _NEVER and now - heard <= limit_ns
    if not warmth.fresh[j]:
        _blank(j, _STARTING if heard == _NEVER else _STALE, out)
        return FOREVER
    if now >= warmth.kept_ns[j]:
        _judge(j, now, warmth)
        # Nothing here changes faster than the temperatures come.
        warmth.kept_ns[j] = now + warmth.period_ns
    out.thermal[j], out.sensor[j], out.reason[j] = kept.thermal[j], kept.sensor[j], kept.reason[j]
    out.fault_class[j], out.fault_sensor[j] = kept.fault_class[j], kept.fault_sensor[j]
    out.mixed_c[j], out.maisd_k[j] = kept.mixed_c[j], kept.maisd_k[j]
    out.rate_k_h[j], out.jumps[j] = kept.rate_k_h[j], kept.jumps[j]
    return int(min(warmth.kept_ns[j], heard + limit_ns + 1))


@lean
def report(now: int, limit_ns: Ints, warmth: Warmth, out: Findings) -> None:
    """Every motor's report, where one can have changed since the last call. limit_ns (N,)."""
    beat = warmth.beat
    if not beat[_STIRRED] and now < beat[_UNTIL]:
        return
    beat[_STIRRED], beat[_UNTIL] = 0, FOREVER
    for j in range(limit_ns.shape[0]):
        beat[_UNTIL] = min(beat[_UNTIL], report_one(j, now, limit_ns[j], warmth, out))
