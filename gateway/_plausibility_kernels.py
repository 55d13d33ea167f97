"""Compiled side of `plausibility`: loops over samples, readings and drives; its own twin."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dbc._core_symbols import symbol
from dbc._lean import inlined, lean
from dbc.records import FILTER
from gateway import plausibility as p

if TYPE_CHECKING:
    from dbc.records import Columns
    from gateway.motion import Memory
    from gateway.pairing import Samples
    from gateway.plausibility import Plausibility, PlausibilityLimits
    from gateway.slow import Readings, SlowState
    from gateway.tracks import Told

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

_reset, _FILTER = symbol("filter_reset"), FILTER.itemsize
_TRACKING = 2  # Health
_W_E, _THETA = 2, 3  # pmsm
_OBSERVED_LOAD = 1  # observer.LoadState
_HISTORY, _REPEATS, _IN_A_ROW, _LEARN = p.HISTORY, p.REPEATS, p.IN_A_ROW, p.LEARN
_HELD_NS, _LATE_NS, _DOUBT_NS, _RESTART_NS = p.HELD_NS, p.LATE_NS, p.DOUBT_NS, p.RESTART_NS
_LEAST_CURRENT, _LEAST_TORQUE = p.LEAST_CURRENT, p.LEAST_TORQUE
_LOAD_OFF, _LOAD_OFF_RELATIVE, _LOADS_IN_A_ROW = p.LOAD_OFF, p.LOAD_OFF_RELATIVE, p.LOADS_IN_A_ROW
_TORQUE_OFF, _TORQUE_OFF_RELATIVE = p.TORQUE_OFF, p.TORQUE_OFF_RELATIVE
_TORQUE_DOUBT, _TORQUE_DOUBT_RELATIVE = p.TORQUE_DOUBT, p.TORQUE_DOUBT_RELATIVE
_ANGLE_OFF, _ANGLE_OFF_SAMPLES, _LEAST_PERIOD_S = p.ANGLE_OFF, p.ANGLE_OFF_SAMPLES, p.LEAST_PERIOD_S
_MOST_TURN = p.MOST_TURN
_KEEP, _COHERENT = p.KEEP, p.COHERENT
_LEARN_ANEW_NS, _ANGLE_GAP_NS = p.LEARN_ANEW_NS, p.ANGLE_GAP_NS
_MOTION_HELD_NS, _COMMAND_MOVED = p.MOTION_HELD_NS, p.COMMAND_MOVED
_SPEED_MOVED, _SPEED_MOVED_RAD_S = p.SPEED_MOVED, p.SPEED_MOVED_RAD_S


@inlined
def _until(k: int, now: int, hold_ns: int, check: Plausibility) -> None:
    check.until_ns[k] = max(check.until_ns[k], now + hold_ns)
    check.restart[k] = check.restart[k] or hold_ns >= _HELD_NS


@inlined
def _same(k: int, place: int, a: float, b: float, check: Plausibility) -> bool:
    return bool(a == check.vector[k, place, 0] and b == check.vector[k, place, 1])


@inlined
def _add_sample(
    k: int, a: float, b: float, passed: float, w_e: float, now: int, check: Plausibility,
    least: float,
) -> None:  # fmt: skip
    """One more current vector of drive k, `passed` s after the one before; w_e rad/s."""
    n, size = check.samples[k], math.hypot(a, b)
    newest, oldest = (n + _HISTORY - 1) % _HISTORY, n % _HISTORY
    if n > 0 and _same(k, newest, a, b, check):
        check.equal[k] += 1
        check.equal_s[k] += passed
        turned = min(abs(w_e) * check.equal_s[k], math.pi)
        if 2.0 * size * math.sin(0.5 * turned) > least:
            _until(k, now, _HELD_NS if check.equal[k] >= _REPEATS else _LATE_NS, check)
    else:
        check.equal[k] = 0
        check.equal_s[k] = 0.0
    if n >= _HISTORY and _same(k, oldest, a, b, check):
        check.block[k] += 1
        turned = abs(w_e) * passed * _HISTORY
        if check.block[k] >= _HISTORY and 2.0 * size * abs(math.sin(0.5 * turned)) > least:
            _until(k, now, _LATE_NS, check)
    else:
        check.block[k] = 0
    check.vector[k, oldest, 0] = a
    check.vector[k, oldest, 1] = b
    check.samples[k] = n + 1 if n < 1 << 40 else n + 1 - (1 << 39)


@inlined
def _nearest(k: int, t_ns: int, newest_ns: int, samples: Samples, dt_s: float) -> tuple[int, float]:
    """Row of drive k's sample nearest to a stamp, and how much later it is, s; -1 without any."""
    found, apart, t = -1, math.inf, (newest_ns - t_ns) * 1e-9
    for i in range(samples.drive.shape[0]):
        row = samples.drive.shape[0] - 1 - i
        if samples.drive[row] != k:
            continue
        if abs(t) < abs(apart):
            found, apart = row, t
        t -= (samples.steps[row] + samples.gap[row]) * dt_s
    return found, apart


