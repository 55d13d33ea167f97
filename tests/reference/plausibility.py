"""Currents against Motion in Python, which `gateway/core/plausibility.c` is compared with."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.frame import MS, SECOND, Nanos
from dbc.records import Columns, Records
from tests.columns import SlowState, Told
from tests.reference.motion import Memory
from tests.sample_rows import Readings, Samples

HISTORY: Final = 8
"""Samples of a CAN FD frame."""
REPEATS: Final = 2
"""Repeated vectors in a row that are no single late sample."""
HELD_NS: Final[Nanos] = 200 * MS
LATE_NS: Final[Nanos] = SECOND
"""How long an input stays implausible after the last sign."""
RESTART_NS: Final[Nanos] = 20 * MS
"""So long before the end of that the filter begins anew."""
DOUBT_NS: Final[Nanos] = 15 * MS
"""After a single reading that does not fit: no loss is raised before the next one."""
IN_A_ROW: Final = 3
"""Readings in a row that do not fit, and the input is implausible for `HELD_NS`."""
LEAST_CURRENT: Final = 0.15
LEAST_TORQUE: Final = 0.1
MOST_CURRENT_A: Final = 1e5
"""Per unit of rated; with less, torque and angle say nothing."""
TORQUE_OFF: Final = 0.15
TORQUE_OFF_RELATIVE: Final = 0.3
"""Largest difference of two torques, per unit of rated, and of the reported one: magnets may be a
fifth off the data sheet."""
TORQUE_DOUBT: Final = 0.06
TORQUE_DOUBT_RELATIVE: Final = 0.15
"""From here on currents are no evidence of a loss."""
LOAD_OFF: Final = 0.25
LOAD_OFF_RELATIVE: Final = 0.3
FOLLOWS_NIS: Final = 9.0
LOADS_IN_A_ROW: Final = 4
"""The same of two loads; filter and observer follow a loss unlike for up to three readings."""
STEADY_CYCLES: Final = 2.5
ANGLE_OFF: Final = 0.06
ANGLE_OFF_SAMPLES: Final = 0.3
"""Largest step of the angle, rad, and in turns of a sample period, at least of 0.5 ms: stamps
jitter, and more by as much as a frame of `Motion` is off the grid of its cycle."""
MOST_TURN: Final = 0.63
"""Turn between two samples, rad, beyond which nothing rests on the currents: ten a revolution."""
OWN_TURN: Final = 2.5
"""The same of a rotor that a filter can track."""
LEAST_PERIOD_S: Final = 0.5e-3
LEARN: Final = 20
"""Readings before the constant part of the angle is known."""
KEEP: Final = 0.98
"""Of what is learnt, per reading of 10 ms: half a second."""
COHERENT: Final = 0.95
"""Length of the mean of unit vectors, below which angle and current have nothing to do with one
another: another frame, another direction."""
LEARN_ANEW_NS: Final[Nanos] = 60 * SECOND
"""An angle that has been off for so long is the drive's new one."""
ANGLE_GAP_NS: Final[Nanos] = 100 * MS
"""After so long without a reading the angle of late is that of the next one."""
MOTION_HELD_NS: Final[Nanos] = 100 * MS
SPEED_MOVED: Final = 0.03
SPEED_MOVED_RAD_S: Final = 1.0
COMMAND_MOVED: Final = 0.15
"""What others must have changed by: a rotor's speed, or the command per unit of rated torque."""
OWN_SIGMAS: Final = 4.0
"""Least difference of the speed by the currents from that of `Motion`, in its own deviations."""


Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

_TRACKING = 2  # Health
_W_E, _THETA = 2, 3  # pmsm
_OBSERVED_LOAD, _NIS = 1, 6  # LoadState


