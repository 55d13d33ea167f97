/* Errors of the loads: what is learnt of them, and their variance in a step. */
#ifndef ESTIMATORS_DETECT_SWITCHING_NOISE_H
#define ESTIMATORS_DETECT_SWITCHING_NOISE_H

#include "gateway/core/records.h"

/* Noise before anything is learnt. */
struct switching_noise switching_noise_unknown(void);

/* Variance of the error of load i, in rated torque squared: above 0. */
double switching_noise_of(const struct switching *s, int i);

/* Of loads from another estimate than before, and at first, only that estimate's sigma is known. */
void switching_note_sources(struct switching *s);

/* Learn from the loads of a step, by the likeliest hypothesis. */
void switching_learn_noises(struct switching *s);

/* Note that the demand has moved by so much: not all drives follow at the same instant. */
void switching_note_lag(struct switching *s, double moved);

#endif
