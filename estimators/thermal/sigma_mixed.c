/* Sigma-mixed unscented Kalman filter: paper `thermal`, Algorithm 1, eq. (19)-(21), (28).
 *
 * The three points of a motor are the state. After the prediction the sigma points of all three,
 * each less its usual distance from their mean, are pooled, and a mixture is fitted to the pool
 * (EM). Its mean is the mixed state, the common part of the prior.
 *
 * Corrections: weights W_i = 1/(2 (n + kappa)), i > 0, so that their sum is 1 for any kappa; the
 * columns of the square root; (28) is x+ = x- + K (y - y-hat): as printed it predicts twice.
 *
 * Nothing here can fail: n + kappa is above 0, a root is of at least LEAST_PIVOT, and a reading's
 * variance r above 0 is part of every divisor in the update. */
#include "estimators/thermal/sigma_mixed.h"

#include <math.h>

#include "estimators/order_statistics.h"
#include "estimators/thermal/gaussian_mixture.h"

#define N            THERMAL_POINTS
#define SIGMA_POINTS (2 * N + 1)
#define POOL         (SIGMA_POINTS * N)
#define ITERATIONS   10
static const double FLOOR = 1e-4;        /* K^2, least variance of a component */
static const double LEAST_PIVOT = 1e-12; /* K^2, least pivot of a Cholesky factor */

/* Mean and covariance of a motor's three points. */
struct belief {
    double x[N];    /* degC */
    double P[N][N]; /* K^2 */
};

struct sigma_points {
    double x[SIGMA_POINTS][N];
};

/* Lower factor L of scale * P, which is symmetric and positive definite. */
static void root(double scale, const struct belief *b, double L[N][N])
{
    for (int j = 0; j < N; j++) {
        double pivot = scale * b->P[j][j];
        for (int i = 0; i < j; i++) {
            pivot -= L[j][i] * L[j][i];
            L[i][j] = 0.0;
        }
        L[j][j] = sqrt(pivot > LEAST_PIVOT ? pivot : LEAST_PIVOT);
        for (int i = j + 1; i < N; i++) {
            double value = scale * b->P[i][j];
            for (int n = 0; n < j; n++)
                value -= L[i][n] * L[j][n];
            L[i][j] = value / L[j][j];
        }
    }
}

/* (19). */
static void draw(const struct belief *b, double kappa, struct sigma_points *out)
{
    double L[N][N];
    root(N + kappa, b, L);
    for (int p = 0; p < N; p++) {
        out->x[0][p] = b->x[p];
        for (int i = 0; i < N; i++) {
            out->x[1 + i][p] = b->x[p] + L[p][i];
            out->x[1 + N + i][p] = b->x[p] - L[p][i];
        }
    }
}

/* Mean and covariance of the sigma points. */
static void moments(double kappa, const struct sigma_points *points, struct belief *b)
{
    const double w0 = kappa / (N + kappa), w = 0.5 / (N + kappa);
    for (int p = 0; p < N; p++) {
        b->x[p] = w0 * points->x[0][p];
        for (int i = 1; i < SIGMA_POINTS; i++)
            b->x[p] += w * points->x[i][p];
    }
    for (int a = 0; a < N; a++) {
        for (int c = 0; c < N; c++) {
            double sum = w0 * (points->x[0][a] - b->x[a]) * (points->x[0][c] - b->x[c]);
            for (int i = 1; i < SIGMA_POINTS; i++)
                sum += w * (points->x[i][a] - b->x[a]) * (points->x[i][c] - b->x[c]);
            b->P[a][c] = sum;
        }
    }
}

/* Each point moves towards where its inputs drive it, which was `last` until now. */
static void predict(const struct sigma_mixed_config *config, const struct sigma_mixed_sample *now,
                    const double *last, struct belief *b)
{
    struct sigma_points points;
    draw(b, config->kappa, &points);
    for (int i = 0; i < SIGMA_POINTS; i++)
        for (int p = 0; p < N; p++)
            points.x[i][p] = now->settled[p] + now->keep[p] * (points.x[i][p] - last[p]) +
                             config->drift[p] * now->gap;
    moments(config->kappa, &points, b);
    for (int p = 0; p < N; p++)
        b->P[p][p] += config->q[p] * (1.0 - now->keep[p] * now->keep[p]);
}

/* (9)-(21): compute the mixed state; the common part of the prior moves towards it. */
static double mix(const struct sigma_mixed_config *config, struct belief *b)
{
    struct sigma_points points;
    double pool[POOL], ascending[POOL];
    draw(b, config->kappa, &points);
    for (int i = 0; i < SIGMA_POINTS; i++)
        for (int p = 0; p < N; p++)
            pool[N * i + p] = ascending[N * i + p] = points.x[i][p] - config->apart[p];
    sort_ascending(ascending, POOL);
    struct mixture mixture;
    mixture_fit(pool, ascending, POOL, ITERATIONS, FLOOR, N, &mixture);
    double common = 0.0, x = 0.0, apart = 0.0;
    for (int i = 0; i < N; i++) {
        common += config->weighted ? mixture.weight[i] * mixture.mean[i] : mixture.mean[i] / N;
        x += b->x[i];
        apart += config->apart[i];
    }
    const double mean = (x - apart) / N;
    for (int p = 0; p < N; p++)
        b->x[p] += config->mixing * (common - mean);
    return common;
}

/* (28) for the reading of one point: y = x_p + v, so that P_xy is a column of P. */
static void update(struct belief *b, int p, double y, double r)
{
    const double s = b->P[p][p] + r;
    const double nu = y - b->x[p];
    double column[N];
    for (int a = 0; a < N; a++)
        column[a] = b->P[a][p];
    for (int a = 0; a < N; a++) {
        b->x[a] += column[a] / s * nu;
        for (int c = 0; c < N; c++)
            b->P[a][c] -= column[a] * column[c] / s;
    }
}

void sigma_mixed_run(const struct sigma_mixed_config *config,
                     const struct sigma_mixed_sample *samples, int64_t count, double *state,
                     double *mixed)
{
    struct belief b = {0};
    for (int p = 0; p < N && count > 0; p++) {
        b.x[p] = isfinite(samples[0].y[p]) ? samples[0].y[p] : samples[0].settled[p];
        b.P[p][p] = config->r[p] + config->q[p];
    }
    for (int64_t k = 0; k < count; k++) {
        predict(config, &samples[k], samples[k > 0 ? k - 1 : 0].settled, &b);
        mixed[k] = mix(config, &b);
        for (int p = 0; p < N; p++)
            if (isfinite(samples[k].y[p]))
                update(&b, p, samples[k].y[p], config->r[p]);
        for (int p = 0; p < N; p++)
            state[k * N + p] = b.x[p];
    }
}
