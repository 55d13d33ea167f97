"""`estimators/adaptation.c` by its laws: logarithms of the scale, Python's own exponential."""

import math

SETTLED = 480
"""Sub-steps of a new filter before the voltage is learnt."""


def between(x, low, high):
    """NaN stays NaN."""
    return x if math.isnan(x) else min(max(x, low), high)


def scale(now, nis, dt, age):
    """Factor on R after an innovation with this NIS, `dt` seconds after the last one."""
    share = min(dt / min(max(age / 4, 0.03), 0.5), 1.0)
    grown = math.log(now) + share * (min(nis, 8.0) - 2.0) / 2.0
    return math.exp(between(grown, 0.0, math.log(400.0)))


def voltage_limit(w, motor, rated_a):
    """Largest missing voltage: 30 % of the drop over R_s, 20 % of the induced voltage."""
    R_s, _, psi_f = motor[:3]
    return 0.3 * R_s * rated_a + 0.2 * psi_f * abs(w)


def voltage(now, excess, psi_f, dt, age):
    """Missing voltage along q, not limited; `excess` of the filter's speed over the chords'."""
    return now + psi_f * excess * dt / min(max(age, 0.15), 0.5)


def adapt(samples, filters, chords, motors, rated_a, dt):
    """Adapt the filters to the innovations of these samples, one by one."""
    for sample in samples:
        k = int(sample.drive)
        one, chord = filters[k], chords[k]
        if not one.active:
            continue
        one.steps += sample.steps
        passed, age = float(sample.steps) * dt, float(one.steps) * dt
        if math.isfinite(sample.nis):
            one.nis = 0.8 * one.nis + 0.2 * sample.nis
            one.r_scale = scale(float(one.r_scale), float(sample.nis), passed, age)
        if one.steps >= SETTLED and chord.ready:
            w, psi_f = float(one.x[2]), float(motors[k][2])
            limit = voltage_limit(w, motors[k], rated_a[k])
            free = voltage(float(one.v_q_bias), w - float(chord.w), psi_f, passed, age)
            one.v_q_bias = between(free, -limit, limit)
