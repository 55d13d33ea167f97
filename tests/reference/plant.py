"""Drives and train of the simulator, number by number in Python: the oracle of `plant.c`.

State of one drive, columns of `x` (N, 10):
    0, 1  i_alpha, i_beta   A        4, 5  integrators of the current control, V (d, q)
    2     w_m               rad/s    6, 7  voltage of the next period, V (alpha, beta)
    3     theta_e           rad      8     integrator of the speed or slip control, Nm
                                     9     torque limiter, 0..1
Parameters of one drive, columns of `p` (N, 18):
    0 R_s  1 L_s  2 psi_pm  3 pole_pairs  4 J  5 B  6 k_p  7 T_max  8 T_cut
    9 share of the train's demand that falls to this drive  10 wheel diameter, 1 = nominal
    11 phase a open (0 or 1)  12 psi_pm that the drive's own control believes in
    13 most torque that the driver demands (the first drive's counts)
    14 creep that the drive's slip limiter allows (infinite: it has none), 15 the limiter's
    bandwidth rad/s, 16 rate of its integrator 1/s  17 torque of the friction brake Nm
Train, `train` (3,): speed at the rotor rad/s, integrator of the driver Nm, last demand Nm.

The columns are the fields of `struct sim_drive`, `struct sim_motor` and `struct sim_train`.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

DT: Final = 125e-6
"""Control period, s: voltages are constant over it."""
SPEED_FLOOR_M_S: Final = 0.5
"""Creep is sliding speed over train speed; the floor keeps it finite at standstill."""
CURRENT_BANDWIDTH: Final = 1200.0
SPEED_BANDWIDTH: Final = 120.0
CREEP_LIMIT: Final = 0.05
"""What a fast slip limiter allows; a wheel beyond it and beyond the curve's peak slides."""
CREEP_BAND_RAD_S: Final = 0.5
DRIVER_BANDWIDTH: Final = 1.0
CUT_PER_S: Final = 7.0
RESTORE_PER_S: Final = 0.7
DC_SOURCE_OHM: Final = 0.2

SHARE: Final = 9
WHEEL: Final = 10
PHASE_OPEN: Final = 11
EFFORT: Final = 13
CREEP_MAX: Final = 14
SLIP_BANDWIDTH: Final = 15
SLIP_RATE: Final = 16
BRAKE: Final = 17
PARAMETERS: Final = 18

OUT: Final = 10
I_ALPHA, I_BETA, U_ALPHA, U_BETA, U_DC, TORQUE, SPEED, ANGLE, LOAD, COMMAND = range(OUT)


def creep_torque(
    slide: float, v: float, load_nm: float, mu_0: float, a: float, b: float,
    k_a: float, k_s: float, k_c: float,
) -> float:  # fmt: skip
    """Torque on the rail, Nm, at sliding speed `slide` m/s; `load_nm` = wheel load x radius."""
    w = abs(slide)
    s = w / max(abs(v), SPEED_FLOOR_M_S)
    mu = mu_0 * ((1.0 - a) * math.exp(-b * w) + a)
    eps = k_c * s / mu
    x = k_a * eps
    torque = load_nm * (2.0 / math.pi) * mu * (x / (1.0 + x * x) + math.atan(k_s * eps))
    return torque if slide >= 0.0 else -torque


def rail_torque(
    w_m: float, v: float, radius: float, load_nm: float, curve: Array, limit: float
) -> float:
    """Creep torque, held within what an adhesion loss leaves (`limit`, Nm)."""
    torque = creep_torque(
        w_m * radius - v, v, load_nm, curve[0], curve[1], curve[2], curve[3], curve[4], curve[5]
    )
    return min(max(torque, -limit), limit)


def electric(
    i_a: float, i_b: float, w_m: float, theta: float, u_a: float, u_b: float, p: Array
) -> tuple[float, float, float]:
    """Derivatives of i_alpha, i_beta (A/s) and the air-gap torque (Nm).

    L_s di/dt = u - R_s i - psi_pm w_e [-sin theta, cos theta]
    T = k_p pp psi_pm (i_beta cos theta - i_alpha sin theta)

    With phase a open (star point isolated) i_alpha = i_a stays what it is, 0, and the voltage
    across b and c, which is u_beta, drives i_beta as ever.
    """
    sin = math.sin(theta)
    cos = math.cos(theta)
    w_e = p[3] * w_m
    d_a = (u_a - p[0] * i_a + p[2] * w_e * sin) / p[1] if p[PHASE_OPEN] == 0.0 else 0.0
    d_b = (u_b - p[0] * i_b - p[2] * w_e * cos) / p[1]
    torque = p[6] * p[3] * p[2] * (i_b * cos - i_a * sin)
    return d_a, d_b, torque


