/* Variational Bayes over the loads of all drives: paper `adhesion`, section 4.2, eq. (21)-(47). */
#ifndef TRACTION_VARIATIONAL_H
#define TRACTION_VARIATIONAL_H

#include "gateway/core/records.h"

/* Digamma of x > 0, absolute error below 1e-13; NaN for any other x. */
double digamma(double x);

/* Probability of lost adhesion of each of n drives, `lost` (n,); returns the load that adhering
 * drives share, in the unit of `load`.
 *
 * load, spread (n,): estimate, and standard deviation of a healthy drive's load, same unit; usable
 * (n,): 1 if the load is known. `workspace` holds 5 n numbers. `lost` is 0 for drives that are not
 * usable, and for all with fewer than two usable drives; so is then the load. */
double vb_detect(const struct vb_priors *priors, int iterations, const double *load,
                 const double *spread, const uint8_t *usable, int n, double *workspace,
                 double *lost);

#endif
