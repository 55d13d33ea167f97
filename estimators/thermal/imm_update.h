/* Update of one filter of a motor by a block of readings. */
#ifndef TRACTION_THERMAL_IMM_UPDATE_H
#define TRACTION_THERMAL_IMM_UPDATE_H

#include "gateway/core/records.h"

/* Update of mode g's x (IMM_STATES) and P (IMM_STATES, IMM_STATES) by the readings y
 * (THERMAL_POINTS) that there are; their log likelihood. Readings are normal with `noise` K, or,
 * rarely, `wide` K off: then they say little. */
double imm_update(int g, const double *y, double noise, double wide, double *x, double *P);

#endif