def integrate(
    x: Array, u_a: float, u_b: float, p: Array, h: float, steps: int, on_rail: bool,
    load: float, v: float, radius: float, load_nm: float, curve: Array, limit: float,
) -> None:  # fmt: skip
    """Runge-Kutta 4 of one drive over `steps` x `h` s at constant voltage; `x` in place.

    `on_rail`: the load is the creep torque at the wheel's own speed; else it is `load`. The
    friction brake opposes the rotation: it stops the wheel, never turns it, and holds it while
    motor and rail together have no more torque than the brake.
    """
    brake = p[BRAKE]
    if p[PHASE_OPEN] != 0.0:
        x[0] = 0.0
    for _ in range(steps):
        i_a, i_b, w_m, theta = x[0], x[1], x[2], x[3]
        s_a = s_b = s_w = s_t = 0.0
        g_a = g_b = g_w = g_t = 0.0
        friction = 0.0
        locked = False
        if brake > 0.0:
            turns = w_m
            if w_m == 0.0:
                turns = electric(i_a, i_b, w_m, theta, u_a, u_b, p)[2]
                turns -= rail_torque(w_m, v, radius, load_nm, curve, limit)
                locked = abs(turns) <= brake
            friction = math.copysign(brake, turns)
        for stage in range(4):
            k = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
            y_a = i_a + k * h * g_a
            y_b = i_b + k * h * g_b
            y_w = w_m + k * h * g_w
            y_t = theta + k * h * g_t
            g_a, g_b, torque = electric(y_a, y_b, y_w, y_t, u_a, u_b, p)
            t_l = rail_torque(y_w, v, radius, load_nm, curve, limit) if on_rail else load
            g_w = (torque - t_l - friction - p[5] * y_w) / p[4]
            g_t = p[3] * y_w
            weight = 1.0 if stage in (0, 3) else 2.0
            s_a += weight * g_a
            s_b += weight * g_b
            s_w += weight * g_w
            s_t += weight * g_t
        x[0] = i_a + h / 6.0 * s_a
        x[1] = i_b + h / 6.0 * s_b
        x[2] = w_m + h / 6.0 * s_w
        x[3] = theta + h / 6.0 * s_t
        if brake > 0.0 and (locked or w_m * x[2] < 0.0):
            x[2] = 0.0
            x[3] = theta
    turn = 2.0 * math.pi
    x[3] -= turn * math.floor(x[3] / turn)


def current_control(x: Array, torque_ref: float, u_max: float, p: Array) -> None:
    """Field-oriented PI control with decoupling; the result acts in the next period.

    Voltage beyond `u_max` is scaled back and the integrators hold (no wind-up).
    """
    sin = math.sin(x[3])
    cos = math.cos(x[3])
    w_e = p[3] * x[2]
    i_d = x[0] * cos + x[1] * sin
    i_q = x[1] * cos - x[0] * sin
    e_d = -i_d
    e_q = torque_ref / (p[6] * p[3] * p[12]) - i_q
    gain = CURRENT_BANDWIDTH * p[1]
    u_d = gain * e_d + x[4] - w_e * p[1] * i_q
    u_q = gain * e_q + x[5] + w_e * (p[1] * i_d + p[2])
    size = np.hypot(u_d, u_q)  # libm's, as in C
    if size > u_max:
        u_d *= u_max / size
        u_q *= u_max / size
    else:
        x[4] += CURRENT_BANDWIDTH * p[0] * e_d * DT
        x[5] += CURRENT_BANDWIDTH * p[0] * e_q * DT
    # Computed now, applied one period later: turn to that period's middle.
    ahead = x[3] + 1.5 * w_e * DT
    x[6] = u_d * math.cos(ahead) - u_q * math.sin(ahead)
    x[7] = u_d * math.sin(ahead) + u_q * math.cos(ahead)


def slip_limit(x: Array, command: float, w_train: float, p: Array) -> float:
    """Torque reference, Nm: the command unless the wheel leaves the creep band (backstop).

    Only what is commanded can be limited: a motor that coasts does not act on a wheel that slides.
    """
    if command == 0.0:
        x[8] = 0.0
    if command == 0.0 or math.isinf(p[CREEP_MAX]):
        return command
    band = max(p[CREEP_MAX] * abs(w_train), CREEP_BAND_RAD_S)
    gain = p[SLIP_BANDWIDTH] * p[4]
    error = (w_train + band - x[2]) if command >= 0.0 else (w_train - band - x[2])
    x[8] += p[SLIP_RATE] * gain * error * DT
    x[8] = min(max(x[8], min(0.0, command)), max(0.0, command))
    wanted = gain * error + x[8]
    if command >= 0.0:
        held: float = max(min(command, wanted), -0.5 * p[7])
    else:
        held = min(max(command, wanted), 0.5 * p[7])
    return held


