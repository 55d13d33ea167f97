/* Discrete Bayes filter per motor, for samples hours apart: finds the fault that explains what the
 * thermal model does not. */
#ifndef TRACTION_THERMAL_HYPOTHESES_H
#define TRACTION_THERMAL_HYPOTHESES_H

#include "gateway/core/records.h"

/* Start with a motor without a fault. */
void hypothesis_start(struct hypothesis_state *state);

/* One sample of all motors: z (motors, THERMAL_POINTS) K, residuals less their centre, NaN without a
 * reading; shapes (IMM_HEATS, THERMAL_POINTS): effect of 1 K of each heat fault at each point by
 * then. workspace: 8 numbers per motor. */
void hypothesis_step(const struct hypothesis_config *config, const struct hypothesis_spread *spread,
                     struct hypothesis_state *state, int motors, const double *z,
                     const double *shapes, double *workspace);

/* Side of a fault, by the probabilities of all kinds (THERMAL_KINDS): 1 heat, -1 a sensor, 0
 * if neither has the share `named` of both. A loose connector is recognised by bursts, which heat
 * does not cause, so it is not part of the comparison. */
int thermal_side(const double *kind, double named);

/* The same for every row of kind (rows, THERMAL_KINDS): fills side (rows). */
void thermal_sides(const double *kind, int64_t rows, double named, int64_t *side);

#endif
