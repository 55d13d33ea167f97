/* Halves of samples combined to samples. */
#ifndef TRACTION_PAIRING_H
#define TRACTION_PAIRING_H

#include "gateway/core/records.h"

/* Turn an accepted, decoded row of currents, voltages or a block of samples, whose values are good,
 * into samples, after those that `receiver` has in this tick. Returns 0 for a block with an invalid
 * index (nothing is done then), else 1. */
int pair_samples(struct receiver *receiver, int64_t row);

#endif