@inlined
def _torque_apart(
    k: int, reported: float, theta: float, w_e: float, k_torque: float, samples: Samples,
    dt_s: float,
) -> float:  # fmt: skip
    """Least difference of a tick's torques by the currents from the reported one; it may be as old.

    theta: electrical angle at the newest sample, rad; k_torque: Nm per A.
    """
    least, t = math.inf, 0.0
    for i in range(samples.drive.shape[0]):
        row = samples.drive.shape[0] - 1 - i
        if samples.drive[row] == k:
            then = theta - w_e * t
            # Along q: the imaginary part in the rotor's frame.
            along = samples.y[row, 1] * math.cos(then) - samples.y[row, 0] * math.sin(then)
            least = min(least, abs(k_torque * along - reported))
            t += (samples.steps[row] + samples.gap[row]) * dt_s
    return least


@inlined
def _torque_off(
    k: int, apart: float, reported: float, rated: float, now: int, check: Plausibility
) -> bool:
    """Whether two torques are further apart than motor data explain; notes a lesser doubt."""
    if apart > _TORQUE_DOUBT * rated + _TORQUE_DOUBT_RELATIVE * abs(reported):
        check.doubt_ns[k] = now + _DOUBT_NS
    return bool(apart > _TORQUE_OFF * rated + _TORQUE_OFF_RELATIVE * abs(reported))


