/* Update of one motor's filter by a block of readings. */
#ifndef TRACTION_THERMAL_IMM_UPDATE_H
#define TRACTION_THERMAL_IMM_UPDATE_H

#include "gateway/core/records.h"

/* Update mode g's x (IMM_STATES) and P (IMM_STATES, IMM_STATES) by the available readings y
 * (THERMAL_POINTS); returns their log likelihood. Readings are normal with `noise` K, or,
 * rarely, off by `wide` K: then they have little weight. */
double imm_update(int g, const double *y, double noise, double wide, double *x, double *P);

#endif
