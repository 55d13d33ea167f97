"""Compiled side of `outbox`: what is due, and its bytes. Its twin is the same uncompiled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dbc._codec_kernels import encode_frame
from dbc._e2e_kernels import e2e_protect
from dbc._lean import inlined, lean

if TYPE_CHECKING:
    from dbc.records import Records
    from gateway.flags import Status
    from gateway.sources import Memory, Room, Sheet

Array = NDArray[np.float64]

(
    _ADHESION, _THERMAL, _HEALTH, _SPEED, _LOAD, _LOST, _NIS, _CLASS, _SENSOR_AT, _MIXED, _MAISD,
    _RATE, _JUMPS, _ADHESION_REASON, _FAULTS_REASON, _SENSOR, _COMM, _ESTIMATOR, _OVERRUN, _STATE,
    _DETECTOR, _COMMON_MODE, _AGE, _TEMPERATURE_AGE, _COUNTED,
) = range(25)  # sources.Source  # fmt: skip
_NEVER = -(1 << 63)
_MS = 1_000_000
_RPM = 60.0 / (2.0 * 3.141592653589793)
_MOST_NIS = 25.4
_MOST_JUMPS = 14
_MOST_AGE, _MOST_TEMPERATURE_AGE = 254, 2540
"""One below the code for not available, each."""


@inlined
def _number_of(source: int, drive: Any) -> float:
    """A value of a drive; NaN where it is not known."""
    x = math.nan
    if source == _SPEED:
        x = drive["speed_rad_s"] * _RPM
    elif source == _LOAD:
        x = drive["load_nm"]
    elif source == _LOST:
        x = 100.0 * drive["loss_probability"]
    elif source == _NIS:
        x = _MOST_NIS if drive["nis"] > _MOST_NIS else drive["nis"]
    elif source == _MIXED:
        x = drive["mixed_c"]
    elif source == _MAISD:
        x = drive["maisd_k"]
    elif source == _RATE:
        x = drive["rate_k_h"]
    elif source == _JUMPS and not math.isnan(drive["rate_k_h"]):
        x = float(min(drive["jumps"], _MOST_JUMPS))
    return x


@inlined
def _word_of(source: int, drive: Any) -> int:
    """A state, class or number of a sensor, of a drive."""
    word = drive["flag"][0]["state"]
    if source == _THERMAL:
        word = drive["flag"][1]["state"]
    elif source == _HEALTH:
        word = drive["health"]
    elif source == _CLASS:
        word = drive["fault_class"]
    elif source == _SENSOR_AT:
        word = drive["fault_sensor"]
    return int(word)


@inlined
def _train_word(source: int, train: Any) -> int:
    """A state or reason of all drives together."""
    word = train["adhesion_reason"]
    if source == _FAULTS_REASON:
        word = train["faults_reason"]
    elif source == _SENSOR:
        word = train["sensor"]
    elif source == _COMM:
        word = train["comm"]
    elif source == _ESTIMATOR:
        word = train["estimator"]
    elif source == _OVERRUN:
        word = train["overrun"]
    elif source == _STATE:
        word = train["state"]
    elif source == _DETECTOR:
        word = train["detector"]
    elif source == _COMMON_MODE:
        word = train["common_mode"]
    return int(word)


@inlined
def _age_of(age_ns: int, step_ms: int, most_ms: int) -> float:
    """An age in ms; NaN without one."""
    if age_ns == _NEVER:
        return math.nan
    return float(min(most_ms, step_ms * (age_ns // (step_ms * _MS))))


@inlined
def value_of(source: int, k: int, status: Status, counted: Array) -> float:
    """The physical value of a signal; NaN where it is not known."""
    if source >= _COUNTED:
        return float(counted[source - _COUNTED])
    if source == _AGE:
        return _age_of(status.train[0]["age_ns"], 1, _MOST_AGE)
    if source == _TEMPERATURE_AGE:
        return _age_of(status.train[0]["temperature_age_ns"], 10, _MOST_TEMPERATURE_AGE)
    if _SPEED <= source <= _NIS or _MIXED <= source <= _JUMPS:
        return _number_of(source, status.drives[k])
    if source >= _ADHESION_REASON:
        return float(_train_word(source, status.train[0]))
    return float(_word_of(source, status.drives[k]))


@inlined
def _changed(status: Status, memory: Memory) -> bool:
    """Whether what counts as a change of the faults frame is another than in the last tick."""
    n, changed = status.drives.shape[0], False
    for i in range(n + 4):
        if i < n:
            now = _word_of(_THERMAL, status.drives[i])
        else:
            now = _train_word(_SENSOR + i - n, status.train[0])
        if now != memory.key[i]:
            changed = True
            memory.key[i] = now
    return changed


@lean
def send(
    now: int, status: Status, counted: Array, sheet: Sheet, config: Records, memory: Memory,
    room: Room,
) -> int:  # fmt: skip
    """Encode what is due; fills payload and message of `room`, gives the number of frames."""
    if _changed(status, memory):
        memory.next_ns[sheet.changing] = now
    rows = 0
    for m in range(sheet.cycle_ns.shape[0]):
        start, cycle = memory.next_ns[m], sheet.cycle_ns[m]
        # What goes out with every tick does so however late the first one was.
        if now + sheet.slack_ns < start and cycle > sheet.tick_ns:
            continue
        # The grid stays, however late a tick is; what was missed is not sent later.
        behind = max(now - start, 0) // cycle
        memory.next_ns[m] = start + cycle * (1 + behind)
        for c in range(sheet.given.shape[1]):
            if sheet.given[m, c]:
                room.value[rows, c] = value_of(
                    sheet.source[m, c], sheet.drive[m, c], status, counted
                )
        encode_frame(sheet.codec, m, room.value, sheet.given, room.payload, rows)
        e2e_protect(room.payload, rows, m, memory.counter[m] & 0xFF, config)
        memory.counter[m] += 1
        room.message[rows] = m
        rows += 1
    return rows
