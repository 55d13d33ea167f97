/* How far off loads are: what is learnt of it, and what is taken of it in a step. */
#ifndef ESTIMATORS_DETECT_SWITCHING_NOISE_H
#define ESTIMATORS_DETECT_SWITCHING_NOISE_H

#include "gateway/core/records.h"

/* Before anything is learnt. */
struct switching_noise switching_noise_unknown(void);

/* Variance of the error of load i, per unit of rated torque squared: above 0. */
double switching_noise_of(const struct switching *s, int i);

/* Of loads from another estimate than before, and at first, nothing is known but what that says. */
void switching_note_sources(struct switching *s);

/* From the loads of a step, by the likeliest hypothesis. */
void switching_learn_noises(struct switching *s);

/* The demand has moved by so much: not all drives follow at the same instant. */
void switching_note_lag(struct switching *s, double moved);

#endif
