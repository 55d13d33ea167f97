"""Compiled side of `said`: evidence, flags, words. A loop over drives, so each is its own twin.

`advance` and `hold` are those of `decide`, which the tests compare them with.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dbc._lean import inlined, lean
from gateway._inputs_kernels import worse

if TYPE_CHECKING:
    from gateway.inputs import Inputs
    from gateway.said import Findings, Flags, Rules, Said
    from gateway.tracks import Told

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

_UNKNOWN, _GOOD, _BAD = 0, 1, 2  # Flag
_SAME = -1
_NEVER = -(1 << 63)
_ADHESION, _THERMAL, _COMM, _ESTIMATOR, _SENSOR, _SEVERE = range(6)  # said.Which
_NONE, _STARTING, _RANGE, _DIVERGED_REASON, _TOO_FEW, _INTRUDER = 0, 1, 5, 7, 8, 10  # Reason
_IDLE, _CONVERGING, _TRACKING, _PREDICTING, _DIVERGED = range(5)  # Health
_SENSOR_BIAS, _CURRENT = 5, 5  # FaultClass, FaultSensor
_STATE_STARTING, _STATE_RUNNING, _STATE_DEGRADED, _STATE_SILENT = 1, 2, 3, 4  # GatewayState
(
    _W_ADHESION, _W_FAULTS, _W_SENSOR, _W_COMM, _W_ESTIMATOR, _W_OVERRUN, _W_STATE, _W_DETECTOR,
    _W_COMMON, _W_AGE, _W_TEMPERATURE_AGE,
) = range(11)  # said.Whole  # fmt: skip


@inlined
def from_probability(lost: float, rules: Rules) -> int:
    """`decide.from_probability`, _SAME between the thresholds. NaN is unknown."""
    if not 0.0 <= lost <= 1.0:
        return _UNKNOWN
    if lost >= rules.raise_at:
        return _BAD
    return _GOOD if lost <= rules.clear_at else _SAME


@lean
def weigh(
    inputs: Inputs, wrong: Bools, uncertain: Bools, told: Told, lost: Array, known: Bools,
    findings: Findings, doubt: int, rules: Rules, seen: Ints, why: Ints,
) -> None:  # fmt: skip
    """Evidence of every flag and drive, fills seen (5, N), and why adhesion is unknown, why (N,).

    wrong (N,): the input cannot be what it seems; uncertain (N,): the rotor may be running away,
    which is no evidence of a loss, and of adhesion less; lost, known (N,): the detector's opinion;
    doubt: `Reason` why no adhesion flag can be believed.
    """
    for k in range(why.shape[0]):
        cause, health = inputs.cause[k], told.health[k]
        if wrong[k]:
            cause = worse(cause, _RANGE)
        adhesion, why[k] = _UNKNOWN, _STARTING
        if doubt != _NONE:
            why[k] = doubt
        elif cause != _NONE:
            why[k] = cause
        elif health == _DIVERGED:
            why[k] = _DIVERGED_REASON
        elif health != _TRACKING:
            why[k] = told.reason[k] if math.isnan(told.speed[k]) else _STARTING
        elif not known[k]:
            why[k] = _TOO_FEW
        else:
            adhesion = from_probability(lost[k], rules)
            if uncertain[k] and adhesion != _BAD:
                adhesion, why[k] = _UNKNOWN, _RANGE
        seen[_ADHESION, k] = adhesion
        # Temperatures change slowly: of all doubts only an intruder counts against them.
        seen[_THERMAL, k] = _UNKNOWN if doubt == _INTRUDER else findings.thermal[k]
        seen[_COMM, k] = inputs.comm[k]
        estimator = _BAD if health == _DIVERGED else _UNKNOWN
        seen[_ESTIMATOR, k] = _GOOD if health == _TRACKING else estimator
        seen[_SENSOR, k] = _BAD if inputs.suspect[k] else findings.sensor[k]


@inlined
def advance(f: int, k: int, seen: int, timing: int, now: int, rules: Rules, flags: Flags) -> bool:
    """`decide.advance`, or `hold` for _SAME, of one flag; whether it has changed."""
    flag = flags.flag[f, k]
    if seen == _SAME:
        if flags.evidence[f, k] != flag:
            flags.since_ns[f, k] += rules.tick_ns
        return False
    if seen != flags.evidence[f, k]:
        flags.evidence[f, k] = seen
        flags.since_ns[f, k] = now
    target, hold = rules.table[flag, seen, 0], rules.table[flag, seen, 1]
    if target == flag or now - flags.since_ns[f, k] < rules.timing[timing, hold]:
        return False
    flags.flag[f, k] = target
    return True


@lean
def decide(seen: Ints, severe: Bools, now: int, rules: Rules, flags: Flags) -> bool:
    """One tick of every flag; whether one has changed.

    severe (N,): so little is carried that noise cannot be the cause.
    """
    changed = False
    for k in range(severe.shape[0]):
        timing = _SEVERE if severe[k] else _ADHESION
        changed |= advance(_ADHESION, k, seen[_ADHESION, k], timing, now, rules, flags)
        changed |= advance(_THERMAL, k, seen[_THERMAL, k], _THERMAL, now, rules, flags)
        for f in (_COMM, _ESTIMATOR, _SENSOR):
            changed |= advance(f, k, seen[f, k], f, now, rules, flags)
    return changed


@inlined
def _faults(k: int, seen: Ints, flags: Flags, inputs: Inputs, findings: Findings,
            doubt: int, said: Said) -> None:  # fmt: skip
    """What is said of drive k's temperatures and sensors."""
    kind, sensor = findings.fault_class[k], findings.fault_sensor[k]
    if inputs.suspect[k] and findings.sensor[k] != _BAD:
        kind, sensor = _SENSOR_BIAS, _CURRENT
    thermal = flags.flag[_THERMAL, k]
    if thermal != _GOOD or seen[_THERMAL, k] == _GOOD:
        said.fault_class[k] = kind
    said.fault_sensor[k] = sensor
    reason = _INTRUDER if doubt == _INTRUDER else findings.reason[k]
    if reason == _NONE:
        reason = _STARTING
    said.thermal[k] = thermal
    said.thermal_reason[k] = reason if thermal == _UNKNOWN else _NONE
    said.mixed_c[k], said.maisd_k[k] = findings.mixed_c[k], findings.maisd_k[k]
    said.rate_k_h[k], said.jumps[k] = findings.rate_k_h[k], findings.jumps[k]