class Plausibility(NamedTuple):
    """Memory of N drives.

    vector (N, 8, 2): the last currents, A, a ring; samples (N,): how many there were; equal,
    equal_s (N,): repeated vectors in a row, and for how long; block (N,): samples in a row that are
    those of eight before; until_ns (N,): implausible until then; restart (N,): the filter has to
    begin anew after it; doubt_ns (N,): until then nobody is accused by the currents; base (N,):
    learnt angle as a mean unit vector, from learnt (N,) readings; deviation (N,) rad: of late, at
    angle_ns (N,); off, torque_off, excess, load_off, motion_held (N,): readings in a row that do
    not fit; off_ns (N,): since when the angle does not.

    Of `Motion`: speed, torque (N,) as last sent, changed_ns (N,) when they last changed, and what
    was so then: command (N,), others (N, N) speeds.
    """

    vector: Array
    samples: Ints
    equal: Ints
    equal_s: Array
    block: Ints
    until_ns: Ints
    restart: Flags
    doubt_ns: Ints
    base: NDArray[np.complex128]
    learnt: Ints
    deviation: Array
    off: Ints
    torque_off: Ints
    excess: Ints
    load_off: Ints
    motion_held: Ints
    off_ns: Ints
    angle_ns: Ints
    speed: Array
    torque: Array
    changed_ns: Ints
    command: Array
    others: Array


class PlausibilityLimits(NamedTuple):
    """Constants of N drives, (N,), and dt_s: the sub-step.

    k_torque: Nm per A at the data sheet's flux; least_moved_a: see `LEAST_STEPS`; current_var: A^2,
    of a current as configured; period_s: between two current samples; motion_ns: between two
    `Motion`.
    """

    pole_pairs: Array
    k_torque: Array
    rated_a: Array
    rated_nm: Array
    least_moved_a: Array
    current_var: Array
    period_s: float
    dt_s: float
    motion_ns: int
    settled_readings: int


def start(n: int, doubt_ns: Ints) -> Plausibility:
    """Nothing received. doubt_ns (N,): where doubts are noted, for who judges."""

    def none() -> Array:
        return np.full(n, np.nan)

    def zero() -> Ints:
        return np.zeros(n, dtype=np.int64)

    return Plausibility(
        vector=np.zeros((n, HISTORY, 2)), samples=zero(), equal=zero(), equal_s=np.zeros(n),
        block=zero(), until_ns=zero(), restart=np.zeros(n, dtype=np.bool_),
        doubt_ns=doubt_ns,
        base=np.zeros(n, dtype=np.complex128), learnt=zero(),
        deviation=np.zeros(n), off=zero(), torque_off=zero(), excess=zero(), load_off=zero(),
        motion_held=zero(), off_ns=zero(), angle_ns=zero(), speed=none(),
        torque=none(), changed_ns=zero(), command=none(),
        others=np.full((n, n), np.nan),
    )  # fmt: skip


def forget(k: int, filters: Columns) -> None:
    """No filter of drive k."""
    filters.active[k], filters.steps[k] = False, 0
    filters.x[k], filters.P[k] = 0.0, np.eye(5)


def _until(k: int, now: int, hold_ns: int, check: Plausibility) -> None:
    check.until_ns[k] = max(check.until_ns[k], now + hold_ns)
    check.restart[k] = check.restart[k] or hold_ns >= HELD_NS


def _same(k: int, place: int, a: float, b: float, check: Plausibility) -> bool:
    return bool(a == check.vector[k, place, 0] and b == check.vector[k, place, 1])


def _add_sample(
    k: int, a: float, b: float, passed: float, w_e: float, now: int, check: Plausibility,
    least: float, least_of_block: float,
) -> None:  # fmt: skip
    """One more current vector of drive k, `passed` s after the one before; w_e rad/s."""
    n, size = check.samples[k], math.hypot(a, b)
    newest, oldest = (n + HISTORY - 1) % HISTORY, n % HISTORY
    if n > 0 and _same(k, newest, a, b, check):
        check.equal[k] += 1
        check.equal_s[k] += passed
        turned = min(abs(w_e) * check.equal_s[k], math.pi)
        if 2.0 * size * math.sin(0.5 * turned) > least:
            _until(k, now, HELD_NS if check.equal[k] >= REPEATS else LATE_NS, check)
    else:
        check.equal[k] = 0
        check.equal_s[k] = 0.0
    if n >= HISTORY and _same(k, oldest, a, b, check):
        check.block[k] += 1
        turned = abs(w_e) * passed * HISTORY
        if check.block[k] >= HISTORY and 2.0 * size * abs(math.sin(0.5 * turned)) > least_of_block:
            _until(k, now, LATE_NS, check)
    else:
        check.block[k] = 0
    check.vector[k, oldest, 0] = a
    check.vector[k, oldest, 1] = b
    check.samples[k] = n + 1 if n < 1 << 40 else n + 1 - (1 << 39)


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