@inlined
def _angle_off(
    k: int, turned: complex, w_e: float, t_ns: int, right: bool, check: Plausibility,
    limits: PlausibilityLimits,
) -> bool:  # fmt: skip
    """Whether the current's angle has left its learnt place; learns it where it has not.

    turned: unit vector of the current in the rotor's frame, in the torque's direction; right:
    nothing speaks against it, so that it may be learnt from.
    """
    if check.learnt[k] < _LEARN:
        if right:
            check.learnt[k] += 1
            check.base[k] += (turned - check.base[k]) / check.learnt[k]
        return False
    if abs(check.base[k]) < _COHERENT:
        check.learnt[k] = 0
        check.base[k] = 0.0
        return False
    apart = turned * check.base[k].conjugate()
    passed = t_ns - check.angle_ns[k]
    follows = 0.5 if passed <= _ANGLE_GAP_NS else 1.0
    check.angle_ns[k] = t_ns
    # A frame that waited for the bus is stamped when it came, and so is off the grid of its cycle.
    cycle = limits.motion_ns
    waited_s = abs(passed - (passed + cycle // 2) // cycle * cycle) * 1e-9
    angle = math.atan2(apart.imag, apart.real)
    angle -= min(max(angle, -abs(w_e) * waited_s), abs(w_e) * waited_s)
    check.deviation[k] += follows * (angle - check.deviation[k])
    most = _ANGLE_OFF + _ANGLE_OFF_SAMPLES * abs(w_e) * max(limits.period_s, _LEAST_PERIOD_S)
    if abs(check.deviation[k]) <= most:
        check.off_ns[k] = t_ns
        if right:
            check.base[k] += (1.0 - _KEEP) * (turned - check.base[k])
        return False
    if t_ns - check.off_ns[k] > _LEARN_ANEW_NS:
        check.learnt[k] = 0
        check.base[k] = 0.0
    return True


@inlined
def _count(
    off: bool, first_ns: int, most: int, counts: Ints, k: int, now: int, check: Plausibility
) -> None:
    """first_ns: for how long a reading before `most` in a row keeps the currents from accusing."""
    counts[k] = counts[k] + 1 if off else 0
    if counts[k] >= most:
        _until(k, now, _HELD_NS, check)
    elif off:
        check.doubt_ns[k] = max(check.doubt_ns[k], now + first_ns)


@inlined
def _load_off(k: int, load: float, motion: Memory, settled: int, rated: float) -> bool:
    """Whether the load by the currents is another than that by `Motion`. NaN is not."""
    if not motion.begun[k] or motion.readings[k] < settled:
        return False
    observed = motion.observer[k, _OBSERVED_LOAD]
    return bool(abs(load - observed) > _LOAD_OFF * rated + _LOAD_OFF_RELATIVE * abs(observed))


@inlined
def _check_reading(
    r: int, now: int, samples: Samples, newest_ns: int, readings: Readings, health: int,
    filters: Columns, flux: float, check: Plausibility, limits: PlausibilityLimits,
) -> None:  # fmt: skip
    """Currents against torque and angle as measured at the same instant."""
    k, torque, angle = readings.drive[r], readings.torque[r], readings.angle[r]
    row, later = _nearest(k, readings.t_ns[r], newest_ns, samples, limits.dt_s)
    w_e = limits.pole_pairs[k] * readings.speed[r]
    if row < 0 or abs(later) > 1.5 * limits.period_s or abs(w_e) * limits.period_s > _MOST_TURN:
        return
    current = complex(samples.y[row, 0], samples.y[row, 1])
    size = abs(current)
    if not (size >= _LEAST_CURRENT * limits.rated_a[k]) and not (
        abs(torque) >= _LEAST_TORQUE * limits.rated_nm[k]
    ):
        return
    off, tracking = False, health == _TRACKING
    k_torque = limits.k_torque[k] * (1.0 if math.isnan(flux) else flux)
    sign = 1.0 if torque >= 0.0 else -1.0
    if tracking:
        far = _torque_apart(
            k, torque, filters.x[k, _THETA], w_e, k_torque, samples, limits.dt_s
        )  # fmt: skip
        off = _torque_off(k, far, torque, limits.rated_nm[k], now, check)
    if not math.isnan(angle) and size > 0.0 and abs(torque) >= _LEAST_TORQUE * limits.rated_nm[k]:
        theta = angle + w_e * later
        turned = current * complex(math.cos(theta), -math.sin(theta))
        # Along q in the torque's direction is 1.
        unit = turned * complex(0.0, -sign) / size
        if check.learnt[k] >= _LEARN:
            newest = angle + w_e * (newest_ns - readings.t_ns[r]) * 1e-9
            newest += math.atan2(check.base[k].imag, check.base[k].real)
            far = _torque_apart(k, torque, newest, w_e, k_torque, samples, limits.dt_s)
            off = _torque_off(k, far, torque, limits.rated_nm[k], now, check) or off
        # What is implausible is not learnt; a small current may have turned over since the torque.
        if size >= _LEAST_CURRENT * limits.rated_a[k]:
            right = tracking and not off and now >= check.until_ns[k]
            apart = _angle_off(k, unit, w_e, readings.t_ns[r], right, check, limits)
            _count(apart, _DOUBT_NS, _IN_A_ROW, check.off, k, now, check)
    _count(off, _DOUBT_NS, _IN_A_ROW, check.torque_off, k, now, check)


@inlined
def _moved(now: float, before: float) -> bool:
    """False where one of two speeds is not known."""
    return bool(abs(now - before) > max(_SPEED_MOVED * abs(now), _SPEED_MOVED_RAD_S))


@inlined
def _motion_held(
    k: int, now: int, measured: Array, slow: SlowState, own: float, check: Plausibility,
    rated_nm: float,
) -> bool:  # fmt: skip
    """Whether `Motion` of drive k stands still while something that it must follow has changed."""
    if now - check.changed_ns[k] <= _MOTION_HELD_NS or math.isnan(measured[k]):
        return False
    if _moved(own, check.own[k]) or _moved(own, measured[k]):
        return True
    if abs(slow.command[k] - check.command[k]) > _COMMAND_MOVED * rated_nm and (
        now - slow.command_ns[k] > _MOTION_HELD_NS
    ):
        return True
    if not math.isnan(own):
        # By its currents it turns as steadily as it says.
        return False
    moved = others = 0
    for j in range(measured.shape[0]):
        if j != k and not math.isnan(measured[j]) and not math.isnan(check.others[k, j]):
            others += 1
            moved += _moved(measured[j], check.others[k, j])
    return moved == others and others > 0


@inlined
def _note_motion(
    r: int, readings: Readings, measured: Array, slow: SlowState, own: float, check: Plausibility
) -> None:
    """Whether `Motion` has changed, and what was so when it did."""
    k, speed, torque = readings.drive[r], readings.speed[r], readings.torque[r]
    if speed == check.speed[k] and torque == check.torque[k]:
        return
    check.speed[k], check.torque[k] = speed, torque
    check.changed_ns[k] = readings.t_ns[r]
    check.own[k], check.command[k] = own, slow.command[k]
    for j in range(measured.shape[0]):
        check.others[k, j] = measured[j]


@inlined
def _own_speed(k: int, filters: Columns, told: Told, limits: PlausibilityLimits) -> float:
    """Rotor speed by the currents, rad/s; NaN where it is not known."""
    if told.health[k] != _TRACKING:
        return math.nan
    return float(filters.x[k, _W_E] / limits.pole_pairs[k])


@inlined
def _electrical_speed(k: int, measured: Array, chords: Columns, pole_pairs: Array) -> float:
    """By `Motion`, else by the flux chords; 0 where neither knows."""
    if not math.isnan(measured[k]):
        return float(pole_pairs[k] * measured[k])
    return float(chords.w[k]) if chords.ready[k] else 0.0


@lean
def check_values(
    samples: Samples, sample_ns: Ints, readings: Readings, count: int, measured: Array,
    slow: SlowState, now: int, chords: Columns, filters: Columns, told: Told,
    motion: Memory, check: Plausibility, limits: PlausibilityLimits,
) -> None:  # fmt: skip
    """A tick's samples and the first `count` readings; sets `check.until_ns`.

    Filters begin anew where the input was implausible.
    sample_ns (N,): stamp of each drive's newest sample; measured (N,): rotor speed of fresh
    `Motion`, rad/s, NaN without; told: of the filters, before `merge_motion`; motion: after the
    same readings. Never raises on numbers.
    """
    for i in range(samples.drive.shape[0]):
        k = samples.drive[i]
        passed = (samples.steps[i] + samples.gap[i]) * limits.dt_s
        w_e = _electrical_speed(k, measured, chords, limits.pole_pairs)
        _add_sample(
            k, samples.y[i, 0], samples.y[i, 1], passed, w_e, now, check, limits.least_moved_a[k]
        )
    for r in range(count):
        k = readings.drive[r]
        _check_reading(
            r, now, samples, sample_ns[k], readings, told.health[k], filters, told.flux[k],
            check, limits,
        )  # fmt: skip
        own = _own_speed(k, filters, told, limits)
        _note_motion(r, readings, measured, slow, own, check)
        held = _motion_held(k, now, measured, slow, own, check, limits.rated_nm[k])
        _count(held, 0, _IN_A_ROW, check.motion_held, k, now, check)
        load = told.load[k] if told.health[k] == _TRACKING else math.nan
        off = _load_off(k, load, motion, limits.settled_readings, limits.rated_nm[k])
        _count(off, 0, _LOADS_IN_A_ROW, check.load_off, k, now, check)
    for k in range(measured.shape[0]):
        if check.motion_held[k] >= _IN_A_ROW:
            measured[k] = math.nan
        if check.restart[k] and now + _RESTART_NS >= check.until_ns[k]:
            # What the filter has learnt meanwhile is of no use.
            _reset(filters.ctypes.data + int(k) * _FILTER)
            filters.v_q_bias[k] = 0.0
            told.flux[k] = math.nan
            check.restart[k] = now < check.until_ns[k]
