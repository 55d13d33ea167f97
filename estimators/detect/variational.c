/* Variational Bayes over the loads of all drives: paper `adhesion`, section 4.2, eq. (21)-(47).
 *
 * Two components, 0 adhering and 1 lost, each with a normal-Wishart prior. Here it has one
 * dimension, so the Wishart is a gamma with a = nu/2, b = 1/(2 W). The misprints of the paper are
 * corrected: one m per component in (27)-(28); weights 1 - E[I] and E[I] in (36), (43), (44);
 * E[log(1 - pi)] = psi(alpha_0) - psi(alpha_0 + alpha_1), which is missing at (45). Its priors are
 * not the paper's: docs/adr/0004-detector-priors.md.
 *
 * The mean of component 0 is started at the load of every drive in turn, and the start with the
 * highest lower bound (18) wins: a majority of slipping drives does not decide what is normal.
 *
 * Nothing here can fail. Divisors and arguments of logarithms are sums of a positive prior and of
 * numbers that are not negative; were one of them zero or NaN, it would come to NaN, a bound that
 * is NaN never wins, and NaN is no probability for the flags. */
#include "estimators/detect/variational.h"

#include <math.h>

#include "estimators/elementary.h"

#define LOG_2PI 1.8378770664093453 /* log(2 pi) */

/* Prior of one component. */
struct prior {
    double a, b;  /* Lambda_k: gamma of shape a and rate b */
    double m;     /* mean of mu_k */
    double beta;  /* weight of m, in drives */
    double alpha; /* weight of the component, in drives */
};

/* Posterior factors of one component. */
struct component {
    double a, b;     /* Lambda_k: gamma of shape a and rate b, (41), (42) */
    double m;        /* mean of mu_k, (40) */
    double beta_inv; /* 1 / beta_k, (39) */
    double log_pi;   /* E[log pi_k], (45) */
    double n;        /* N_k, (43) */
};

/* What one start ends with. */
struct solution {
    double m;     /* mean of component 0 */
    double bound; /* lower bound (18) */
};

/* What is the same for every start. */
struct constants {
    double psi_total; /* psi of the weights of both components and of all drives */
    double log_gamma; /* log Gamma(a) of the priors */
    double log_beta;  /* log B(alpha_0, alpha_1) of the priors */
    double log_pi[2]; /* E[log pi_k] by the priors */
};

double digamma(double x)
{
    if (!(x > 0.0))
        return NAN;
    /* psi(x) = psi(x + 1) - 1/x, ten times at most; then the asymptotic series. */
    double shift = 0.0;
    while (x < 10.0) {
        shift -= 1.0 / x;
        x += 1.0;
    }
    const double y = 1.0 / (x * x);
    double series = 1.0 / 240.0 - y * (1.0 / 132.0);
    series = 1.0 / 252.0 - y * series;
    series = 1.0 / 120.0 - y * series;
    series = y * (1.0 / 12.0 - y * series);
    return shift + elementary_log(x) - 0.5 / x - series;
}

static double log_beta(double a, double b)
{
    return elementary_log_gamma(a) + elementary_log_gamma(b) - elementary_log_gamma(a + b);
}

static double square(double x)
{
    return x * x;
}

static double clamp(double x, double limit)
{
    if (x < -limit)
        return -limit;
    return x > limit ? limit : x;
}

static struct constants constants_of(const struct vb_priors *priors, int n)
{
    const double alpha_0 = priors->alpha_adhering;
    const double alpha_1 = priors->alpha_lost;
    const double psi_both = digamma(alpha_0 + alpha_1);
    return (struct constants){
        .psi_total = digamma(alpha_0 + alpha_1 + n),
        .log_gamma = elementary_log_gamma(0.5 * priors->nu),
        .log_beta = log_beta(alpha_0, alpha_1),
        .log_pi = {digamma(alpha_0) - psi_both, digamma(alpha_1) - psi_both},
    };
}

