/* Load of each drive while it adheres: learnt slowly, never during a loss.
 *
 * Healthy drives have lasting differences (wheel diameter, axle load, magnets off the data sheet),
 * all of which scale with the load: a ratio. A scalar Kalman filter per drive learns it,
 *
 *     x_i = rho_i m + e_i,    rho_i ~ N(1, RATIO_SIGMA^2) at the start,    e_i ~ N(0, s^2)
 *
 * with m the load that adhering drives share. The spread s is learnt from the remainder. Not in
 * paper `adhesion`, whose drives are equal and whose thresholds are constants.
 *
 * Nothing here can fail: ratios stay within RATIO_LIMIT of 1, the caller gives no share below a
 * tenth, spreads have a floor, and roots are taken of a sum of squares.
 * A load that is NaN fits no model and is not learnt from. */
#include "estimators/detect/load_reference.h"

#include <math.h>

#include "estimators/numbers.h"

#define RATIO_SIGMA  0.06 /* standard deviation of the ratios before anything is known */
#define RATIO_LIMIT  0.2  /* a larger difference is a loss */
#define RATIO_TAU_S  30.0 /* time constant of learning in the long run: slow against any loss */
#define EVERY_S      0.05 /* LEARN_PERIOD_S */
#define SPREAD_TAU_S 0.7  /* time constant of the spread */
#define SPREAD_FLOOR 0.6  /* least spread, as a share of the configured one */
#define SPREAD_MOST  8.0  /* largest spread, as a multiple of the configured one */
#define STEP_CLIP    4.0  /* limit of one step, in spreads: the edge of a loss is not spread */
#define NOT_WHITE 2.0 /* errors outlast what the spread implies: an offset turns with the rotor */
#define GATE      4.0 /* standard deviations beyond which an observation does not fit the model */
#define LEAST_COMMON 0.1 /* common load below which ratios are not learnt */

const double LEARN_PERIOD_S = EVERY_S;

void load_reference_reset(struct load_spread *all, struct load_ratio *drives, int n, double spread)
{
    *all = (struct load_spread){.spread = spread, .configured = spread};
    for (int i = 0; i < n; i++)
        drives[i] = (struct load_ratio){.ratio = 1.0, .variance = RATIO_SIGMA * RATIO_SIGMA};
}

double normalise_load(const struct load_ratio *drive, double load, double share)
{
    return load / drive->ratio / share;
}

double normalised_sigma(const struct load_spread *all, const struct load_ratio *drive, double load,
                        double share, double transient)
{
    const double relative = drive->variance + transient * transient;
    return sqrt(all->spread * all->spread + relative * load * load) / share;
}

void update_spread(struct load_spread *all, struct load_ratio *drives,
                   const struct load_observation *observed, int n, int relative)
{
    /* The change from one observation to the next is noise: a loss has two edges and no more, and
     * lasting differences cancel. So this needs no verdict, and no verdict can stop it. */
    const double most = STEP_CLIP * all->spread;
    double total = 0.0;
    int count = 0;
    for (int i = 0; i < n; i++) {
        struct load_ratio *drive = &drives[i];
        if (!observed[i].known)
            continue;
        const double residual = observed[i].load / drive->ratio - observed[i].common;
        if (drive->seen) {
            const double step = clamp(residual - drive->residual, -most, most);
            total += step * step;
            count++;
        }
        drive->residual = residual;
        drive->seen = 1;
    }
    const int free = count - (relative ? 1 : 0);
    if (free < 1)
        return;
    double variance = all->spread * all->spread;
    variance += EVERY_S / SPREAD_TAU_S * (0.5 * total / free - variance);
    all->spread =
        clamp(sqrt(variance), SPREAD_FLOOR * all->configured, SPREAD_MOST * all->configured);
}

/* 1 if an observation of a healthy drive gives information about its ratio. */
static int fits(const struct load_ratio *drive, const struct load_observation *one, double noise)
{
    const double m = one->common;
    const double beside = one->load - drive->ratio * m;
    const double variance = drive->variance * m * m + noise;
    return fabs(m) >= LEAST_COMMON && beside * beside <= GATE * GATE * variance;
}

/* Kalman filter of one ratio; |common| is at least LEAST_COMMON. In the long run the ratio may drift:
 * the variance is that which keeps the filter at RATIO_TAU_S. */
static void filter_ratio(struct load_ratio *drive, const struct load_observation *one, double noise)
{
    const double m = one->common;
    const double drift = EVERY_S / RATIO_TAU_S * (EVERY_S / RATIO_TAU_S);
    const double variance = drive->variance + noise / (m * m) * drift;
    const double gain = variance * m / (variance * m * m + noise);
    drive->ratio += gain * (one->load - drive->ratio * m);
    drive->variance = (1.0 - gain * m) * variance;
}

void update_ratios(const struct load_spread *all, struct load_ratio *drives,
                   const struct load_observation *observed, int n, int relative)
{
    const double noise = NOT_WHITE * all->spread * all->spread;
    int count = 0;
    for (int i = 0; i < n; i++) {
        drives[i].taught = observed[i].healthy && fits(&drives[i], &observed[i], noise);
        count += drives[i].taught;
    }
    if (count < (relative ? 2 : 1))
        return;
    double total = 0.0;
    for (int i = 0; i < n; i++) {
        if (!drives[i].taught)
            continue;
        filter_ratio(&drives[i], &observed[i], noise);
        total += drives[i].ratio;
    }
    for (int i = 0; i < n; i++) {
        if (relative && drives[i].taught)
            drives[i].ratio *= count / total;
        drives[i].ratio = clamp(drives[i].ratio, 1.0 - RATIO_LIMIT, 1.0 + RATIO_LIMIT);
    }
}
