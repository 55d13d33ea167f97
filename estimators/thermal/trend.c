/* Degradation: how fast a motor grows warmer than the others, a local linear trend (Harvey 1989).
 *
 * The level does a random walk, and so does the rate, slowly. What neither the thermal model nor
 * the other motors explain is observed. Jumps are not included: a level may step, a rate does not
 * (paper `thermal`, eq. (22)-(27), has both, offline).
 *
 * Nothing here can fail: the one divisor is a variance plus that of a reading, which is above 0. */
#include "estimators/thermal/trend.h"

#include <math.h>

#include "estimators/numbers.h"

static const double LEVEL_K = 0.2;    /* K, random walk of the level in an hour */
static const double RATE_K_H = 0.005; /* K/h, random walk of the rate in an hour */
/* K, error of a block's deviation: what varies over a quarter of an hour does not average out. */
static const double READING_K = 0.5;
static const double JUMP_K = 3.0; /* a larger error: the level follows at once, the rate never */
static const double FIRST_RATE_K_H = 1.0;
static const double ENOUGH_H = 1.0; /* h of readings after which a rate is known */
static const double SURE = 2.0;     /* standard deviations by which the rate must exceed 0 */

void trend_reset(struct trend *trend)
{
    *trend = (struct trend){
        .level_k = NAN,
        .cov = {{square(READING_K), 0.0}, {0.0, square(FIRST_RATE_K_H)}},
    };
}

/* x = F x; P = F P F' + Q, where F = [1 h; 0 1]. */
static void predict(struct trend *trend, double h)
{
    double (*P)[2] = trend->cov;
    trend->level_k += h * trend->rate_k_h;
    P[0][0] += h * P[1][0];
    P[0][1] += h * P[1][1];
    P[0][0] += h * P[0][1];
    P[1][0] += h * P[1][1];
    P[0][0] += square(LEVEL_K) * h;
    P[1][1] += square(RATE_K_H) * h;
}

/* x = x + k e; P = P - k H P, where H = [1 0]. */
static void update(struct trend *trend, double error)
{
    double (*P)[2] = trend->cov;
    const double S = P[0][0] + square(READING_K);
    const double k[2] = {P[0][0] / S, P[1][0] / S};
    const double HP[2] = {P[0][0], P[0][1]};
    trend->level_k += k[0] * error;
    trend->rate_k_h += k[1] * error;
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2; j++)
            P[i][j] -= k[i] * HP[j];
}

void trend_add(struct trend *trend, double deviation_k, double hours)
{
    const int seen = isfinite(deviation_k);
    if (seen && isnan(trend->level_k))
        trend->level_k = deviation_k;
    predict(trend, hours);
    if (!seen)
        return;
    const double error = deviation_k - trend->level_k;
    if (fabs(error) > JUMP_K)
        trend->level_k = deviation_k;
    else
        update(trend, error);
    trend->observed_h += hours;
}

double trend_rate_k_h(const struct trend *trend)
{
    return trend->observed_h < ENOUGH_H ? NAN : trend->rate_k_h;
}

double trend_sigma_k_h(const struct trend *trend)
{
    return trend->observed_h < ENOUGH_H ? NAN : sqrt(trend->cov[1][1]);
}

double trend_hours_to(const struct trend *trend, double limit_k)
{
    const double rate = trend_rate_k_h(trend), sigma = trend_sigma_k_h(trend);
    const int grows = rate > SURE * sigma && trend->level_k < limit_k; /* false with a NaN */
    return grows ? (limit_k - trend->level_k) / rate : NAN;
}
