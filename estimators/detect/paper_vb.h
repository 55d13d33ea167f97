/* Variational Bayes with the paper's priors, one tick: paper `adhesion`, section 4.2. */
#ifndef TRACTION_PAPER_VB_H
#define TRACTION_PAPER_VB_H

#include "gateway/core/records.h"

/* Variational Bayes over the loads x (n,), starting from the prior; returns the iterations made.
 *
 * Fills q with the factors, r1 (n,) with E[I], the probability of lost adhesion, and bound
 * (iterations,). Stops if an iteration raises the bound by less than `tolerance` of its magnitude;
 * the rest of `bound` is then its last value. A tolerance below 0: exactly `iterations`, >= 1. */
int paper_vb_infer(const struct paper_vb_factors *prior, int iterations, double tolerance,
                   const double *x, int n, struct paper_vb_factors *q, double *r1,
                   struct paper_vb_bound *bound);

#endif
