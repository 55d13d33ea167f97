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

/* What is wrong, by kind (THERMAL_KINDS), the probabilities of all kinds: 1 heat, -1 a sensor, 0
 * where neither has the share `named` of both. A loose connector is told by bursts, which heat has
 * none of, so it stands beside the question. */
int thermal_side(const double *kind, double named);

/* The same of every row of kind (rows, THERMAL_KINDS): fills side (rows). */
void thermal_sides(const double *kind, int64_t rows, double named, int64_t *side);

#endif
