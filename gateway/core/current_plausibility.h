/* Currents that are held, late, turned, or of another scale. */
#ifndef TRACTION_CURRENT_PLAUSIBILITY_H
#define TRACTION_CURRENT_PLAUSIBILITY_H

#include "gateway/core/records.h"

/* Look for repeats among the samples of this tick. */
void check_samples(struct motion_monitor *m, int64_t now_ns);

/* Hold reading r of Motion in this tick against the current of the same instant. */
void check_current(struct motion_monitor *m, int64_t r, int64_t now_ns);

#endif
