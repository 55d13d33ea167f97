/* What is learnt while a filter runs: the noise of its sensors, the voltage that its motor lacks. */
#ifndef TRACTION_ADAPTATION_H
#define TRACTION_ADAPTATION_H

#include "gateway/core/records.h"

/* The factor on R after an innovation, `dt` s after the last; from 1 to R_SCALE_MAX. nis: normalised
 * innovation squared, computed with the factor `r_scale`; age: s since the filter's start. */
double adapt_r(double r_scale, double nis, double dt, double age);

/* v_q_bias after a sample, `dt` s after the last, V; within `limit`. excess: the filter's electrical
 * speed less the chords', rad/s; age: s since the filter's start. */
double adapt_q_bias(double v_q_bias, double excess, double psi_f, double dt, double limit,
                    double age);

/* Largest v_q_bias, V, that a motor off its data sheet makes at the electrical speed w, rad/s. */
double q_bias_limit(double w, const struct pmsm *motor, double I_rated);

/* v_q_bias of a new filter, V: what the chords are longer than the flux of the data sheet. 0 where
 * they do not tell. */
double first_q_bias(const struct acquisition *chords, const struct pmsm *motor, double I_rated);

/* After a tick's filters: m innovations in order; changes steps, nis, r_scale and v_q_bias of the
 * active filters. dt: sub-step, s; I_rated: of every drive, A. */
void adapt_filters(const struct filter_sample *samples, int m, struct filter *filters,
                   const struct acquisition *chords, const struct pmsm *motors,
                   const double *I_rated, double dt);

#endif
