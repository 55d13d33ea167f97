/* Delays of samples, by their stamps. */
#ifndef TRACTION_SAMPLE_CLOCK_H
#define TRACTION_SAMPLE_CLOCK_H

#include "gateway/core/records.h"

/* Start at a sample with this voltage (V, alpha and beta). */
void start_sample_clock(struct sample_clock *clock, const double *u, int64_t period_ns);

/* Advance to a sample that came `passed_ns` after the one before and is `cycles` of its counter
 * after it, with a delay of at most `max_gap_ns`. Returns the number of periods between the two
 * that the sender has left out without counting. */
int64_t step_sample_clock(struct sample_clock *clock, const double *u, int64_t passed_ns,
                          int64_t cycles, int64_t period_ns, int64_t max_gap_ns);

#endif
