/* Moving average inter-state standard deviation (MAISD) of M motors with P points each: paper
 * `thermal`, eq. (29)-(31). */
#ifndef TRACTION_MAISD_H
#define TRACTION_MAISD_H

#include <stdint.h>

/* Put one sample of all cells (M x P values, K) into the ring (window, cells), in place of the
 * oldest one, NaN if a value is not present; `seen`: number of samples put in before. */
void maisd_push(double *ring, int window, int cells, int64_t seen, const double *values,
                const uint8_t *present);

/* (29): means of the window, 0 without a value; number of values of each cell in it, and whether
 * that is at least half of it. */
void maisd_average(const double *ring, int window, int cells, double *mean, int64_t *number,
                   uint8_t *known);

/* (31): spread (points) of the known motors' means (motors, points) around their mean, NaN for less
 * than two; deviation (motors, points) of each known motor from the median of the others (0
 * between the middle two of an even number), NaN without others. workspace: a number per motor. */
void maisd_compare(const double *mean, const uint8_t *known, int motors, int points,
                   double *workspace, double *spread, double *deviation);

#endif
