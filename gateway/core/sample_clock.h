/* When samples were taken, by their stamps. */
#ifndef TRACTION_SAMPLE_CLOCK_H
#define TRACTION_SAMPLE_CLOCK_H

#include "gateway/core/records.h"

/* Begin at a sample with this voltage (V, alpha and beta). */
void start_sample_clock(struct sample_clock *clock, const double *u, int64_t period_ns);

/* Go on to a sample that came `passed_ns` after the one before and is `cycles` of its counter after
 * it, with a lateness of at most `max_gap_ns`. Returns periods that the sender has left out between
 * the two without counting. */
int64_t step_sample_clock(struct sample_clock *clock, const double *u, int64_t passed_ns,
                          int64_t cycles, int64_t period_ns, int64_t max_gap_ns);

#endif
