"""Check whether measured signals fit a motor's parameters: units, signs, phases, flux.

Complex numbers are alpha + j beta, as amplitudes. Nothing here needs a filter or a filter's
thresholds: each finding is a ratio of two measured quantities.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbc.arrays import Array
from gateway.settings.motors import Motor

SLOW: Final = (0.3, 1.5)
"""Largest electrical angle between two samples, rad, that shows the sense of rotation; tried in
this order: the first one allows for a speed that is ten times too small."""
CLOSEST_S: Final = 1e-3
LEAST: Final = 30
"""Fewest samples for a ratio."""
LEAST_STATUS: Final = 3
"""Fewest RMS currents for a ratio."""
LEAST_CURRENT: Final = 0.1
"""Share of the rated current; below it, noise turns the current vector too."""
FAST: Final = 0.3
"""Share of the highest speed; above it, the voltages show the flux."""
SUM: Final = 0.2
"""Largest sum of three phases, as a share of the amplitude."""
SCATTER: Final = 0.3
"""Largest median distance from a median, as a share of it; beyond it, the samples disagree."""
APART: Final = 0.4
"""Largest part of the measured torque that the computed one does not explain (RMS, as a share)."""
WITHIN: Final = {"turns": 0.04, "flux": 0.2, "torque": 0.3, "rms": 0.15}
"""Largest distance of each ratio from 1."""
_NAMED: Final = (
    (2.0, "twice"), (0.5, "half"), (10.0, "ten times"), (0.1, "a tenth"),
    (9.549, "rpm instead of rad/s"), (0.10472, "rad/s instead of rpm"),
    (60.0, "1/s instead of rpm"), (1 / 60.0, "rpm instead of 1/s"),
    (1000.0, "a thousand times"), (0.001, "a thousandth"),
    (math.sqrt(3.0), "line to line instead of phase"),
    (1 / math.sqrt(3.0), "phase instead of line to line"),
    (math.sqrt(2.0), "amplitude instead of RMS"), (math.sqrt(0.5), "RMS instead of amplitude"),
    (math.sqrt(1.5), "power-invariant instead of amplitude-invariant"),
    (math.sqrt(1 / 1.5), "amplitude-invariant instead of power-invariant"),
)  # fmt: skip
_NAME_WITHIN: Final = 0.06


class Measured(NamedTuple):
    """Signals of one drive, SI; an array is empty where the drive does not send the signal.

    t, current (L,); phase_sum (L,): sum of the phases where three are measured, NaN where one is
    missing; voltage (L,), NaN where there is none at that sample; motion_t, speed, torque (M,):
    rad/s of the rotor, Nm; status_t, irms (K,).
    """

    t: Array
    current: NDArray[np.complex128]
    phase_sum: Array
    voltage: NDArray[np.complex128]
    motion_t: Array
    speed: Array
    torque: Array
    status_t: Array
    irms: Array


class Finding(NamedTuple):
    """Result of one comparison; `fits` is None where nothing can be compared."""

    fits: bool | None
    text: str


def findings(data: Measured, motor: Motor) -> list[Finding]:
    """Results of all comparisons that these signals allow.

    At most one for each of: sum of the phases, RMS current, sense of rotation, pole pairs, flux,
    torque.
    """
    if len(data.t) < LEAST:
        return [Finding(None, f"{len(data.t)} samples of current: nothing can be compared")]
    turns = None
    if len(data.speed) >= LEAST:
        turns = _turns(data.t, data.current, data, motor, LEAST_CURRENT * motor.I_rated)
    # An error of pole pairs or speed is corrected here, so that only one finding reports it.
    scale = 1.0 if turns is None else abs(turns)
    return [
        *_sum(data, motor),
        *_rms(data, motor),
        *_rotation(data, motor, turns),
        *_flux(data, motor, scale),
    ]


def named(ratio: float) -> str:
    """Text of a ratio, with the mistake that usually causes it, if there is one."""
    size = abs(ratio)
    k, word = min(_NAMED, key=lambda one: abs(size / one[0] - 1.0))
    word = word if abs(size / k - 1.0) < _NAME_WITHIN else ""
    sign = ", with the other sign," if ratio < 0 else ""
    return f"{size:.3g} times{f' ({word})' if word else ''}{sign}"


def _sum(data: Measured, motor: Motor) -> Iterator[Finding]:
    if not len(data.phase_sum):
        return
    size = np.abs(data.current)
    big = size > max(0.3 * float(size.max()), LEAST_CURRENT * motor.I_rated)
    big &= np.isfinite(data.phase_sum)
    if np.count_nonzero(big) < LEAST:
        yield Finding(
            None, "the sum of the phases cannot be checked: the current stays below 0.1 I_rated"
        )
        return
    share = float(np.median(np.abs(data.phase_sum[big]) / np.abs(data.current[big])))
    yield Finding(
        share <= SUM,
        f"phase currents add up to {100 * share:.0f} % of their amplitude"
        + ("" if share <= SUM else ": one of them is a wrong signal, or has a wrong scale"),
    )


def _rms(data: Measured, motor: Motor) -> Iterator[Finding]:
    amplitude = np.sqrt(np.interp(data.status_t, data.t, _smooth(np.abs(data.current) ** 2)))
    big = amplitude > LEAST_CURRENT * motor.I_rated
    if np.count_nonzero(big) < LEAST_STATUS:
        return
    ratio = _slope(amplitude[big] / math.sqrt(2.0), data.irms[big])
    fits = abs(ratio - 1.0) <= WITHIN["rms"]
    yield Finding(fits, f"RMS current: {named(ratio)} that of the phase currents")


def _smooth(values: Array) -> Array:
    """Mean over 50 samples."""
    width = min(50, len(values))
    return np.convolve(values, np.ones(width) / width, mode="same")


def _slope(x: Array, y: Array) -> float:
    """Slope of y over x by least squares without an offset; x must not be zero throughout."""
    return float(np.dot(x, y) / np.dot(x, x))


def _rotation(data: Measured, motor: Motor, turns: float | None) -> Iterator[Finding]:
    """Compare sense of rotation and pole pairs of currents and voltages with the measured speed."""
    if len(data.speed) < LEAST:
        yield Finding(None, "no measured speed: sense of rotation and pole pairs cannot be checked")
        return
    if turns is None:
        yield Finding(
            None,
            "sense of rotation and pole pairs cannot be checked: nowhere in the log do current and "
            "measured speed agree at a speed low enough for the sampling rate",
        )
        return
    volts = np.abs(data.voltage[np.isfinite(data.voltage)])
    by_voltage = None
    if len(volts):
        by_voltage = _turns(data.t, data.voltage, data, motor, 0.1 * float(volts.max()))
    if turns < 0:
        if by_voltage is not None and by_voltage > 0:
            yield Finding(False, "the currents turn against speed and voltages: two phases are "
                          "swapped, or Iq has the other sign")  # fmt: skip
        else:
            yield Finding(False, "currents turn against the speed: Speed has the other sign "
                          "(scale = -1, for Torque and TorqueCommand, too), or two phases of "
                          "currents and voltages are swapped")  # fmt: skip
    elif by_voltage is not None and by_voltage < 0:
        yield Finding(False, "the voltages turn against speed and currents: Ubeta or Uq has the "
                      "other sign")  # fmt: skip
    ratio = abs(turns)
    fits = abs(ratio - 1.0) <= WITHIN["turns"]
    text = f"pole pairs: {ratio * motor.pole_pairs:.3g} by currents and speed, "
    if fits:
        yield Finding(True, f"{text}as configured")
        return
    yield Finding(
        False,
        f"{text}the configuration says {motor.pole_pairs}: correct pole_pairs (half the number of "
        f"poles), or the scale of Speed, which then is {named(1.0 / ratio)} what it should be",
    )


def _turns(
    t: Array, vector: NDArray[np.complex128], data: Measured, motor: Motor, least: float
) -> float | None:
    """Median of a vector's speed over p times the rotor's speed.

    None where the log does not show it: too few samples, or samples that do not agree.
    """
    closest = float(np.median(np.diff(t)))
    if closest <= 0.0:
        return None
    # Between samples closer than CLOSEST_S, noise would turn the angle more than rotation does.
    stride = max(1, round(CLOSEST_S / closest))
    t, vector = t[::stride], vector[::stride]
    dt = np.diff(t)
    usual = float(np.median(dt))
    step = np.angle(vector[1:] * np.conj(vector[:-1]))
    speed = np.interp(0.5 * (t[1:] + t[:-1]), data.motion_t, data.speed)
    expected = motor.pole_pairs * speed * dt
    there = (np.abs(vector[1:]) > least) & (np.abs(vector[:-1]) > least) & (dt < 1.5 * usual)
    there &= np.abs(expected) > 0.02
    for most in SLOW:
        used = there & (np.abs(expected) < most)
        if np.count_nonzero(used) >= LEAST:
            return _agreed(step[used] / expected[used])
    return None


def _agreed(ratios: Array) -> float | None:
    """Median of the ratios; None where they scatter."""
    middle = float(np.median(ratios))
    distance = float(np.median(np.abs(ratios - middle)))
    return middle if distance <= SCATTER * abs(middle) else None


def _flux(data: Measured, motor: Motor, scale: float) -> Iterator[Finding]:
    """Compare the flux linkage, from the voltages less R i + jwL i, and the torque it makes.

    scale: electrical speed over the one that follows from the configuration.
    """
    usable = np.isfinite(data.voltage)
    if len(data.speed) < LEAST or np.count_nonzero(usable) < LEAST:
        return
    t, current, voltage = data.t[usable], data.current[usable], data.voltage[usable]
    speed = np.interp(t, data.motion_t, data.speed)
    w = scale * motor.pole_pairs * speed
    fast = np.abs(w) > max(FAST * float(np.abs(w).max()), 20.0)
    if np.count_nonzero(fast) < LEAST:
        text = "flux linkage cannot be checked: the speed is too low throughout the log"
        yield Finding(None, text)
        return
    dt = float(np.median(np.diff(data.t)))
    # The voltage is the mean since the previous sample.
    half = 0.5 * dt * w
    u = voltage * np.exp(1j * half) / np.sinc(half / np.pi)
    emf = u - (motor.R_s + 1j * w * motor.L_s) * current
    linkage = _agreed(np.abs(emf[fast]) / np.abs(w[fast]))
    if linkage is None:
        yield Finding(None, "flux linkage cannot be checked: voltages and speed disagree")
        return
    ratio = linkage / motor.psi_pm
    fits = abs(ratio - 1.0) <= WITHIN["flux"]
    text = f"flux linkage: {ratio * motor.psi_pm:.3g} Wb by voltages and speed, "
    yield Finding(
        fits,
        f"{text}as configured"
        if fits
        else f"{text}{named(ratio)} the configured {motor.psi_pm:g}: correct psi_pm or "
        "L_s, or the scale of the voltages, or of Speed",
    )
    power = 1.5 * np.real(current * np.conj(emf))[fast]
    yield from _torque(data, motor, t[fast], power, scale)


def _torque(
    data: Measured, motor: Motor, t: Array, power: Array, scale: float
) -> Iterator[Finding]:
    """Compare the measured torque with the torque from `power`, the air-gap power in W.

    scale: as in `_flux`. If it is not 1, pole pairs or speed are wrong; the torque shows which.
    """
    known = np.isfinite(data.torque)
    if np.count_nonzero(known) < LEAST:
        return
    speed = np.interp(t, data.motion_t, data.speed)
    torque = np.interp(t, data.motion_t[known], data.torque[known])
    made = power / speed
    if float(np.abs(made).max()) < 0.1 * motor.T_rated:
        yield Finding(None, "torque cannot be checked: the torque stays below 0.1 T_rated")
        return
    ratio = _slope(made, torque)
    if np.linalg.norm(torque - ratio * made) > APART * np.linalg.norm(torque):
        yield Finding(None, "torque cannot be checked: it does not follow currents and voltages")
        return
    fits = abs(ratio - 1.0) <= WITHIN["torque"]
    text = f"torque: {named(ratio)} that of currents, voltages and speed"
    if abs(scale - 1.0) > WITHIN["turns"]:
        if abs(scale * ratio - 1.0) <= WITHIN["torque"]:
            fits, text = True, f"{text}, because Speed is wrong, not pole_pairs"
        elif fits:
            text = f"{text}, so pole_pairs is wrong, not Speed"
    yield Finding(
        fits,
        text if fits else f"{text}: correct R_s, or sign or scale of Torque or of the currents",
    )


def joined(
    t: Array, other_t: Array, values: NDArray[np.complex128], within: float
) -> NDArray[np.complex128]:
    """For each t the value nearest in time; NaN where none is closer than `within` seconds."""
    out = np.full(len(t), complex(math.nan, math.nan))
    if not len(other_t):
        return out
    at = np.clip(np.searchsorted(other_t, t), 1, max(len(other_t) - 1, 1))
    before, after = at - 1, np.minimum(at, len(other_t) - 1)
    nearer = np.where(t - other_t[before] <= other_t[after] - t, before, after)
    good = np.abs(other_t[nearer] - t) <= within
    out[good] = values[nearer[good]]
    return out


def space_vector(ia: Array, ib: Array) -> NDArray[np.complex128]:
    """Space vector from two of three phases without a neutral."""
    return ia + 1j * (ia + 2.0 * ib) / math.sqrt(3.0)
