/* Common parts of the paper's two variational detectors: paper `adhesion`, section 4. */
#ifndef TRACTION_PAPER_H
#define TRACTION_PAPER_H

#define LOG_2PI 1.8378770664093453 /* log(2 pi) */

/* Weight of a drive with r1 = E[I] in component k: 1 - E[I] in component 0, E[I] in component 1. */
static inline double share(double r1, int k)
{
    return k == 1 ? r1 : 1.0 - r1;
}

/* E[I] from its log odds z; 0 and 1 if z is very small or large, NaN for NaN. */
double indicator(double z);

/* Entropy of the indicators, r1 (n,) = E[I]: their part of the lower bound. */
double indicator_entropy(const double *r1, int n);

/* Kullback-Leibler divergence of a beta factor (2,) from its prior (2,), both above 0: the part of
 * q(pi) that is subtracted from the lower bound. */
double beta_divergence(const double *alpha, const double *prior);

#endif
