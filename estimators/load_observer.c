/* Load observer from measured speed and torque: T_L = T - B w - J dw/dt, filtered.
 *
 * For drives whose currents are sampled too slowly for the filters, and for standstill. A linear
 * Kalman filter with the states speed and load,
 *
 *     w+   = w + dt / J (T - B w - T_L) + q_w        T: mean of the torques at both ends
 *     T_L+ = T_L + q_L
 *     z    = w + r
 *
 * so that the differentiation is as fast as the noise of the speed allows. Not in paper `adhesion`.
 * The divisors are J, and S, which is at least speed_var; both are above 0. */
#include "estimators/load_observer.h"

#include <math.h>

#include "estimators/numbers.h"

#define SPREAD_STEP 0.05 /* weight of the newest reading in the mean of the innovations, */
#define NIS_MOST    8.0  /* in which it counts as at most this */
#define LOAD_SURE   0.01 /* share of the load: an error that no innovation shows */
#define FIRST_S     0.1  /* time in which the load may have changed before the first reading */

void load_observer_init(struct load_observer *state, double w, double torque,
                        const struct mechanics *m)
{
    const double sigma = 0.5 * fabs(torque) + sqrt(m->load_rate * FIRST_S);
    state->w = w;
    state->T_L = torque;
    state->P_ww = m->speed_var;
    state->P_wL = 0.0;
    state->P_LL = square(sigma);
    state->torque = torque;
    state->nis = 1.0;
    state->spread = 1.0;
}

void load_observer_update(struct load_observer *state, double w, double torque, double dt,
                          const struct mechanics *m)
{
    /* predict */
    const double a = 1.0 - m->B * dt / m->J;
    const double b = -dt / m->J;
    const double T = 0.5 * (state->torque + torque);
    const double w_p = a * state->w + b * (state->T_L - T);
    /* A random walk of the load also moves the speed within the step: a third of its variance. */
    const double q = m->load_rate * dt;
    const double P_ww =
        a * a * state->P_ww + 2.0 * a * b * state->P_wL + b * b * (state->P_LL + q / 3.0);
    const double P_wL = a * state->P_wL + b * (state->P_LL + 0.5 * q);
    const double P_LL = state->P_LL + q;
    /* update */
    const double S = P_ww + m->speed_var;
    const double nu = w - w_p;
    const double k_w = P_ww / S;
    const double k_L = P_wL / S;
    state->w = w_p + k_w * nu;
    state->T_L = state->T_L + k_L * nu;
    state->P_ww = (1.0 - k_w) * P_ww;
    state->P_wL = (1.0 - k_w) * P_wL;
    state->P_LL = P_LL - k_L * P_wL;
    state->torque = torque;
    state->nis = nu * nu / S;
    state->spread += SPREAD_STEP * (smaller(state->nis, NIS_MOST) - state->spread);
}

double load_observer_sigma(const struct load_observer *state)
{
    return sqrt(state->spread * state->P_LL + square(LOAD_SURE * state->T_L));
}
