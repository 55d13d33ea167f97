/* Quantities learnt while a filter runs: noise of its sensors, error of the q-axis voltage. */
#ifndef TRACTION_ADAPTATION_H
#define TRACTION_ADAPTATION_H

#include "gateway/core/records.h"

/* The factor on R after an innovation, `dt` s after the last; from 1 to R_SCALE_MAX. nis:
 * normalised innovation squared, computed with `r_scale`; age: time since the filter's start, s. */
double adapt_r(double r_scale, double nis, double dt, double age);

/* v_q_bias after a sample, `dt` s after the last one, V; within +-`limit`. excess: electrical speed
 * of the filter less that of the chords, rad/s; age: time since the filter's start, s. */
double adapt_q_bias(double v_q_bias, double excess, double psi_f, double dt, double limit,
                    double age);

/* Largest v_q_bias, V, of a motor off its data sheet at the electrical speed w, rad/s. */
double q_bias_limit(double w, const struct pmsm *motor, double I_rated);

/* v_q_bias of a new filter, V: from the excess of the chords' length over the flux of the data
 * sheet. 0 if the chords do not show it. */
double first_q_bias(const struct acquisition *chords, const struct pmsm *motor, double I_rated);

/* After the filters of a tick: m innovations in order; changes steps, nis, r_scale and v_q_bias of
 * the active filters. dt: sub-step, s; I_rated: of every drive, A. */
void adapt_filters(const struct filter_sample *samples, int m, struct filter *filters,
                   const struct acquisition *chords, const struct pmsm *motors,
                   const double *I_rated, double dt);

#endif
