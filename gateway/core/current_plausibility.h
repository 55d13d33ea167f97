/* Detection of currents that are held, late, turned, or of another scale. */
#ifndef TRACTION_CURRENT_PLAUSIBILITY_H
#define TRACTION_CURRENT_PLAUSIBILITY_H

#include "gateway/core/records.h"

/* Check the samples of this tick for repeats. */
void check_samples(struct motion_monitor *m, int64_t now_ns);

/* Compare reading r of Motion in this tick with the current at the same instant. */
void check_current(struct motion_monitor *m, int64_t r, int64_t now_ns);

#endif
