/* Variational Bayes over the loads of all drives: paper `adhesion`, section 4.2, eq. (21)-(47).
 *
 * Two components, 0 adhering and 1 lost, each with a normal-Wishart prior. In one dimension, as
 * here, the Wishart is a gamma with a = nu/2, b = 1/(2 W). The misprints of the paper are
 * corrected: one m per component in (27)-(28); weights 1 - E[I] and E[I] in (36), (43), (44);
 * E[log(1 - pi)] = psi(alpha_0) - psi(alpha_0 + alpha_1), which is missing at (45). Its priors are
 * not the paper's: docs/adr/0004-detector-priors.md.
 *
 * The mean of component 0 is started at the load of every drive in turn, and the start with the
 * highest lower bound (18) is used: a majority of slipping drives does not define what is normal.
 * Starts do the same arithmetic, so two of them are computed at once, one per lane.
 *
 * Nothing here can fail. Divisors and arguments of logarithms are sums of a positive prior and of
 * numbers that are not negative; if one of them were zero or NaN, the result would be NaN: a bound
 * that is NaN is never the highest, and NaN is no valid probability for the flags. */
#include "estimators/detect/variational.h"

#include <math.h>
#include <stddef.h>

#include "estimators/elementary.h"
#include "estimators/order_statistics.h"

#define SIMD_WIDTH 2 /* of any x86-64 and AArch64 */
#include "estimators/elementary_lanes.h"
#include "estimators/lanes.h"

/* Prior of one component. */
struct prior {
    vec b;                    /* rate of the gamma of Lambda_k */
    vec m;                    /* mean of mu_k */
    double a, beta;           /* shape of that gamma; weight of m, in drives */
    double alpha;             /* weight of the component, in drives */
    int a_steps, alpha_steps; /* `steps_to_ten` of a and alpha, and so of those of the posterior */
};

/* Posterior factors of one component. */
struct component {
    vec a, b;     /* Lambda_k: gamma of shape a and rate b, (41), (42) */
    vec m;        /* mean of mu_k, (40) */
    vec beta_inv; /* 1 / beta_k, (39) */
    vec alpha;    /* weight of the component, in drives */
    vec n;        /* N_k, (43) */
};

/* Result of a start. */
struct solution {
    vec m;     /* mean of component 0 */
    vec bound; /* lower bound (18), without what all starts have in common */
};

double digamma(double x)
{
    if (!(x > 0.0))
        return NAN;
    const struct psi psi = psi_lanes(broadcast(x), steps_to_ten(x));
    return psi.part[0] + elementary_log(psi.whole[0]);
}

/* Priors of both components if an adhering drive carries `anchor`: adhering drives agree to
 * within `variance`; a lost drive carries anything between nothing and all: mean and variance of a
 * uniform distribution. */
static void priors_at(const struct vb_priors *given, vec anchor, double variance,
                      struct prior prior[2])
{
    const double a = 0.5 * given->nu;
    const int a_steps = steps_to_ten(a);
    prior[0] = (struct prior){
        .a = a,
        .beta = given->beta_adhering,
        .alpha = given->alpha_adhering,
        .b = broadcast(a * variance),
        .m = anchor,
        .a_steps = a_steps,
        .alpha_steps = steps_to_ten(given->alpha_adhering),
    };
    prior[1] = (struct prior){
        .a = a,
        .beta = given->beta_lost,
        .alpha = given->alpha_lost,
        .b = a * (variance + anchor * anchor / 12.0),
        .m = 0.5 * anchor,
        .a_steps = a_steps,
        .alpha_steps = steps_to_ten(given->alpha_lost),
    };
}

/* (32), (33) of component 1 less that of component 0, without the distances from their means. Only
 * one of the logarithms in (45) and (46) is left. */
static inline vec log_odds(const struct component q[2], const struct prior p[2])
{
    const struct psi pi_0 = psi_lanes(q[0].alpha, p[0].alpha_steps); /* (45) */
    const struct psi pi_1 = psi_lanes(q[1].alpha, p[1].alpha_steps);
    const struct psi lambda_0 = psi_lanes(q[0].a, p[0].a_steps); /* (46) */
    const struct psi lambda_1 = psi_lanes(q[1].a, p[1].a_steps);
    const vec pi = pi_1.whole / pi_0.whole;
    const vec lambda = lambda_1.whole * q[0].b / (lambda_0.whole * q[1].b);
    const vec parts = lambda_1.part - lambda_0.part - (q[1].beta_inv - q[0].beta_inv);
    return pi_1.part - pi_0.part + 0.5 * (parts + log_lanes(lambda * pi * pi));
}

/* (35): r1 (n,) = E[I]; N_k, and the weighted sums of the loads, (43), (44). */
static inline void expect_lost(struct component q[2], const struct prior p[2], const double *x,
                               int n, double *r1, vec sum[2])
{
    const vec base = log_odds(q, p);
    const vec lambda_0 = q[0].a / q[0].b, lambda_1 = q[1].a / q[1].b;
    sum[0] = sum[1] = q[1].n = broadcast(0.0);
    for (int i = 0; i < n; i++) {
        const vec d_0 = x[i] - q[0].m, d_1 = x[i] - q[1].m;
        const vec z = base - 0.5 * (lambda_1 * d_1 * d_1 - lambda_0 * d_0 * d_0); /* (47) */
        const vec odds = exp_lanes(-absolute(z));                                 /* 1 at most */
        const vec r = select(z >= 0.0, broadcast(1.0), odds) / (1.0 + odds);
        store_row(r1, i, r);
        q[1].n += r;
        sum[0] += (1.0 - r) * x[i];
        sum[1] += r * x[i];
    }
    q[0].n = n - q[1].n;
}

