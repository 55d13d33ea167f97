/* Thermal model of a motor as five lumps, with the inputs on the bus: currents, speed, ambient.
 *
 *     winding      dw = a I^2 (1 + 0.0039 (w - 60)) - k_w (w - c)
 *     core         dc = k_c (w - c) + e_1 |W| + e_2 W^2 - g_c (c - f)
 *     frame        df = g_f (c - f) - (h_0 + h_1 |W|) (f - T_a)
 *     drive end    dd = k_d (f - d) + f_d |W| - b_d (d - T_a)       non-drive end alike
 *
 * per second; I: amplitude of the current, A; W: rotor speed, rad/s; T_a: ambient, degC. In place
 * of paper `thermal`, eq. (1), whose one lump has one time constant (estimators/thermal/heat.py).
 *
 * Nothing here can fail: floating-point division does not trap, and the divisors are above 0 while
 * rates are not negative and dt * 0.0039 a I^2 is below 1. Otherwise the result is no temperature,
 * and a comparison with readings finds a motor that the model does not explain. */
#include "estimators/thermal/model.h"

const int THERMAL_SEEN[THERMAL_POINTS] = {THERMAL_WINDING, THERMAL_DRIVE_END, THERMAL_OTHER_END};
const double THERMAL_LEAST_RISE_K = 3.0;

static const double SLOPE = 0.0039;   /* 1/K, relative increase of copper's resistance */
static const double REFERENCE = 60.0; /* degC, at which `a` is given */

double thermal_model_resistance(double winding)
{
    return 1.0 + SLOPE * (winding - REFERENCE);
}

/* Step of an end: k from the frame, friction f by speed, b to the air. */
static double end_step(double k, double f, double b, double frame, const struct thermal_input *u,
                       double extra, double dt, double x)
{
    return (x + dt * (k * frame + f * u->speed + b * u->ambient + extra)) / (1.0 + dt * (k + b));
}

void thermal_model_step(const struct thermal_parameters *p, const struct thermal_input *u,
                        const double *extra, double dt, double *x)
{
    const double W = u->speed, T_a = u->ambient;
    const double copper = p->a * u->current_square;
    const double air = p->h_0 + p->h_1 * W;
    /* Winding, core, frame: a chain of three linear equations, solved from its ends. */
    const double own_w = 1.0 + dt * (p->k_w - SLOPE * copper);
    const double own_c = 1.0 + dt * (p->k_c + p->g_c);
    const double own_f = 1.0 + dt * (p->g_f + air);
    const double w = (x[0] + dt * (copper * (1.0 - SLOPE * REFERENCE) + extra[0])) / own_w;
    const double f = (x[2] + dt * (air * T_a + extra[2])) / own_f;
    const double c = x[1] + dt * (p->e_1 * W + p->e_2 * W * W + extra[1]);
    const double w_of_c = dt * p->k_w / own_w;
    const double f_of_c = dt * p->g_f / own_f;
    x[THERMAL_CORE] =
        (c + dt * (p->k_c * w + p->g_c * f)) / (own_c - dt * (p->k_c * w_of_c + p->g_c * f_of_c));
    x[THERMAL_WINDING] = w + w_of_c * x[THERMAL_CORE];
    x[THERMAL_FRAME] = f + f_of_c * x[THERMAL_CORE];
    x[THERMAL_DRIVE_END] = end_step(p->k_d, p->f_d, p->b_d, x[2], u, extra[3], dt, x[3]);
    x[THERMAL_OTHER_END] = end_step(p->k_n, p->f_n, p->b_n, x[2], u, extra[4], dt, x[4]);
}

void thermal_model_simulate(const struct thermal_parameters *p, const struct thermal_input *u,
                            const double *extra, double dt, const int64_t *at, int64_t count,
                            double *x, double *out)
{
    int64_t n = 0;
    for (int64_t k = 0; k < count; k++) {
        for (; n <= at[k]; n++)
            thermal_model_step(p, &u[n], extra, dt, x);
        for (int i = 0; i < THERMAL_LUMPS; i++)
            out[k * THERMAL_LUMPS + i] = x[i];
    }
}

void thermal_model_system_matrix(const struct thermal_parameters *p, double current_square,
                                 double speed, double *a)
{
    double (*rows)[THERMAL_LUMPS] = (double (*)[THERMAL_LUMPS])a;
    for (int i = 0; i < THERMAL_LUMPS * THERMAL_LUMPS; i++)
        a[i] = 0.0;
    rows[0][0] = -p->k_w + SLOPE * p->a * current_square;
    rows[0][1] = p->k_w;
    rows[1][0] = p->k_c;
    rows[1][1] = -p->k_c - p->g_c;
    rows[1][2] = p->g_c;
    rows[2][1] = p->g_f;
    rows[2][2] = -p->g_f - p->h_0 - p->h_1 * speed;
    rows[3][2] = p->k_d;
    rows[3][3] = -p->k_d - p->b_d;
    rows[4][2] = p->k_n;
    rows[4][4] = -p->k_n - p->b_n;
}
