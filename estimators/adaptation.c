/* Noise of the sensors and errors of the motor's data, learnt while the filter runs.
 *
 * A filter with an R that is too small passes the noise of its sensors on to the load: five times
 * the necessary noise at fifty times the variance. The normalised innovation squared (NIS) of m = 2
 * currents has the mean 2 if R is right; R is scaled until it has.
 *
 * If R_s or psi_f differ from the data sheet, a voltage along q is missing (errors of R_s i_q and
 * psi_f w_e). The filter compensates with a constant error of its speed, while its angle follows the
 * rotor: innovations, load and speed are biased, and jump at every gap. The chords' speed is that
 * of a turning vector, whatever its length; the filter's excess over it gives the voltage
 * psi_f (w - w_chord), which is integrated into `v_q_bias`. (The innovations do not show it: they
 * are zero if they change the load, not if the voltage is missing.) Neither is in paper `adhesion`.
 *
 * No function here can fail: every divisor is at least a constant above 0, and results are clamped. */
#include "estimators/adaptation.h"

#include <math.h>

#include "estimators/elementary.h"
#include "estimators/numbers.h"

static const double R_TAU_S = 0.5;
/* A new filter learns faster: with a quarter of the time since its start. */
static const double R_TAU_FIRST_S = 0.03;
static const double R_SCALE_MAX = 400.0; /* a larger factor means a fault, not noise */
static const double NIS_MAX = 8.0; /* largest NIS that counts: a loss that begins is no noise */
static const double NIS_EXPECTED = 2.0;   /* mean of a chi-squared of two degrees of freedom */
static const double NIS_SMOOTHING = 0.2;  /* weight of the newest value in `nis` */
static const double Q_TAU_S = 0.5;        /* of v_q_bias, */
static const double Q_TAU_FIRST_S = 0.15; /* and at the start, faster likewise */
static const double RESISTANCE_MAX = 0.3; /* largest possible relative errors of R_s */
static const double FLUX_MAX = 0.2;       /* and of psi_f */

double adapt_r(double r_scale, double nis, double dt, double age)
{
    const double change = fmin(nis, NIS_MAX) / NIS_EXPECTED - 1.0;
    const double tau = clamp(0.25 * age, R_TAU_FIRST_S, R_TAU_S);
    return clamp(r_scale * elementary_exp(change * fmin(dt / tau, 1.0)), 1.0, R_SCALE_MAX);
}

double adapt_q_bias(double v_q_bias, double excess, double psi_f, double dt, double limit,
                    double age)
{
    const double tau = clamp(age, Q_TAU_FIRST_S, Q_TAU_S);
    return clamp(v_q_bias + dt / tau * psi_f * excess, -limit, limit);
}

double q_bias_limit(double w, const struct pmsm *motor, double I_rated)
{
    return RESISTANCE_MAX * motor->R_s * I_rated + FLUX_MAX * motor->psi_f * fabs(w);
}

double first_q_bias(const struct acquisition *chords, const struct pmsm *motor, double I_rated)
{
    const double missing = (chords->psi - motor->psi_f) * chords->w;
    const double limit = q_bias_limit(chords->w, motor, I_rated);
    return isnan(missing) ? 0.0 : clamp(missing, -limit, limit);
}

void adapt_filters(const struct filter_sample *samples, int m, struct filter *filters,
                   const struct acquisition *chords, const struct pmsm *motors,
                   const double *I_rated, double dt)
{
    for (int k = 0; k < m; k++) {
        const int64_t d = samples[k].drive;
        struct filter *f = &filters[d];
        if (!f->active)
            continue;
        f->steps += samples[k].steps;
        const double nis = samples[k].nis;
        const double passed = (double)samples[k].steps * dt, age = (double)f->steps * dt;
        if (isfinite(nis)) {
            f->nis += NIS_SMOOTHING * (nis - f->nis);
            f->r_scale = adapt_r(f->r_scale, nis, passed, age);
        }
        if (f->steps >= FILTER_SETTLE_STEPS && chords[d].ready) {
            const double w = f->x[2];
            const double limit = q_bias_limit(w, &motors[d], I_rated[d]);
            const double psi_f = motors[d].psi_f;
            f->v_q_bias = adapt_q_bias(f->v_q_bias, w - chords[d].w, psi_f, passed, limit, age);
        }
    }
}
