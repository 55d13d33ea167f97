/* Gaussian mixtures of a scalar by expectation-maximisation: paper `thermal`, eq. (9)-(18). */
#ifndef TRACTION_GAUSSIAN_MIXTURE_H
#define TRACTION_GAUSSIAN_MIXTURE_H

#include "gateway/core/records.h"

/* Fit n components (1 to MIXTURE_MAX) to x (count >= n); ascending: the same numbers, sorted. The
 * components are in ascending order of their means; variances are at least `floor`, above 0. */
void mixture_fit(const double *x, const double *ascending, int count, int iterations, double floor,
                 int n, struct mixture *out);

#endif
