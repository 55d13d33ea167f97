/* Moving average inter-state standard deviation (MAISD): paper `thermal`, eq. (29)-(31).
 *
 * Corrections: (29) as printed averages k .. k+s-1 and so looks ahead; here the window ends at k.
 * (31) uses one index for motors and for their count; it is the spread of the m motors around their
 * mean. A constant difference between healthy motors (sensor, cooling position) would be part of it,
 * so the caller first centres each motor on its fault-free data.
 *
 * Nothing here can fail: counts are checked before they divide, and the sum of squares
 * whose root is taken is never negative. */
#include "estimators/maisd.h"

#include <math.h>

#include "estimators/order_statistics.h"

void maisd_push(double *ring, int window, int cells, int64_t seen, const double *values,
                const uint8_t *present)
{
    /* A window holds at least one sample; a count below zero, which only a damaged record holds,
     * also gives an index in the ring. */
    double *oldest = ring + (int64_t)((uint64_t)seen % (uint64_t)window) * cells;
    for (int c = 0; c < cells; c++)
        oldest[c] = present[c] ? values[c] : NAN;
}

void maisd_average(const double *ring, int window, int cells, double *mean, int64_t *number,
                   uint8_t *known)
{
    for (int c = 0; c < cells; c++) {
        mean[c] = 0.0;
        number[c] = 0;
    }
    /* In the order of memory: cell by cell, a window of 1,000 motors would not fit the cache. */
    for (int k = 0; k < window; k++) {
        const double *sample = ring + (int64_t)k * cells;
        for (int c = 0; c < cells; c++) {
            if (isfinite(sample[c])) {
                mean[c] += sample[c];
                number[c] += 1;
            }
        }
    }
    for (int c = 0; c < cells; c++) {
        mean[c] = number[c] > 0 ? mean[c] / (double)number[c] : 0.0;
        known[c] = 2 * number[c] >= window;
    }
}

void maisd_compare(const double *mean, const uint8_t *known, int motors, int points,
                   double *workspace, double *spread, double *deviation)
{
    for (int p = 0; p < points; p++) {
        int n = 0;
        double total = 0.0;
        for (int c = p; c < motors * points; c += points) {
            deviation[c] = NAN;
            if (known[c]) {
                workspace[n++] = mean[c];
                total += mean[c];
            }
        }
        spread[p] = NAN;
        if (n < 2)
            continue;
        sort_ascending(workspace, n);
        const double centre = total / n;
        double squares = 0.0;
        for (int c = p; c < motors * points; c += points) {
            if (!known[c])
                continue;
            squares += (mean[c] - centre) * (mean[c] - centre);
            /* The fault itself pulls the plain mean, but not the median of the others. Of an even
             * number of others: the nearer of the middle two, otherwise one of two would pull. */
            const struct middle_pair middle = middle_of_others(workspace, n - 1, mean[c]);
            const double above = mean[c] > middle.above ? middle.above : mean[c];
            deviation[c] = mean[c] - (above < middle.below ? middle.below : above);
        }
        spread[p] = sqrt(squares / n);
    }
}