@inlined
def _motion(k: int, why: Ints, flags: Flags, told: Told, lost: float, said: Said) -> None:
    """What is said of drive k's adhesion and movement."""
    adhesion, health = flags.flag[_ADHESION, k], told.health[k]
    said.adhesion[k] = adhesion
    said.adhesion_reason[k] = why[k] if adhesion == _UNKNOWN else _NONE
    said.health[k] = health
    tracking = health in (_TRACKING, _PREDICTING) and not math.isnan(told.speed[k])
    said.speed[k] = told.speed[k] if tracking else math.nan
    said.load[k] = told.load[k] if tracking else math.nan
    said.sigma[k] = told.sigma[k] if tracking else math.nan
    said.nis[k] = told.nis[k] if tracking else math.nan
    said.lost[k] = lost


@inlined
def _summary(states: Ints) -> int:
    """`health.summary`: bad if any is bad, else unknown if any is, else good."""
    found = _GOOD
    for k in range(states.shape[0]):
        if states[k] == _BAD:
            return _BAD
        if states[k] == _UNKNOWN:
            found = _UNKNOWN
    return found


@inlined
def _oldest(ages: Ints) -> int:
    """Age of the oldest; _NEVER while any drive has none."""
    found = ages[0]
    for k in range(ages.shape[0]):
        if ages[k] == _NEVER:
            return _NEVER
        found = max(found, ages[k])
    return int(found)


@inlined
def _state(said: Said, silent: bool, overrun: bool) -> int:
    """`GatewayState` of the set."""
    if silent:
        return _STATE_SILENT
    idle, known = True, True
    for k in range(said.health.shape[0]):
        idle = idle and said.health[k] <= _CONVERGING
        known = known and said.adhesion[k] != _UNKNOWN
    if overrun or not known:
        return _STATE_STARTING if idle else _STATE_DEGRADED
    return _STATE_RUNNING


@lean
def tell(
    seen: Ints, why: Ints, now: int, flags: Flags, inputs: Inputs, told: Told, lost: Array,
    known: Bools, findings: Findings, sample_ns: Ints, doubt: int, mode: Ints, silent: bool,
    overrun: bool, said: Said,
) -> None:  # fmt: skip
    """Fill `said` after `decide`.

    sample_ns (N,): stamp of the newest sample, negative: none; mode: the first is the
    `Flag` of all drives' loss at once; overrun: ticks were missed of late.
    """
    whole = said.whole
    whole[_W_ADHESION] = whole[_W_FAULTS] = _NONE
    for k in range(why.shape[0]):
        _motion(k, why, flags, told, lost[k] if known[k] else math.nan, said)
        _faults(k, seen, flags, inputs, findings, doubt, said)
        said.sensor[k] = flags.flag[_SENSOR, k]
        said.comm[k] = flags.flag[_COMM, k]
        said.estimator[k] = flags.flag[_ESTIMATOR, k]
        said.age_ns[k] = now - sample_ns[k] if sample_ns[k] >= 0 else _NEVER
        heard = findings.heard_ns[k]
        said.temperature_age_ns[k] = _NEVER if heard == _NEVER else now - heard
        whole[_W_ADHESION] = worse(whole[_W_ADHESION], said.adhesion_reason[k])
        whole[_W_FAULTS] = worse(whole[_W_FAULTS], said.thermal_reason[k])
    whole[_W_SENSOR] = _summary(said.sensor)
    whole[_W_COMM] = _summary(said.comm)
    whole[_W_ESTIMATOR] = _summary(said.estimator)
    whole[_W_OVERRUN] = _BAD if overrun else _GOOD
    whole[_W_STATE] = _state(said, silent, overrun)
    doubted = mode[0, 0] == _GOOD and doubt != _NONE
    whole[_W_COMMON] = _UNKNOWN if doubted else mode[0, 0]
    whole[_W_AGE] = _oldest(said.age_ns)
    whole[_W_TEMPERATURE_AGE] = _oldest(said.temperature_age_ns)
