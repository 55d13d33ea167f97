/* Extended Kalman filter of one temperature: paper `thermal`, Table 2 and, as its model, eq. (1),
 *
 *     dT/dt = c (I^2 + g w^2) - xi (T - T_out)        reading = T + b + noise
 *
 * State x = [T, log c, log xi]: heat gain c and heat loss xi change slowly (ageing). `ekf.py` lists
 * the corrections to the equation and how c, xi, g and b are fitted.
 *
 * Nothing here can fail. The divisors are a heat loss, which is an exponential, and the variance of
 * an innovation, which is above that of a reading; with a model that has one of them at 0 the
 * innovations are NaN or infinite. Loops end with the samples and with the step of the last one. */
#include "estimators/thermal/rivals/ekf.h"

#include <math.h>

#include "estimators/elementary.h"
#include "estimators/numbers.h"

static const double NUDGE = 1e-4;   /* change of log xi for the derivative */
static const double FACTOR = 2.0;   /* logarithm of the factor within which c and xi stay */
static const double FIRST_T = 10.0; /* K, standard deviation of T at the start */

struct ekf {
    double x[3];            /* T, log c, log xi */
    double P[3][3];         /* covariance of x */
    double low[3], high[3]; /* limits of x[1] and x[2] */
};

/* Effect of steps of constant heat: T = decay T + c warmed + aired. */
struct gap {
    double decay; /* share of T that is left */
    double warmed;
    double aired;
};

/* Integrate eq. (1) over `steps` steps, exactly for constant heat in each: that of the last step
 * has not decayed. */
static struct gap integrate(double loss, double speed_share, const struct thermal_input *u,
                            int64_t steps, double step_s)
{
    const double keep = elementary_exp(-loss * step_s);
    double decay = 1.0, warmed = 0.0, aired = 0.0;
    for (int64_t j = 0; j < steps; j++) {
        decay *= keep;
        warmed = warmed * keep + u[j].current_square + speed_share * square(u[j].speed);
        aired = aired * keep + u[j].ambient;
    }
    return (struct gap){
        .decay = decay,
        .warmed = warmed * (1.0 - keep) / loss,
        .aired = aired * (1.0 - keep),
    };
}

static void start(struct ekf *f, const struct lumped_model *model, double prior_sigma)
{
    *f = (struct ekf){
        .x = {model->usual - model->offset, elementary_log(model->gain),
              elementary_log(model->loss)},
        .P = {{square(FIRST_T), 0.0, 0.0},
              {0.0, square(prior_sigma), 0.0},
              {0.0, 0.0, square(prior_sigma)}},
    };
    for (int i = 0; i < 3; i++) {
        f->low[i] = f->x[i] - FACTOR;
        f->high[i] = f->x[i] + FACTOR;
    }
}

/* P = A P A', where A is the unit matrix except for its first row a. */
static void propagate(double P[3][3], const double a[3])
{
    for (int j = 0; j < 3; j++)
        P[0][j] = a[0] * P[0][j] + a[1] * P[1][j] + a[2] * P[2][j];
    for (int i = 0; i < 3; i++)
        P[i][0] = P[i][0] * a[0] + P[i][1] * a[1] + P[i][2] * a[2];
}

/* x = f(x), P = A P A' + Q over `steps` steps. */
static void predict(struct ekf *f, const struct lumped_model *model,
                    const struct lumped_tuning *tuning, const struct thermal_input *u,
                    int64_t steps)
{
    const double c = elementary_exp(f->x[1]);
    const double xi = elementary_exp(f->x[2]);
    const double xi_nudged = xi * (1.0 + NUDGE);
    const struct gap here = integrate(xi, model->speed_share, u, steps, tuning->step_s);
    const struct gap near = integrate(xi_nudged, model->speed_share, u, steps, tuning->step_s);
    const double T = here.decay * f->x[0] + c * here.warmed + here.aired;
    const double T_near = near.decay * f->x[0] + c * near.warmed + near.aired;
    /* Derivatives of T with respect to the state. */
    const double a[3] = {here.decay, c * here.warmed, (T_near - T) / NUDGE};
    f->x[0] = T;
    propagate(f->P, a);
    f->P[0][0] += model->unrest * (1.0 - here.decay * here.decay);
    f->P[1][1] += tuning->walk;
    f->P[2][2] += tuning->walk;
}

/* x = x + k nu, P = P - k H P, where H = [1 0 0]; returns the innovation nu over its sigma. */
static double update(struct ekf *f, const struct lumped_model *model, double reading)
{
    const double S = f->P[0][0] + model->noise;
    const double nu = reading - model->offset - f->x[0];
    const double k[3] = {f->P[0][0] / S, f->P[1][0] / S, f->P[2][0] / S};
    const double HP[3] = {f->P[0][0], f->P[0][1], f->P[0][2]};
    for (int i = 0; i < 3; i++) {
        f->x[i] += k[i] * nu;
        for (int j = 0; j < 3; j++)
            f->P[i][j] -= k[i] * HP[j];
    }
    for (int i = 1; i < 3; i++)
        f->x[i] = clamp(f->x[i], f->low[i], f->high[i]);
    return nu / sqrt(S);
}

void lumped_innovations(const struct lumped_model *model, const struct lumped_tuning *tuning,
                        const struct thermal_input *inputs, const double *reading,
                        const int64_t *at, int64_t samples, double *out)
{
    struct ekf f;
    start(&f, model, tuning->prior_sigma);
    for (int64_t k = 0; k < samples; k++) {
        if (k > 0 && at[k] > at[k - 1])
            predict(&f, model, tuning, &inputs[at[k - 1] + 1], at[k] - at[k - 1]);
        out[k] = isfinite(reading[k]) ? update(&f, model, reading[k]) : 0.0;
    }
}
