/* Common parts of the paper's two variational detectors: paper `adhesion`, section 4.
 *
 * Nothing here can fail: the one divisor is at least 1, and a logarithm or a digamma of a number
 * that is not above 0 is infinite or NaN, which no comparison takes for a rise of the bound. */
#include "estimators/detect/paper.h"

#include "estimators/detect/variational.h"
#include "estimators/elementary.h"

double indicator(double z)
{
    return 1.0 / (1.0 + elementary_exp(-z));
}

double indicator_entropy(const double *r1, int n)
{
    double sum = 0.0;
    for (int i = 0; i < n; i++) {
        const double p = r1[i];
        if (p > 0.0 && p < 1.0)
            sum -= p * elementary_log(p) + (1.0 - p) * elementary_log(1.0 - p);
    }
    return sum;
}

double beta_divergence(const double *alpha, const double *prior)
{
    const double total = alpha[0] + alpha[1];
    const double psi_total = digamma(total);
    double sum = elementary_log_gamma(total) - elementary_log_gamma(prior[0] + prior[1]);
    for (int k = 0; k < 2; k++) {
        const double log_pi = digamma(alpha[k]) - psi_total; /* (45) */
        sum += elementary_log_gamma(prior[k]) - elementary_log_gamma(alpha[k]);
        sum += (alpha[k] - prior[k]) * log_pi;
    }
    return sum;
}
