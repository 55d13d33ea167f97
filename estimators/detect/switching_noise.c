/* Errors of the loads: docs/switching.md, equations (S12), (S22) to (S24).
 *
 * There are two measures; the larger one counts. First, the variance of the errors of a drive that
 * adheres: white noise, without lasting errors. Second, the scatter of its load, in any state: a
 * load that is disturbed for long seems lost in every other step, and teaches no variance.
 *
 * Nothing here can fail: divisors are a variance with a floor, or the precision of the demand,
 * above LEAST_PRECISION; `at` stays below SWITCHING_PAST. */
#include "estimators/detect/switching_noise.h"

#include <math.h>

#include "estimators/detect/switching_drive.h"
#include "estimators/numbers.h"

#define NOISE_FIRST   0.02  /* standard deviation of the error of a load at the start, */
#define NOISE_LEAST   0.012 /* the least, and the most */
#define NOISE_MOST    0.2
#define NOISE_S       1.0 /* time constant of learning in the long run, */
#define NOISE_FIRST_S 0.1 /* and at first */
#define NOISE_CLIP    3.0 /* largest error that counts, in standard deviations */
#define LASTING_S     1.0 /* a lasting error is no noise: time constant of its mean */
#define SCATTER_FIRST 0.005
#define SCATTER_MOST  0.15
#define SCATTER_STEP  0.02 /* share by which the scatter falls in a step; */
#define SCATTER_RISE  2.0  /* it rises so many times faster: two of three changes are smaller */
#define SCATTER_SD                                                                                 \
    1.05 /* standard deviation that a scatter of 1 counts as: errors last for some steps */
#define LAG          0.15 /* extra noise for a demand that has moved by 1: not all follow at once */
#define LAG_KEPT     0.4
#define LEAST_DEMAND 0.05     /* with less, noise is not learnt */
#define LEAST_PRECISION 100.0 /* of a demand by all drives but one */

struct switching_noise switching_noise_unknown(void)
{
    return (struct switching_noise){.variance = NOISE_FIRST * NOISE_FIRST,
                                    .scatter = SCATTER_FIRST};
}

/* Variance of the error of load i if that of its noise is `variance`. */
static double with_noise(const struct switching *s, int i, double variance)
{
    const struct switching_load *in = &s->loads[i];
    return variance * square(1.0 + in->gain) + square(s->noises[i].lag) + square(in->error);
}

double switching_noise_of(const struct switching *s, int i)
{
    const struct switching_noise *noise = &s->noises[i];
    return with_noise(s, i, larger(noise->variance, square(SCATTER_SD * noise->scatter)));
}

/* Demand by all drives but i, by the likeliest hypothesis; variance 0 if they do not show it. */
static struct gaussian demand_without(const struct switching *s, int i)
{
    const struct switching_hypothesis *h = &s->hypotheses[0];
    const struct switching_drive *d = &s->drives[i];
    const double precision = 1.0 / h->v_mm - d->precision;
    if (!(precision > LEAST_PRECISION))
        return (struct gaussian){0.0, 0.0};
    return (struct gaussian){(h->m / h->v_mm - d->shift) / precision, 1.0 / precision};
}

/* (S12): learn the variance of drive i, which adheres. */
static void learn_variance(struct switching *s, int i, struct gaussian g, double e)
{
    const struct switching_ratio *q = &s->drives[i].now;
    struct switching_noise *noise = &s->noises[i];
    const double rho = ratio_of(q);
    const double v =
        ratio_variance(q) * g.m * g.m + rho * rho * g.v + with_noise(s, i, noise->variance);
    const double z = clamp(e / sqrt(v), -NOISE_CLIP, NOISE_CLIP);
    noise->lasting += STEP_S / LASTING_S * (z - noise->lasting) * s->adhering[i];
    const double z2 = smaller(square(z - noise->lasting), NOISE_CLIP * NOISE_CLIP);
    const double own = noise->variance * square(1.0 + s->loads[i].gain);
    noise->learnt_s += STEP_S;
    const double tau = clamp(noise->learnt_s, NOISE_FIRST_S, NOISE_S);
    const double step = 2.0 * STEP_S / tau * (own / v) * (z2 - 1.0) * s->adhering[i];
    noise->variance =
        clamp(noise->variance * (1.0 + step), NOISE_LEAST * NOISE_LEAST, NOISE_MOST * NOISE_MOST);
}

/* (S22), (S23): learn the scatter of drive i: change of its error e within SWITCHING_PAST steps. */
static void learn_scatter(struct switching_noise *noise, double e)
{
    if (noise->count == SWITCHING_PAST) {
        const double change = fabs(e - noise->past[noise->at]);
        const double step = change > noise->scatter ? SCATTER_RISE : -1.0;
        noise->scatter =
            clamp(noise->scatter * (1.0 + step * SCATTER_STEP), SCATTER_FIRST, SCATTER_MOST);
    } else {
        noise->count++;
    }
    noise->past[noise->at] = e;
    noise->at = noise->at + 1 < SWITCHING_PAST ? noise->at + 1 : 0;
}

/* (S24). The noise of filters does not show that of the observer, nor the reverse; before any is
 * learnt, it is the estimate's own standard deviation. */
void switching_note_sources(struct switching *s)
{
    for (int i = 0; i < s->n; i++) {
        const struct switching_load *in = &s->loads[i];
        struct switching_noise *noise = &s->noises[i];
        if (!in->known)
            continue;
        if (in->source != noise->source) {
            noise->source = in->source;
            noise->learnt_s = noise->lasting = 0.0;
            noise->count = 0;
        }
        if (noise->learnt_s == 0.0) {
            const double variance = larger(noise->variance, square(in->sigma));
            noise->variance = smaller(variance, NOISE_MOST * NOISE_MOST);
        }
    }
}

void switching_learn_noises(struct switching *s)
{
    for (int i = 0; i < s->n; i++) {
        const struct switching_load *in = &s->loads[i];
        const struct gaussian g = demand_without(s, i);
        /* Only from loads that are what they seem. */
        if (!in->known || in->apart || in->unsure || in->error != 0.0 || g.v == 0.0) {
            s->noises[i].count = 0;
            continue;
        }
        const double e = in->load - ratio_of(&s->drives[i].now) * g.m;
        learn_scatter(&s->noises[i], e);
        if (s->adhering[i] >= 0.5 && fabs(g.m) >= LEAST_DEMAND)
            learn_variance(s, i, g, e);
    }
}

void switching_note_lag(struct switching *s, double moved)
{
    for (int i = 0; i < s->n; i++)
        s->noises[i].lag = larger(LAG_KEPT * s->noises[i].lag, LAG * moved);
}
