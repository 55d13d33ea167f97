/* Sigma-mixed unscented Kalman filter: paper `thermal`, Algorithm 1, eq. (19)-(21), (28). */
#ifndef TRACTION_SIGMA_MIXED_H
#define TRACTION_SIGMA_MIXED_H

#include "gateway/core/records.h"

/* Process all samples (count) of one motor: fills state (count, THERMAL_POINTS) degC after each
 * update, and mixed (count): the mixed state. */
void sigma_mixed_run(const struct sigma_mixed_config *config,
                     const struct sigma_mixed_sample *samples, int64_t count, double *state,
                     double *mixed);

#endif