/* Priors of both components where an adhering drive carries `anchor`: adhering drives agree to
 * within `variance`; a lost one carries anything between nothing and all, mean and variance of a
 * uniform distribution. */
static void priors_at(const struct vb_priors *given, double anchor, double variance,
                      struct prior prior[2])
{
    const double a = 0.5 * given->nu;
    prior[0] = (struct prior){
        .a = a,
        .b = a * variance,
        .m = anchor,
        .beta = given->beta_adhering,
        .alpha = given->alpha_adhering,
    };
    prior[1] = (struct prior){
        .a = a,
        .b = a * (variance + anchor * anchor / 12.0),
        .m = 0.5 * anchor,
        .beta = given->beta_lost,
        .alpha = given->alpha_lost,
    };
}

/* (32), (33): expected log density of a load under component k, but for its distance from m_k. */
static double log_rho_base(const struct component *q)
{
    const double log_lambda = digamma(q->a) - elementary_log(q->b); /* (46) */
    return q->log_pi + 0.5 * log_lambda - 0.5 * q->beta_inv;
}

/* (35): r1 (n,) = E[I], and the weighted sums of the loads, (44). */
static void expect_lost(const struct component q[2], const double *x, int n, double *r1,
                        double sum[2])
{
    const double base = log_rho_base(&q[1]) - log_rho_base(&q[0]);
    const double lambda_0 = q[0].a / q[0].b;
    const double lambda_1 = q[1].a / q[1].b;
    sum[0] = sum[1] = 0.0;
    for (int i = 0; i < n; i++) {
        const double d_0 = x[i] - q[0].m;
        const double d_1 = x[i] - q[1].m;
        const double z = base - 0.5 * (lambda_1 * d_1 * d_1 - lambda_0 * d_0 * d_0); /* (47) */
        r1[i] = 1.0 / (1.0 + elementary_exp(-clamp(z, 700.0))); /* exp(700) is finite */
        sum[0] += (1.0 - r1[i]) * x[i];
        sum[1] += r1[i] * x[i];
    }
}

/* Sum of E[I]. */
static double count_lost(const double *r1, int n)
{
    double sum = 0.0;
    for (int i = 0; i < n; i++)
        sum += r1[i];
    return sum;
}

/* N_k S_k of (44): weighted squares around the weighted mean. */
static double scatter(int k, const double *x, const double *r1, int n, double mean)
{
    double sum = 0.0;
    for (int i = 0; i < n; i++)
        sum += (k == 0 ? 1.0 - r1[i] : r1[i]) * square(x[i] - mean);
    return sum;
}

/* (39)-(42), (45), of N_k drives with this weighted mean and N_k S_k. */
static void update(struct component *q, const struct prior *p, double mean, double n_scatter,
                   double psi_total)
{
    q->beta_inv = 1.0 / (p->beta + q->n);                /* (39) */
    q->m = (p->beta * p->m + q->n * mean) * q->beta_inv; /* (40) */
    q->a = p->a + 0.5 * q->n;                            /* (41) */
    const double shift = p->beta * q->n * square(mean - p->m) * q->beta_inv;
    q->b = p->b + 0.5 * (n_scatter + shift);          /* (42) */
    q->log_pi = digamma(p->alpha + q->n) - psi_total; /* (45) */
}

static double entropy(const double *r1, int n)
{
    double sum = 0.0;
    for (int i = 0; i < n; i++) {
        const double p = r1[i];
        const double q = 1.0 - p;
        sum -= p * elementary_log(fmax(p, 1e-300)) + q * elementary_log(fmax(q, 1e-300));
    }
    return sum;
}

/* Lower bound (18) right after `update`: ratios of normalising constants. */
static double lower_bound(const struct component q[2], const struct prior p[2],
                          const struct constants *c, const double *r1, int n)
{
    double bound = entropy(r1, n);
    for (int k = 0; k < 2; k++) {
        bound = bound + elementary_log_gamma(q[k].a) - c->log_gamma;
        bound = bound + p[k].a * elementary_log(p[k].b) - q[k].a * elementary_log(q[k].b);
        bound = bound + 0.5 * elementary_log(p[k].beta * q[k].beta_inv);
    }
    bound = bound + log_beta(p[0].alpha + q[0].n, p[1].alpha + q[1].n) - c->log_beta;
    return bound - 0.5 * n * LOG_2PI;
}

