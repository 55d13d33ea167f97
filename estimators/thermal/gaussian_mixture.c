/* Gaussian mixtures of a scalar by expectation-maximisation: paper `thermal`, eq. (9)-(18).
 *
 * Corrections: (12)-(18) confuse the indices of sample and component; (15) is
 * alpha_i phi_i / sum_j alpha_j phi_j. The variance in (18) uses the new mean, and needs a floor, or a
 * component collapses onto one value. Components start at spread quantiles and are kept in order, so
 * that they are not exchanged.
 *
 * Nothing here can fail: variances are at least the floor, logarithms are of numbers above 0, the
 * likeliest component's density relative to its maximum is 1, so the sum over components is at
 * least 1, and a component is moved only if samples belong to it. */
#include "estimators/thermal/gaussian_mixture.h"

#include "estimators/elementary.h"

static const double LEAST_WEIGHT = 1e-300; /* gives a component without weight a logarithm */
static const double LEAST_COUNT = 1e-9;    /* least number of samples for a component to be moved */

/* Sums of one iteration for each component: (16)-(18). */
struct moments {
    double count[MIXTURE_MAX], first[MIXTURE_MAX], second[MIXTURE_MAX];
};

static double variance_of(const double *x, int count)
{
    double mean = 0.0, squares = 0.0;
    for (int s = 0; s < count; s++)
        mean += x[s];
    mean /= count;
    for (int s = 0; s < count; s++)
        squares += (x[s] - mean) * (x[s] - mean);
    return squares / count;
}

/* (15): responsibility of each component for the sample x; level: log alpha_i - log sigma_i. */
static void responsibilities(const struct mixture *mix, const double *level, int n, double x,
                             double *share)
{
    double best = -1e300, sum = 0.0;
    for (int i = 0; i < n; i++) {
        const double d = x - mix->mean[i];
        share[i] = level[i] - 0.5 * d * d / mix->variance[i];
        best = share[i] > best ? share[i] : best;
    }
    for (int i = 0; i < n; i++) {
        share[i] = share[i] != best ? elementary_exp(share[i] - best) : 1.0;
        sum += share[i];
    }
    for (int i = 0; i < n; i++)
        share[i] /= sum;
}

static void expectation(const struct mixture *mix, const double *x, int count, int n,
                        struct moments *sums)
{
    double level[MIXTURE_MAX], share[MIXTURE_MAX];
    *sums = (struct moments){0};
    for (int i = 0; i < n; i++) {
        const double weight = mix->weight[i] > LEAST_WEIGHT ? mix->weight[i] : LEAST_WEIGHT;
        level[i] = elementary_log(weight) - 0.5 * elementary_log(mix->variance[i]);
    }
    for (int s = 0; s < count; s++) {
        responsibilities(mix, level, n, x[s], share);
        for (int i = 0; i < n; i++) {
            sums->count[i] += share[i];
            sums->first[i] += share[i] * x[s];
            sums->second[i] += share[i] * x[s] * x[s];
        }
    }
}

static void maximisation(const struct moments *sums, int count, int n, double floor,
                         struct mixture *mix)
{
    for (int i = 0; i < n; i++) {
        mix->weight[i] = sums->count[i] / count;
        if (sums->count[i] <= LEAST_COUNT)
            continue;
        mix->mean[i] = sums->first[i] / sums->count[i];
        const double variance = sums->second[i] / sums->count[i] - mix->mean[i] * mix->mean[i];
        mix->variance[i] = variance > floor ? variance : floor;
    }
}

static void swap(double *one, double *other)
{
    const double kept = *one;
    *one = *other;
    *other = kept;
}

/* Sort the components by their means. */
static void sort_components(struct mixture *mix, int n)
{
    for (int i = 1; i < n; i++) {
        for (int k = i; k > 0 && mix->mean[k - 1] > mix->mean[k]; k--) {
            swap(&mix->weight[k - 1], &mix->weight[k]);
            swap(&mix->mean[k - 1], &mix->mean[k]);
            swap(&mix->variance[k - 1], &mix->variance[k]);
        }
    }
}

void mixture_fit(const double *x, const double *ascending, int count, int iterations, double floor,
                 int n, struct mixture *out)
{
    const double spread = variance_of(x, count);
    *out = (struct mixture){0};
    for (int i = 0; i < n; i++) {
        out->weight[i] = 1.0 / n;
        out->mean[i] = ascending[(2 * i + 1) * count / (2 * n)];
        out->variance[i] = spread > floor ? spread : floor;
    }
    struct moments sums;
    for (int k = 0; k < iterations; k++) {
        expectation(out, x, count, n, &sums);
        maximisation(&sums, count, n, floor, out);
    }
    sort_components(out, n);
}
