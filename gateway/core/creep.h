/* Creep of a wheel on its rail, and utilisation of its adhesion. */
#ifndef TRACTION_CREEP_H
#define TRACTION_CREEP_H

#include "gateway/core/records.h"

/* Fill creep and utilisation of every drive of `status`, whose flags and load are those of this tick.
 * NaN if a number is not known, or its standard deviation exceeds its signal's largest value. */
void estimate_creep(const struct adhesion *a, struct drive_status *status);

#endif
