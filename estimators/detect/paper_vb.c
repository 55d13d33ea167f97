/* Variational Bayes with the paper's priors: paper `adhesion`, section 4.2, eq. (32)-(47).
 *
 * One observed quantity (D = 1) at one tick; `paper_vb.py` has the same for whole records and for
 * two quantities, and lists the misprints. Moments are taken about the prior mean, which turns
 * (39)-(44) into sums over the drives without a division by N_k: an empty component keeps its
 * prior.
 *
 * Nothing here can fail. Divisors and arguments of logarithms are a positive prior plus numbers that
 * are not negative; with loads or priors that are NaN or overflow, E[I] becomes NaN, which is no
 * probability for the flags. Loops end after n drives and `iterations`. */
#include "estimators/detect/paper_vb.h"

#include <math.h>

#include "estimators/detect/paper.h"
#include "estimators/detect/variational.h"
#include "estimators/elementary.h"

#define LOG_2 0.69314718055994529 /* log(2) */

/* (46): E[log Lambda_k]. */
static double expected_log_lambda(const struct paper_vb_factors *q, int k)
{
    return digamma(0.5 * q->nu[k]) + LOG_2 - elementary_log(q->W_inv[k]);
}

/* (32), (33): log rho_k at x = m_k, where it is highest. */
static void log_rho_peaks(const struct paper_vb_factors *q, double peak[2])
{
    const double psi_total = digamma(q->alpha[0] + q->alpha[1]);
    for (int k = 0; k < 2; k++) {
        const double log_pi = digamma(q->alpha[k]) - psi_total; /* (45) */
        peak[k] = log_pi + 0.5 * (expected_log_lambda(q, k) - LOG_2PI - 1.0 / q->beta[k]);
    }
}

/* (35): r1 (n,) = E[I]. */
static void update_indicators(const struct paper_vb_factors *q, const double peak[2],
                              const double *x, int n, double *r1)
{
    const double lambda_0 = q->nu[0] / q->W_inv[0]; /* E[Lambda_0] */
    const double lambda_1 = q->nu[1] / q->W_inv[1];
    for (int i = 0; i < n; i++) {
        const double d_0 = x[i] - q->m[0];
        const double d_1 = x[i] - q->m[1];
        const double square = lambda_1 * d_1 * d_1 - lambda_0 * d_0 * d_0; /* (47) */
        r1[i] = indicator(peak[1] - peak[0] - 0.5 * square);
    }
}

/* (37)-(44): the factors of component k, from sums of r, r d, r d d, where d = x - m of the prior. */
static void update_component(const struct paper_vb_factors *prior, int k, const double *x, int n,
                             const double *r1, struct paper_vb_factors *q)
{
    double S0 = 0.0, S1 = 0.0, S2 = 0.0;
    for (int i = 0; i < n; i++) {
        const double r = share(r1[i], k);
        const double d = x[i] - prior->m[k];
        S0 += r; /* (43) */
        S1 += r * d;
        S2 += r * d * d; /* (44) */
    }
    q->beta[k] = prior->beta[k] + S0;                          /* (39) */
    q->m[k] = prior->m[k] + S1 / q->beta[k];                   /* (40) */
    q->W_inv[k] = prior->W_inv[k] + S2 - S1 * S1 / q->beta[k]; /* (42) */
    q->nu[k] = prior->nu[k] + S0;                              /* (41) */
    q->alpha[k] = prior->alpha[k] + S0;
}

/* Part of the drives in the bound: sum of r (log rho - log r). */
static double drives_part(const struct paper_vb_factors *q, const double peak[2], const double *x,
                          int n, const double *r1)
{
    double sum = indicator_entropy(r1, n);
    for (int i = 0; i < n; i++) {
        for (int k = 0; k < 2; k++) {
            const double d = x[i] - q->m[k];
            const double r = share(r1[i], k);
            if (r > 0.0) /* 0 times infinity does not count */
                sum += r * (peak[k] - 0.5 * q->nu[k] / q->W_inv[k] * d * d);
        }
    }
    return sum;
}

/* Add the Kullback-Leibler divergence of q(mu_k, Lambda_k) from its prior p to `sum`. */
static double add_component_divergence(double sum, const struct paper_vb_factors *q,
                                       const struct paper_vb_factors *p, int k)
{
    const double step = q->m[k] - p->m[k];
    const double ratio = p->beta[k] / q->beta[k];
    const double log_W_inv = elementary_log(q->W_inv[k]);
    const double log_W_inv_prior = elementary_log(p->W_inv[k]);
    sum += 0.5 * (ratio - 1.0 - elementary_log(ratio));
    sum += 0.5 * p->beta[k] * q->nu[k] / q->W_inv[k] * step * step;
    sum += 0.5 * (q->nu[k] - p->nu[k]) * (digamma(0.5 * q->nu[k]) - log_W_inv);
    sum += 0.5 * q->nu[k] * (p->W_inv[k] / q->W_inv[k] - 1.0);
    sum += 0.5 * (q->nu[k] * log_W_inv - p->nu[k] * log_W_inv_prior);
    return sum + (elementary_log_gamma(0.5 * p->nu[k]) - elementary_log_gamma(0.5 * q->nu[k]));
}

/* (18): the lower bound. */
static double lower_bound(const struct paper_vb_factors *q, const struct paper_vb_factors *prior,
                          const double peak[2], const double *x, int n, const double *r1)
{
    double divergence = beta_divergence(q->alpha, prior->alpha);
    for (int k = 0; k < 2; k++)
        divergence = add_component_divergence(divergence, q, prior, k);
    return drives_part(q, peak, x, n, r1) - divergence;
}

int paper_vb_infer(const struct paper_vb_factors *prior, int iterations, double tolerance,
                   const double *x, int n, struct paper_vb_factors *q, double *r1,
                   struct paper_vb_bound *bound)
{
    double peak[2], before = 0.0;
    *q = *prior;
    log_rho_peaks(q, peak);
    for (int s = 0; s < iterations; s++) {
        update_indicators(q, peak, x, n, r1);
        bound[s].indicated = lower_bound(q, prior, peak, x, n, r1);
        if (s == 0)
            before = bound[0].indicated;
        for (int k = 0; k < 2; k++)
            update_component(prior, k, x, n, r1, q);
        log_rho_peaks(q, peak);
        const double after = lower_bound(q, prior, peak, x, n, r1);
        bound[s].updated = after;
        if (tolerance >= 0.0 && !(after - before >= tolerance * fabs(after))) {
            for (int j = s + 1; j < iterations; j++)
                bound[j] = (struct paper_vb_bound){after, after};
            return s + 1;
        }
        before = after;
    }
    return iterations;
}
