/* Which fault explains what the thermal model does not: a discrete Bayes filter per motor, for samples
 * hours apart. */
#ifndef TRACTION_THERMAL_HYPOTHESES_H
#define TRACTION_THERMAL_HYPOTHESES_H

#include "gateway/core/records.h"

/* A motor that nothing is wrong with. */
void hypothesis_start(struct hypothesis_state *state);

/* One sample of all motors: z (motors, THERMAL_POINTS) K, residuals less their centre, NaN without a
 * reading; shapes (IMM_HEATS, THERMAL_POINTS): what 1 K of each kind of heat is at each point by
 * then. workspace: 8 numbers per motor. */
void hypothesis_step(const struct hypothesis_config *config, const struct hypothesis_spread *spread,
                     struct hypothesis_state *state, int motors, const double *z,
                     const double *shapes, double *workspace);

#endif