/* N_k S_k of (44): weighted squares around the weighted means. */
static inline void scatter(const double *x, const double *r1, int n, const vec mean[2], vec out[2])
{
    out[0] = out[1] = broadcast(0.0);
    for (int i = 0; i < n; i++) {
        const vec r = load_row(r1, i);
        const vec d_0 = x[i] - mean[0], d_1 = x[i] - mean[1];
        out[0] += (1.0 - r) * (d_0 * d_0);
        out[1] += r * (d_1 * d_1);
    }
}

/* (39)-(42) and the weight in (45), for N_k drives with this weighted mean and N_k S_k. */
static inline void update(struct component *q, const struct prior *p, vec mean, vec n_scatter)
{
    const vec off = mean - p->m;
    q->beta_inv = 1.0 / (p->beta + q->n);                /* (39) */
    q->m = (p->beta * p->m + q->n * mean) * q->beta_inv; /* (40) */
    q->a = p->a + 0.5 * q->n;                            /* (41) */
    const vec shift = p->beta * q->n * (off * off) * q->beta_inv;
    q->b = p->b + 0.5 * (n_scatter + shift); /* (42) */
    q->alpha = p->alpha + q->n;
}

static inline vec entropy(const double *r1, int n)
{
    vec sum = broadcast(0.0);
    for (int i = 0; i < n; i++) {
        const vec p = load_row(r1, i), q = 1.0 - p;
        sum -= p * log_lanes(at_least(p, 1e-300)) + q * log_lanes(at_least(q, 1e-300));
    }
    return sum;
}

/* Lower bound (18) right after `update`, without what all starts have in common: normalising
 * constants of the posterior over those of the prior. */
static inline vec lower_bound(const struct component q[2], const struct prior p[2],
                              const double *r1, int n)
{
    vec bound = entropy(r1, n);
    for (int k = 0; k < 2; k++) {
        bound += log_gamma_lanes(q[k].a, p[k].a_steps);
        bound += log_gamma_lanes(q[k].alpha, p[k].alpha_steps);
        bound += p[k].a * log_lanes(p[k].b) - q[k].a * log_lanes(q[k].b);
        bound += 0.5 * log_lanes(p[k].beta * q[k].beta_inv);
    }
    return bound;
}

/* All iterations of LANES starts: fills r1 (n, LANES), returns means of component 0 and bounds. */
static struct solution run_starts(const struct prior p[2], int iterations, const double *x, int n,
                                  double *r1)
{
    struct component q[2];
    for (int k = 0; k < 2; k++)
        q[k] = (struct component){
            .a = broadcast(p[k].a), .b = p[k].b, .m = p[k].m, .alpha = broadcast(p[k].alpha)};
    for (int j = 0; j < iterations; j++) {
        vec mean[2], n_scatter[2];
        expect_lost(q, p, x, n, r1, mean);
        for (int k = 0; k < 2; k++) /* A component without drives keeps the mean of its prior. */
            mean[k] = select(q[k].n > 1e-12, mean[k] / q[k].n, p[k].m);
        scatter(x, r1, n, mean, n_scatter);
        for (int k = 0; k < 2; k++)
            update(&q[k], &p[k], mean[k], n_scatter[k]);
    }
    return (struct solution){.m = q[0].m, .bound = lower_bound(q, p, r1, n)};
}

/* The best of all starts, of equal ones the first: fills r1 (n,), returns the mean of component 0.
 * Of more than VB_MAX_STARTS loads, so many are tried, evenly by rank. `workspace`: 3 n numbers. */
static double best_start(const struct vb_priors *priors, int iterations, const double *x, int n,
                         double variance, double *workspace, double *r1)
{
    double *trial = workspace, *anchors = workspace + (ptrdiff_t)LANES * n;
    const int starts = n < VB_MAX_STARTS ? n : VB_MAX_STARTS;
    double best = -INFINITY, common = 0.0;
    for (int i = 0; i < n; i++) {
        anchors[i] = x[i];
        r1[i] = 0.0;
        store_row(trial, i, broadcast(0.0));
    }
    if (n > VB_MAX_STARTS)
        sort_ascending(anchors, n);
    for (int first = 0; first < starts; first += LANES) {
        const int count = starts - first < LANES ? starts - first : LANES;
        vec anchor = broadcast(anchors[0]); /* also in the lanes that are not used */
        for (int k = 0; k < count; k++)
            anchor[k] = anchors[(2 * (first + k) + 1) * n / (2 * starts)]; /* below n */
        struct prior p[2];
        priors_at(priors, anchor, variance, p);
        const struct solution found = run_starts(p, iterations, x, n, trial);
        for (int k = 0; k < count; k++) {
            if (!(found.bound[k] > best))
                continue;
            best = found.bound[k];
            common = found.m[k];
            for (int i = 0; i < n; i++)
                r1[i] = load_row(trial, i)[k];
        }
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
    /* A drive that carries as much load as the others, or more, is not lost, however odd it is. */
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
