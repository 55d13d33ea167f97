/* What the other motors of a train say of one: the median of theirs. */
#ifndef TRACTION_THERMAL_PEERS_H
#define TRACTION_THERMAL_PEERS_H

#include <stdint.h>

/* Fill out (motors, THERMAL_POINTS): per motor and point the median of u, K, NaN without a reading,
 * over the other motors.
 *
 * Of those that are trusted (motors); of all where too few are (fewer than three, but of three motors
 * fewer than two); 0 for a train of one motor; NaN where fewer than two others (of two motors, or
 * beside one suspect of three: one) have a reading. workspace: a number per motor. */
void peers_median(const double *u, const uint8_t *trusted, int motors, double *workspace,
                  double *out);

#endif
