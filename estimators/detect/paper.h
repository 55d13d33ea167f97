/* What the paper's two variational detectors have in common: paper `adhesion`, section 4. */
#ifndef TRACTION_PAPER_H
#define TRACTION_PAPER_H

#define LOG_2PI 1.8378770664093453 /* log(2 pi) */

/* Share of component k in a drive with r1 = E[I]: 1 - E[I] of component 0, E[I] of component 1. */
static inline double share(double r1, int k)
{
    return k == 1 ? r1 : 1.0 - r1;
}

/* E[I] from its log odds z; 0 and 1 where z is very small or large, NaN of NaN. */
double indicator(double z);

/* Entropy of the indicators, r1 (n,) = E[I]: their part of the lower bound. */
double indicator_entropy(const double *r1, int n);

/* Kullback-Leibler divergence of a beta factor (2,) from its prior (2,), both above 0: what q(pi)
 * costs the lower bound. */
double beta_divergence(const double *alpha, const double *prior);

#endif
