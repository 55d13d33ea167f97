/* When samples were due, by their stamps. */
#ifndef TRACTION_SAMPLE_CLOCK_H
#define TRACTION_SAMPLE_CLOCK_H

#include "gateway/core/records.h"

/* Begin at a sample; a late one that waits is dropped. */
void start_sample_clock(struct sample_clock *clock);

/* Go on to a sample that came `passed_ns` after the one before and is `cycles` of its counter after
 * it. Returns periods that the sender left out without counting before the late sample that waits:
 * 0 if none did, or none waits. */
int64_t step_sample_clock(struct sample_clock *clock, int64_t passed_ns, int64_t cycles,
                          int64_t period_ns, int64_t max_gap_ns);

/* 1 if the sample of this step must wait: only the next one shows whether it was delayed or
 * whether others before it were left out. */
int is_out_of_time(const struct sample_clock *clock, int64_t period_ns);

#endif