/* All iterations from one start: fills r1 (n,), gives mean of component 0 and lower bound. */
static struct solution run_start(const struct prior p[2], const struct constants *c, int iterations,
                                 const double *x, int n, double *r1)
{
    struct component q[2];
    for (int k = 0; k < 2; k++)
        q[k] = (struct component){.a = p[k].a, .b = p[k].b, .m = p[k].m, .log_pi = c->log_pi[k]};
    for (int j = 0; j < iterations; j++) {
        double sum[2];
        expect_lost(q, x, n, r1, sum);
        q[1].n = count_lost(r1, n); /* (43) */
        q[0].n = n - q[1].n;
        for (int k = 0; k < 2; k++) {
            /* No drive in a component: its mean stays that of the prior. */
            const double mean = q[k].n > 1e-12 ? sum[k] / q[k].n : p[k].m;
            update(&q[k], &p[k], mean, scatter(k, x, r1, n, mean), c->psi_total);
        }
    }
    return (struct solution){.m = q[0].m, .bound = lower_bound(q, p, c, r1, n)};
}

/* Ascending, by insertion. */
static void sort(double *x, int n)
{
    for (int i = 1; i < n; i++) {
        const double one = x[i];
        int j = i;
        for (; j > 0 && x[j - 1] > one; j--)
            x[j] = x[j - 1];
        x[j] = one;
    }
}

/* The best of all starts: fills r1 (n,), gives the mean of component 0. Ties keep the first. Of more
 * than VB_MAX_STARTS loads so many are tried, evenly by rank. `workspace` holds 2 n numbers. */
static double best_start(const struct vb_priors *priors, int iterations, const double *x, int n,
                         double variance, double *workspace, double *r1)
{
    double *trial = workspace, *anchors = workspace + n;
    const int starts = n < VB_MAX_STARTS ? n : VB_MAX_STARTS;
    const struct constants c = constants_of(priors, n);
    double best = -INFINITY, common = 0.0;
    for (int i = 0; i < n; i++) {
        anchors[i] = x[i];
        trial[i] = r1[i] = 0.0;
    }
    if (n > VB_MAX_STARTS)
        sort(anchors, n);
    for (int j = 0; j < starts; j++) {
        struct prior p[2];
        priors_at(priors, anchors[(2 * j + 1) * n / (2 * starts)], variance, p); /* below n */
        const struct solution one = run_start(p, &c, iterations, x, n, trial);
        if (!(one.bound > best))
            continue;
        best = one.bound;
        common = one.m;
        for (int i = 0; i < n; i++)
            r1[i] = trial[i];
    }
    return common;
}

double vb_detect(const struct vb_priors *priors, int iterations, const double *load,
                 const double *spread, const uint8_t *usable, int n, double *workspace,
                 double *lost)
{
    double *x = workspace, *r1 = x + n, *rest = r1 + n;
    double variance = 0.0;
    int m = 0;
    for (int i = 0; i < n; i++) {
        lost[i] = 0.0;
        if (!usable[i])
            continue;
        x[m++] = load[i];
        variance += spread[i] * spread[i];
    }
    if (m < 2)
        return 0.0;
    variance /= m;
    const double common = best_start(priors, iterations, x, m, variance, rest, r1);
    /* As much load as the others, or more, is no lost wheel, however odd it is. */
    const double sign = common >= 0.0 ? 1.0 : -1.0;
    const double least = sqrt(variance);
    for (int i = 0, k = 0; i < n; i++) {
        if (!usable[i])
            continue;
        if ((common - x[k]) * sign > least)
            lost[i] = r1[k];
        k++;
    }
    return common;
}
