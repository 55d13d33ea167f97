/* Variational message passing: paper `adhesion`, section 4.4, steps (i)-(vi) and eq. (49)-(51).
 *
 * One observed quantity (D = 1) at one tick; `message_passing.py` lists what is missing or
 * misprinted in the paper. Each node stores the parameters of its density, not its natural
 * parameters: mu_k normal (m, tau), Lambda_k gamma (a, b), pi beta (alpha), I_i Bernoulli (E[I_i]).
 *
 * Nothing here can fail. Divisors and arguments of logarithms are a positive prior plus numbers that
 * are not negative; with loads or priors that are NaN or overflow, E[I] becomes NaN, which is no
 * probability for the flags. Loops end after n drives and `iterations`. */
#include "estimators/detect/message_passing.h"

#include <math.h>

#include "estimators/detect/paper.h"
#include "estimators/detect/variational.h"
#include "estimators/elementary.h"
#include "estimators/numbers.h"

typedef struct message_passing_factors factors;

/* E[log Lambda_k]. */
static double expected_log_lambda(const factors *q, int k)
{
    return digamma(q->a[k]) - elementary_log(q->b[k]);
}

/* E[Lambda_k]. */
static double expected_lambda(const factors *q, int k)
{
    return q->a[k] / q->b[k];
}

/* E[(x - mu_k)^2]. */
static double expected_square(const factors *q, int k, double x)
{
    return square(x - q->m[k]) + 1.0 / q->tau[k];
}

/* E[log pi_k], where psi_total is digamma of both weights. */
static double expected_log_pi(const factors *q, int k, double psi_total)
{
    return digamma(q->alpha[k]) - psi_total;
}

/* Messages x_i -> I_i and pi -> I_i. */
static void update_indicators(const factors *q, const double *x, int n, double *r1)
{
    const double psi_total = digamma(q->alpha[0] + q->alpha[1]);
    const double lambda_0 = expected_lambda(q, 0);
    const double lambda_1 = expected_lambda(q, 1);
    const double level_0 = expected_log_pi(q, 0, psi_total) + 0.5 * expected_log_lambda(q, 0);
    const double level_1 = expected_log_pi(q, 1, psi_total) + 0.5 * expected_log_lambda(q, 1);
    for (int i = 0; i < n; i++) {
        const double e_0 = expected_square(q, 0, x[i]);
        const double e_1 = expected_square(q, 1, x[i]);
        r1[i] = indicator(level_1 - level_0 - 0.5 * (lambda_1 * e_1 - lambda_0 * e_0));
    }
}

/* Messages I_i -> pi. */
static void update_pi(const factors *prior, int k, const double *r1, int n, factors *q)
{
    double S0 = 0.0;
    for (int i = 0; i < n; i++)
        S0 += share(r1[i], k);
    q->alpha[k] = prior->alpha[k] + S0;
}

/* (i)-(iii): messages x_i -> mu_k. */
static void update_mu(const factors *prior, int k, const double *x, const double *r1, int n,
                      factors *q)
{
    double S0 = 0.0, S1 = 0.0;
    for (int i = 0; i < n; i++) {
        S0 += share(r1[i], k);
        S1 += share(r1[i], k) * x[i];
    }
    const double lambda = expected_lambda(q, k);
    q->tau[k] = prior->tau[k] + lambda * S0;
    q->m[k] = (prior->tau[k] * prior->m[k] + lambda * S1) / q->tau[k];
}

/* (iv)-(vi): messages x_i -> Lambda_k. */
static void update_lambda(const factors *prior, int k, const double *x, const double *r1, int n,
                          factors *q)
{
    double S0 = 0.0, S2 = 0.0;
    for (int i = 0; i < n; i++) {
        S0 += share(r1[i], k);
        S2 += share(r1[i], k) * expected_square(q, k, x[i]);
    }
    q->a[k] = prior->a[k] + 0.5 * S0;
    q->b[k] = prior->b[k] + 0.5 * S2;
}

/* Update a node by its messages. An invalid number of a node changes nothing. */
static void update_node(int node, const factors *prior, const double *x, int n, factors *q,
                        double *r1)
{
    if (node == NODE_I)
        update_indicators(q, x, n, r1);
    for (int k = 0; k < 2; k++) {
        if (node == NODE_PI)
            update_pi(prior, k, r1, n, q);
        if (node == NODE_MU)
            update_mu(prior, k, x, r1, n, q);
        if (node == NODE_LAMBDA)
            update_lambda(prior, k, x, r1, n, q);
    }
}

/* Subtract the Kullback-Leibler divergence of q(mu_k) q(Lambda_k) from their prior p from `sum`. */
static double subtract_divergence(double sum, const factors *q, const factors *p, int k)
{
    const double ratio = p->tau[k] / q->tau[k];
    const double step = q->m[k] - p->m[k];
    const double log_lambda = expected_log_lambda(q, k);
    const double lambda = expected_lambda(q, k);
    sum -= 0.5 * (ratio - 1.0 - elementary_log(ratio) + p->tau[k] * step * step);
    sum -= (q->a[k] - p->a[k]) * log_lambda - (q->b[k] - p->b[k]) * lambda;
    sum -= q->a[k] * elementary_log(q->b[k]) - p->a[k] * elementary_log(p->b[k]);
    return sum - (elementary_log_gamma(p->a[k]) - elementary_log_gamma(q->a[k]));
}

/* (51): the lower bound. */
static double lower_bound(const factors *prior, const factors *q, const double *x, int n,
                          const double *r1)
{
    const double psi_total = digamma(q->alpha[0] + q->alpha[1]);
    double sum = indicator_entropy(r1, n) - beta_divergence(q->alpha, prior->alpha);
    for (int k = 0; k < 2; k++) {
        const double log_pi = expected_log_pi(q, k, psi_total);
        const double level = log_pi + 0.5 * (expected_log_lambda(q, k) - LOG_2PI);
        const double lambda = expected_lambda(q, k);
        for (int i = 0; i < n; i++)
            sum += share(r1[i], k) * (level - 0.5 * lambda * expected_square(q, k, x[i]));
        sum = subtract_divergence(sum, q, prior, k);
    }
    return sum;
}

int message_passing_infer(const struct message_passing_factors *prior, const uint8_t *order,
                          int iterations, double tolerance, const double *x, int n,
                          struct message_passing_factors *q, double *r1)
{
    double before = 0.0;
    *q = *prior;
    for (int i = 0; i < n; i++)
        r1[i] = 0.5;
    for (int s = 0; s < iterations; s++) {
        for (int j = 0; j < 4; j++) {
            update_node(order[j], prior, x, n, q, r1);
            if (tolerance >= 0.0 && s == 0 && j == 0)
                before = lower_bound(prior, q, x, n, r1);
        }
        if (!(tolerance >= 0.0))
            continue;
        const double after = lower_bound(prior, q, x, n, r1);
        if (!(after - before >= tolerance * fabs(after)))
            return s + 1;
        before = after;
    }
    return iterations;
}
