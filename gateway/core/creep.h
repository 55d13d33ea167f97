/* How a wheel runs on its rail: creep, and how much of its adhesion it uses. */
#ifndef TRACTION_CREEP_H
#define TRACTION_CREEP_H

#include "gateway/core/records.h"

/* Fill creep and utilisation of every drive of `status`, whose flags and load are those of this tick.
 * NaN where it is not known, or not as well as the signal of its standard deviation can say. */
void estimate_creep(const struct adhesion *a, struct drive_status *status);

#endif