def speed_control(x: Array, w_ref: float, p: Array) -> float:
    """Torque reference, Nm, of a PI speed control with clamped integrator."""
    gain = SPEED_BANDWIDTH * p[4]
    error = w_ref - x[2]
    x[8] += 30.0 * gain * error * DT
    x[8] = min(max(x[8], -p[7]), p[7])
    wanted: float = min(max(gain * error + x[8], -p[7]), p[7])
    return wanted


def limiter(now: float, cut: bool, floor: float) -> float:
    """The torque limiter after one period: falls within 100 ms, returns over 1 s."""
    if cut:
        return max(now - CUT_PER_S * DT, floor)
    return min(now + RESTORE_PER_S * DT, 1.0)


def advance(
    x: Array, train: Array, p: Array, on_rail: bool, inner: int, u_dc: float,
    w_ref: Array, w_acc: Array, load: Array, carry: Array, cut: NDArray[np.bool_],
    curves: Array, radius: float, load_nm: float, mass_j: float, out: Array,
) -> None:  # fmt: skip
    """Advance N drives and their train by n control periods; everything in place.

    `w_ref` (n,) rotor speed wanted rad/s, `w_acc` (n,) its slope rad/s2, `load` (n,) healthy load
    per drive Nm (rail: running resistance), `carry` (n, N) share of what is asked of the wheel,
    motor and friction brake together, that the rail can carry (1 = all), `cut` (n, N) limiter
    commanded down, `curves` (n, N, 6) rail, `mass_j` train inertia per drive at the rotor kg m2,
    `out` (n, N, 10) at the end of each period.
    The command that drives report is the train's; what differs between them (`p` 9) is in the
    torque that they deliver. Speeds are those of a rotor with a wheel of nominal diameter.
    While the friction brake of every drive is applied, the driver's demand falls to 0.
    """
    n, drives = carry.shape
    h = DT / inner
    no_limit = 1e30
    braking = True
    for d in range(drives):
        braking = braking and p[d, BRAKE] > 0.0
    for k in range(n):
        effort = p[0, EFFORT]
        if on_rail:
            error = w_ref[k] - train[0]
            gain = DRIVER_BANDWIDTH * mass_j
            demand = gain * error + train[1] + mass_j * w_acc[k]
            if braking:
                fall = CUT_PER_S * DT * effort
                demand = train[2] - min(max(train[2], -fall), fall)
            elif abs(demand) < effort:
                train[1] += 0.5 * DRIVER_BANDWIDTH * gain * error * DT
            demand = min(max(demand, -effort), effort)
        else:
            demand = load[k]
        train[2] = demand
        v = train[0] * radius
        pull = 0.0
        for d in range(drives):
            q = p[d]
            s = x[d]
            s[9] = limiter(s[9], cut[k, d], q[8])
            limit = no_limit
            if on_rail:
                command = demand * s[9]
                reference = slip_limit(s, command * q[SHARE], train[0] / q[WHEEL], q)
                if carry[k, d] < 1.0:
                    asked = demand * q[SHARE] - math.copysign(q[BRAKE], train[0])
                    limit = carry[k, d] * abs(asked)
            else:
                command = demand * s[9] + q[4] * w_acc[k]
                reference = speed_control(s, w_ref[k] / q[WHEEL], q)
            held = demand * q[SHARE] * min(s[9], carry[k, d])
            r = radius * q[WHEEL]
            carried = load_nm * q[SHARE]
            u_a = s[6]
            u_b = s[7]
            power = 1.5 * (u_a * s[0] + u_b * s[1])
            dc = u_dc - DC_SOURCE_OHM * power / u_dc
            current_control(s, reference, dc / math.sqrt(3.0), q)
            integrate(s, u_a, u_b, q, h, inner, on_rail, held, v, r, carried, curves[k, d], limit)
            if on_rail:
                held = rail_torque(s[2], v, r, carried, curves[k, d], limit)
            pull += held / q[WHEEL]
            o = out[k, d]
            o[I_ALPHA] = s[0]
            o[I_BETA] = s[1]
            o[U_ALPHA] = u_a
            o[U_BETA] = u_b
            o[U_DC] = dc
            o[TORQUE] = q[6] * q[3] * q[2] * (s[1] * math.cos(s[3]) - s[0] * math.sin(s[3]))
            o[SPEED] = s[2]
            o[ANGLE] = s[3]
            o[LOAD] = held
            o[COMMAND] = command
        if on_rail:
            train[0] += DT * (pull / drives - load[k]) / mass_j
        else:
            train[0] = w_ref[k]
