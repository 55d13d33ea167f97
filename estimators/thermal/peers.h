/* Residual of one motor's peers, the other motors of a train: their median. */
#ifndef TRACTION_THERMAL_PEERS_H
#define TRACTION_THERMAL_PEERS_H

#include <stdint.h>

/* Fill out (motors, THERMAL_POINTS): for each motor and point the median of u, K, NaN without a
 * reading, over the other motors.
 *
 * Only over trusted motors (motors), or over all if too few are trusted (fewer than three; of three
 * motors fewer than two). 0 for a train of one motor. NaN if fewer than two others have a reading
 * (of two motors, or beside one suspect of three: one). workspace: a number per motor. */
void peers_median(const double *u, const uint8_t *trusted, int motors, double *workspace,
                  double *out);

#endif
