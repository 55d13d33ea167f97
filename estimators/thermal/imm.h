/* Interacting multiple models (Blom and Bar-Shalom 1988) of one motor's heat: which fault, if any,
 * explains what the thermal model does not. */
#ifndef TRACTION_THERMAL_IMM_H
#define TRACTION_THERMAL_IMM_H

#include "gateway/core/records.h"

/* Start the filters of a motor: it has no fault, and little is known. */
void imm_start(const struct imm_config *config, struct imm_state *state);

/* Response of the lumps over dt s: fade = exp(a dt), the remainder of deviations, and its integral
 * gain, the effect of a steady heat of 1 K/s. a, fade, gain: (THERMAL_LUMPS, THERMAL_LUMPS). */
void imm_response(const double *a, double dt, double *fade, double *gain);

/* Mixing: the Markov chain of the first `modes` modes. A fault begins with probability
 * `begin`, with a fresh size, and ends with probability `end`. */
void imm_mix(const struct imm_config *config, const struct imm_state *from, int modes, double begin,
             double end, struct imm_state *to);

/* Process one block of readings, dt s after the last: y (THERMAL_POINTS) K from the other motors',
 * NaN without a reading. held: 1 if a fault is reported. Returns the log likelihood. */
double imm_advance(const struct imm_config *config, const struct imm_surroundings *around,
                   const double *y, double noise, int held, struct imm_state *state);

/* Fill kind (IMM_MODES - 1) with the probability of every kind of fault that is larger than its
 * benign size; returns the likely size of the fault, K. */
double imm_kinds(const struct imm_config *config, const struct imm_state *state, double *kind);

#endif