def _torque_off(
    k: int, apart: float, reported: float, rated: float, now: int, check: Plausibility
) -> bool:
    """Whether two torques are further apart than motor data explain; notes a lesser doubt."""
    if apart > TORQUE_DOUBT * rated + TORQUE_DOUBT_RELATIVE * abs(reported):
        check.doubt_ns[k] = now + DOUBT_NS
    return bool(apart > TORQUE_OFF * rated + TORQUE_OFF_RELATIVE * abs(reported))


def _angle_off(
    k: int, turned: complex, w_e: float, t_ns: int, usual_ns: int, right: bool,
    check: Plausibility, limits: PlausibilityLimits,
) -> bool:  # fmt: skip
    """Whether the current's angle has left its learnt place; learns it where it has not.

    turned: unit vector of the current in the rotor's frame, in the torque's direction; usual_ns:
    how late samples come as a rule, and so perhaps the angle; right: nothing speaks against it, so
    that it may be learnt from.
    """
    if check.learnt[k] < LEARN:
        if right:
            check.learnt[k] += 1
            check.base[k] += (turned - check.base[k]) / check.learnt[k]
        return False
    if abs(check.base[k]) < COHERENT:
        check.learnt[k] = 0
        check.base[k] = 0.0
        return False
    apart = turned * check.base[k].conjugate()
    passed = t_ns - check.angle_ns[k]
    follows = 0.5 if passed <= ANGLE_GAP_NS else 1.0
    check.angle_ns[k] = t_ns
    # A frame that waited for the bus is stamped when it came, and so is off the grid of its cycle.
    cycle = limits.motion_ns
    waited_s = abs(passed - (passed + cycle // 2) // cycle * cycle) * 1e-9 + usual_ns * 1e-9
    angle = math.atan2(apart.imag, apart.real)
    angle -= min(max(angle, -abs(w_e) * waited_s), abs(w_e) * waited_s)
    before = check.deviation[k]
    check.deviation[k] = before + 0.5 * (angle - before) if follows < 1.0 else angle
    most = ANGLE_OFF + ANGLE_OFF_SAMPLES * abs(w_e) * max(limits.period_s, LEAST_PERIOD_S)
    if abs(check.deviation[k]) <= most:
        check.off_ns[k] = t_ns
        if right:
            check.base[k] += (1.0 - KEEP) * (turned - check.base[k])
        return False
    if t_ns - check.off_ns[k] > LEARN_ANEW_NS:
        check.learnt[k] = 0
        check.base[k] = 0.0
    return True


def _count(
    off: bool, first_ns: int, most: int, counts: Ints, k: int, now: int, check: Plausibility
) -> None:
    """first_ns: for how long a reading before `most` in a row keeps the currents from accusing."""
    counts[k] = counts[k] + 1 if off else 0
    if counts[k] >= most:
        _until(k, now, HELD_NS, check)
    elif off:
        check.doubt_ns[k] = max(check.doubt_ns[k], now + first_ns)


def _load_off(k: int, load: float, motion: Memory, settled: int, rated: float) -> bool:
    """Whether the load by the currents is another than that by `Motion`. NaN is not.

    An innovation of more than three standard deviations: the observer still follows a change.
    """
    follows = motion.observer[k, _NIS] > FOLLOWS_NIS
    if not motion.begun[k] or motion.readings[k] < settled or follows:
        return False
    observed = motion.observer[k, _OBSERVED_LOAD]
    return bool(abs(load - observed) > LOAD_OFF * rated + LOAD_OFF_RELATIVE * abs(observed))


def _check_reading(
    r: int, now: int, samples: Samples, drives: Records, readings: Readings, health: int,
    filters: Columns, flux: float, check: Plausibility, limits: PlausibilityLimits,
) -> None:  # fmt: skip
    """Currents against torque and angle as measured at the same instant."""
    k, torque, angle = readings.drive[r], readings.torque[r], readings.angle[r]
    clock = drives["clock"][k]
    newest_ns = drives["sample_ns"][k] - clock["late_ns"]
    row, later = _nearest(k, readings.t_ns[r], newest_ns, samples, limits.dt_s)
    w_e = limits.pole_pairs[k] * readings.speed[r]
    if row < 0 or abs(later) > 1.5 * limits.period_s:
        return
    if abs(w_e) * limits.period_s > MOST_TURN:
        most = np.hypot(*samples.y[samples.drive == k].T).max()
        k_most = abs(limits.k_torque[k] * (1.0 if math.isnan(flux) else flux)) * most
        beyond = abs(torque) - k_most
        off = beyond > TORQUE_OFF * limits.rated_nm[k] + TORQUE_OFF_RELATIVE * abs(torque)
        _count(bool(off), DOUBT_NS, IN_A_ROW, check.excess, k, now, check)
        return
    current = complex(samples.y[row, 0], samples.y[row, 1])
    size = abs(current)
    if not (size >= LEAST_CURRENT * limits.rated_a[k]) and not (
        abs(torque) >= LEAST_TORQUE * limits.rated_nm[k]
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
    if not math.isnan(angle) and size > 0.0 and abs(torque) >= LEAST_TORQUE * limits.rated_nm[k]:
        theta = angle + w_e * later
        turned = current * complex(math.cos(theta), -math.sin(theta))
        # Along q in the torque's direction is 1.
        unit = turned * complex(0.0, -sign) / size
        if check.learnt[k] >= LEARN:
            newest = angle + w_e * (newest_ns - readings.t_ns[r]) * 1e-9
            newest += math.atan2(check.base[k].imag, check.base[k].real)
            far = _torque_apart(k, torque, newest, w_e, k_torque, samples, limits.dt_s)
            off = _torque_off(k, far, torque, limits.rated_nm[k], now, check) or off
        # What is implausible is not learnt; a small current may have turned over since the torque.
        if LEAST_CURRENT * limits.rated_a[k] <= size < MOST_CURRENT_A:
            right = tracking and not off and now >= check.until_ns[k]
            apart = _angle_off(
                k, unit, w_e, readings.t_ns[r], clock["usual_ns"], right, check, limits
            )
            _count(apart, DOUBT_NS, IN_A_ROW, check.off, k, now, check)
    _count(off, DOUBT_NS, IN_A_ROW, check.torque_off, k, now, check)


def _moved(now: float, before: float) -> bool:
    """False where one of two speeds is not known."""
    return bool(abs(now - before) > max(SPEED_MOVED * abs(now), SPEED_MOVED_RAD_S))


def _motion_held(
    k: int, now: int, measured: Array, slow: SlowState, own: float, sigma: float,
    check: Plausibility, rated_nm: float,
) -> bool:  # fmt: skip
    """Whether `Motion` of drive k stands still while something that it must follow has changed."""
    if now - check.changed_ns[k] <= MOTION_HELD_NS or math.isnan(measured[k]):
        return False
    if _moved(own, measured[k]) and abs(own - measured[k]) > OWN_SIGMAS * sigma:
        return True
    if abs(slow.command[k] - check.command[k]) > COMMAND_MOVED * rated_nm and (
        now - slow.command_ns[k] > MOTION_HELD_NS
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


def _check_crawl(
    r: int, now: int, readings: Readings, motion: Memory, check: Plausibility,
    limits: PlausibilityLimits,
) -> None:  # fmt: skip
    """A reading of a crawling drive that repeats the ones before keeps it from being accused."""
    k = readings.drive[r]
    for_so_long = float(readings.t_ns[r] - check.changed_ns[k])
    if motion.crawls[k] and for_so_long > STEADY_CYCLES * limits.motion_ns:
        until = now + limits.motion_ns + limits.motion_ns // 2
        check.doubt_ns[k] = max(check.doubt_ns[k], until)


def _note_motion(
    r: int, readings: Readings, measured: Array, slow: SlowState, check: Plausibility
) -> None:
    """Whether `Motion` has changed, and what was so when it did."""
    k, speed, torque = readings.drive[r], readings.speed[r], readings.torque[r]
    if speed == check.speed[k] and torque == check.torque[k]:
        return
    check.speed[k], check.torque[k] = speed, torque
    check.changed_ns[k] = readings.t_ns[r]
    check.command[k] = slow.command[k]
    for j in range(measured.shape[0]):
        check.others[k, j] = measured[j]


def _tracks(k: int, measured: Array, told: Told, limits: PlausibilityLimits) -> bool:
    """Whether the filter tracks the rotor, and not an alias of it."""
    turn = abs(limits.pole_pairs[k] * measured[k]) * limits.period_s
    return bool(told.health[k] == _TRACKING and not turn > OWN_TURN)


def _own_speed(
    k: int, measured: Array, filters: Columns, told: Told, limits: PlausibilityLimits
) -> float:
    """Rotor speed by the currents, rad/s; NaN where it is not known, or may be an alias."""
    if not _tracks(k, measured, told, limits):
        return math.nan
    return float(filters.x[k, _W_E] / limits.pole_pairs[k])


def _electrical_speed(k: int, measured: Array, chords: Columns, pole_pairs: Array) -> float:
    """By `Motion`, else by the flux chords; 0 where neither knows."""
    if not math.isnan(measured[k]):
        return float(pole_pairs[k] * measured[k])
    return float(chords.w[k]) if chords.ready[k] else 0.0


def check_values(
    samples: Samples, drives: Records, readings: Readings, count: int, measured: Array,
    slow: SlowState, now: int, chords: Columns, filters: Columns, told: Told,
    motion: Memory, check: Plausibility, limits: PlausibilityLimits,
) -> None:  # fmt: skip
    """A tick's samples and the first `count` readings; sets `check.until_ns`.

    Filters begin anew where the input was implausible.
    drives (N,) of `struct drive_input`; measured (N,): rotor speed of fresh
    `Motion`, rad/s, NaN without; told: of the filters, before `merge_motion`; motion: after the
    same readings. Never raises on numbers.
    """
    for i in range(samples.drive.shape[0]):
        k = samples.drive[i]
        passed = (samples.steps[i] + samples.gap[i]) * limits.dt_s
        w_e = _electrical_speed(k, measured, chords, limits.pole_pairs)
        # Six standard deviations of a difference of two samples, at most 5 % of rated current.
        noise = 6.0 * math.hypot(*[math.sqrt(limits.current_var[k] * filters.r_scale[k])] * 2)
        of_block = limits.least_moved_a[k]
        least = max(of_block, min(noise, 0.05 * limits.rated_a[k]))
        _add_sample(k, samples.y[i, 0], samples.y[i, 1], passed, w_e, now, check, least, of_block)
    for r in range(count):
        k = readings.drive[r]
        _check_reading(
            r, now, samples, drives, readings, told.health[k], filters, told.flux[k],
            check, limits,
        )  # fmt: skip
        own = _own_speed(k, measured, filters, told, limits)
        _note_motion(r, readings, measured, slow, check)
        sigma = math.sqrt(filters.P[k, _W_E, _W_E]) / limits.pole_pairs[k]
        _check_crawl(r, now, readings, motion, check, limits)
        held = _motion_held(k, now, measured, slow, own, sigma, check, limits.rated_nm[k])
        _count(held, 0, IN_A_ROW, check.motion_held, k, now, check)
        load = told.load[k] if _tracks(k, measured, told, limits) else math.nan
        off = _load_off(k, load, motion, limits.settled_readings, limits.rated_nm[k])
        _count(off, 0, LOADS_IN_A_ROW, check.load_off, k, now, check)
    for k in range(measured.shape[0]):
        if check.motion_held[k] >= IN_A_ROW:
            measured[k] = math.nan
        if check.restart[k] and now + RESTART_NS >= check.until_ns[k]:
            # What the filter has learnt meanwhile is of no use.
            forget(k, filters)
            filters.v_q_bias[k] = 0.0
            told.flux[k] = math.nan
            check.restart[k] = now < check.until_ns[k]
