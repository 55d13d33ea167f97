/* Update of one motor's filter by a block of readings: that of a Kalman filter, extended by
 * outlying blocks.
 *
 * Nothing here can fail: a pivot is at least the readings' variance, which is above 0, and the
 * likelier of two outcomes has density 1 relative to itself, so the logarithm is of at least 1. */
#include "estimators/thermal/imm_update.h"

#include <math.h>

#include "estimators/elementary.h"
#include "estimators/thermal/model.h"

enum { N = IMM_STATES, SIZE = N - 2, Q = THERMAL_POINTS };

static const double OUTLYING = 0.01; /* share of blocks that are outliers */

/* Readings of one block less those that a mode predicts, H x; all 0 without a reading. */
struct innovation {
    int seen[Q];       /* 1: there is a reading */
    double e[Q];       /* y - H x */
    double PH[N][Q];   /* P H' */
    double S[Q][Q];    /* H P H', without noise */
    double root[Q][Q]; /* lower Cholesky factor of S plus noise */
};

/* 1 if mode g means that sensor q is off: its reading includes the size. */
static int is_off(int g, int q)
{
    return g == 1 + IMM_HEATS + q;
}

static void innovate(int g, const double *y, const double *x, const double *P,
                     struct innovation *out)
{
    *out = (struct innovation){0};
    for (int q = 0; q < Q; q++) {
        out->seen[q] = isfinite(y[q]) != 0;
        if (!out->seen[q])
            continue;
        out->e[q] = y[q] - (x[THERMAL_SEEN[q]] + (is_off(g, q) ? x[SIZE] : 0.0));
        for (int i = 0; i < N; i++)
            out->PH[i][q] = P[i * N + THERMAL_SEEN[q]] + (is_off(g, q) ? P[i * N + SIZE] : 0.0);
    }
    for (int r = 0; r < Q; r++)
        for (int c = 0; c < Q && out->seen[r]; c++)
            out->S[r][c] = out->PH[THERMAL_SEEN[r]][c] + (is_off(g, r) ? out->PH[SIZE][c] : 0.0);
}

/* Factor S + variance * 1; returns the determinant for the readings that there are. */
static double factor(struct innovation *by, double variance)
{
    double determinant = 1.0;
    for (int j = 0; j < Q; j++) {
        double pivot = by->S[j][j] + variance;
        for (int k = 0; k < j; k++)
            pivot -= by->root[j][k] * by->root[j][k];
        pivot = pivot > variance ? pivot : variance;
        determinant *= by->seen[j] ? pivot : 1.0;
        by->root[j][j] = sqrt(pivot);
        for (int i = j + 1; i < Q; i++) {
            double sum = by->S[i][j];
            for (int k = 0; k < j; k++)
                sum -= by->root[i][k] * by->root[j][k];
            by->root[i][j] = sum / by->root[j][j];
        }
    }
    return determinant;
}

/* root^-1 b, in place. */
static void solve_lower(const struct innovation *by, double *b)
{
    for (int i = 0; i < Q; i++) {
        for (int k = 0; k < i; k++)
            b[i] -= by->root[i][k] * b[k];
        b[i] /= by->root[i][i];
    }
}

/* root'^-1 b, in place. */
static void solve_upper(const struct innovation *by, double *b)
{
    for (int i = Q - 1; i >= 0; i--) {
        for (int k = i + 1; k < Q; k++)
            b[i] -= by->root[k][i] * b[k];
        b[i] /= by->root[i][i];
    }
}

/* Log density of the innovation for this variance of the readings, up to a constant. */
static double log_density(struct innovation *by, double variance)
{
    double v[Q], sum = 0.0;
    const double determinant = factor(by, variance);
    for (int q = 0; q < Q; q++)
        v[q] = by->e[q];
    solve_lower(by, v);
    for (int q = 0; q < Q; q++)
        sum += v[q] * v[q];
    return -0.5 * sum - 0.5 * elementary_log(determinant);
}

/* Moments of the mixture of two outcomes: the block is normal, with probability p, or not. */
static void mix_outcomes(const struct innovation *by, double p, double *x, double *P)
{
    double gain[N][Q], moved[N];
    for (int i = 0; i < N; i++) {
        for (int q = 0; q < Q; q++)
            gain[i][q] = by->PH[i][q];
        solve_lower(by, gain[i]);
        solve_upper(by, gain[i]);
        moved[i] = 0.0;
        for (int q = 0; q < Q; q++)
            moved[i] += gain[i][q] * by->e[q];
        x[i] += p * moved[i];
    }
    for (int i = 0; i < N; i++) {
        for (int j = 0; j <= i; j++) {
            double less = 0.0;
            for (int q = 0; q < Q; q++)
                less += 0.5 * (gain[i][q] * by->PH[j][q] + gain[j][q] * by->PH[i][q]);
            const double before = 0.5 * (P[i * N + j] + P[j * N + i]);
            const double between = p * (1.0 - p) * moved[i] * moved[j];
            P[i * N + j] = P[j * N + i] = before - p * less + between;
        }
    }
}

double imm_update(int g, const double *y, double noise, double wide, double *x, double *P)
{
    struct innovation by;
    innovate(g, y, x, P, &by);
    if (!by.seen[0] && !by.seen[1] && !by.seen[2])
        return 0.0;
    const double variance = noise * noise;
    const double outlying = log_density(&by, variance + wide * wide) + elementary_log(OUTLYING);
    const double normal = log_density(&by, variance) + elementary_log(1.0 - OUTLYING);
    const double top = normal > outlying ? normal : outlying;
    const double both = elementary_exp(normal - top) + elementary_exp(outlying - top);
    const double total = top + elementary_log(both);
    mix_outcomes(&by, elementary_exp(normal - total), x, P);
    return total;
}
