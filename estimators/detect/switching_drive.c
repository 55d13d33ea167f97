/* One drive under one hypothesis: docs/switching.md, equations (S1) to (S12).
 *
 * Nothing here can fail. `noise` is at least the square of NOISE_LEAST (switching_noise.c), and
 * every variance that is a divisor contains it; ratios are within 1.5 R_MOST of 1; the sum of the
 * origins has a floor, and so has v_c; |m| is compared with LEAST_SHARED before it divides.
 * Arguments of roots are sums of such variances. */
#include "estimators/detect/switching_drive.h"

#include <math.h>

#include "estimators/numbers.h"

#define SIMD_WIDTH 2 /* of any x86-64 and AArch64 */
#include "estimators/elementary_lanes.h"
#include "estimators/lanes.h"

#define TWO_PI 6.283185307179586

#define RATIO_SD            0.065 /* standard deviation of lasting differences between drives */
#define CURVE_SD            0.02  /* and of temporary ones */
#define CURVE_S             3.0   /* time constant of these */
#define U_MOST              0.05 /* largest such difference: a loss that grows slowly is no curve */
#define TAIL                0.002 /* share of loads whose error is WIDE times larger */
#define WIDE                5.0
#define SHARE_MOST          0.9   /* a lost drive carries at most this share of its earlier load */
#define SHARE_STEP_SD       0.015 /* change of its share in a step, standard deviation */
#define SHARE_NEW           0.02  /* probability per step of any other share */
#define SHARE_VARIANCE_MOST 0.1
#define GRIP                0.04 /* probability per step that a lost drive grips again */
#define OUT                 0.01 /* probability per step that a load becomes meaningful again */
#define OUT_ADHERING        0.7
#define NOT_WHITE    3.0  /* errors last: factor on the variance from which the ratios are learnt */
#define STEP_CLIP    3.0  /* largest error that ratios are learnt from, in standard deviations */
#define LEAST_DEMAND 0.05 /* with less, ratios are not learnt */
#define SURE_DEMAND  0.01 /* variance of the demand from which on ratios are not learnt */
#define LEAST_SHARED 0.02 /* demand below which shares are not learnt */
#define LEAST_WIDTH  0.01 /* demand below which the load of a lost drive may have either sign */
#define LEAST_C      0.1  /* a lost drive may carry this share against the train */
#define MOST_C       5.0  /* a larger share, of either sign, is not possible */
#define LEAST_V      1e-8
#define LEAST_P      1e-9

struct switching_drive switching_drive_unknown(void)
{
    const struct switching_ratio ratio = {
        .r = 1.0, .v_rr = RATIO_SD * RATIO_SD, .v_uu = CURVE_SD * CURVE_SD};
    return (struct switching_drive){
        .adhering = 0.97,
        .lost = 0.03,
        .neither = 1e-6,
        .c = 0.5 * SHARE_MOST,
        .v_c = SHARE_MOST * SHARE_MOST / 12.0,
        .now = ratio,
        .before = ratio,
    };
}

double ratio_of(const struct switching_ratio *q)
{
    return q->r + q->u;
}

double ratio_variance(const struct switching_ratio *q)
{
    return larger(q->v_rr + 2.0 * q->v_ru + q->v_uu, 0.0);
}

struct switching_ratio mix_ratios(const struct switching_ratio *a, double w_a,
                                  const struct switching_ratio *b, double w_b)
{
    if (!(w_a + w_b > 1e-300))
        return *a;
    const double w = w_a / (w_a + w_b), z = 1.0 - w;
    const double r = w * a->r + z * b->r, u = w * a->u + z * b->u;
    return (struct switching_ratio){
        .r = r,
        .u = u,
        .v_rr = w * (a->v_rr + square(a->r - r)) + z * (b->v_rr + square(b->r - r)),
        .v_ru = w * (a->v_ru + (a->r - r) * (a->u - u)) + z * (b->v_ru + (b->r - r) * (b->u - u)),
        .v_uu = w * (a->v_uu + square(a->u - u)) + z * (b->v_uu + square(b->u - u)),
    };
}

/* Densities of normal distributions; v above 0. */
static vec normal(vec e, vec v)
{
    return exp_lanes(-0.5 * e * e / v) / square_root(TWO_PI * v);
}

/* Normal distribution functions, to 0.01: the logistic function. */
static vec logistic(vec x)
{
    const vec z = -1.702 * x;
    return 1.0 / (1.0 + exp_lanes(select(z > HIGHEST, broadcast(HIGHEST), z)));
}

/* Probability that the earlier share is one that a lost drive may carry. */
static double less_than_all(const struct switching_drive *d)
{
    const double sd = sqrt(d->v_c), most = SHARE_MOST * ratio_of(&d->before);
    const vec p = logistic((vec){most - d->c, d->c + LEAST_C} / sd);
    return p[0] * p[1];
}

/* (S2): u decays, r does not. */
static void fade(struct switching_ratio *q)
{
    const double kept = 1.0 - STEP_S / CURVE_S;
    q->u *= kept;
    q->v_ru *= kept;
    q->v_uu = kept * kept * q->v_uu + CURVE_SD * CURVE_SD * (1.0 - kept * kept);
}

void switching_drive_predict(struct switching_drive *d, double begin)
{
    const double a = d->adhering, l = d->lost, x = d->neither;
    const double keeps = a * (1.0 - begin - STRAY);
    const double stays = l * (1.0 - GRIP - STRAY);
    const double begins = a * begin + (1.0 - OUT_ADHERING) * OUT * x;
    const double other = x * (1.0 - OUT) + STRAY * l;
    const struct switching_ratio now = mix_ratios(&d->now, keeps, &d->before, l * GRIP + OUT * x);
    d->before = mix_ratios(&d->before, stays + other, &d->now, a * (begin + STRAY));
    d->now = now;
    fade(&d->now);
    fade(&d->before);
    /* (S3) */
    d->adhering = keeps + l * GRIP + OUT_ADHERING * OUT * x;
    d->lost = stays + begins;
    d->neither = other + STRAY * a;
    /* (S4) */
    d->fresh_neither =
        d->neither > 1e-300 ? (STRAY * (a + l) + SHARE_NEW * (1.0 - OUT) * x) / d->neither : 1.0;
    d->fresh = d->lost > 1e-300 ? (begins + SHARE_NEW * stays) / d->lost : 1.0;
    d->v_c = smaller(d->v_c + SHARE_STEP_SD * SHARE_STEP_SD, SHARE_VARIANCE_MOST);
    d->less = less_than_all(d);
}

/* (S7): any share of the demand up to SHARE_MOST, and noise. */
static double any_share(const struct switching_drive *d, double y, double noise, struct gaussian g)
{
    const double most = SHARE_MOST * ratio_of(&d->before);
    const double low = most * smaller(g.m, -LEAST_WIDTH);
    const double high = most * larger(g.m, LEAST_WIDTH);
    const double sd = sqrt(noise + most * most * g.v / 3.0);
    const vec p = logistic((y - (vec){low, high}) / sd);
    return (p[0] - p[1]) / (high - low);
}

struct origins switching_drive_explain(const struct switching_drive *d, double y, double noise,
                                       struct gaussian g)
{
    const double rho = ratio_of(&d->now), m2 = g.m * g.m;
    const double v_a = rho * rho * g.v + ratio_variance(&d->now) * m2 + noise; /* (S5) */
    const double v_o = v_a + (WIDE * WIDE - 1.0) * noise;
    const double v_l = d->c * d->c * g.v + d->v_c * m2 + noise; /* (S6) */
    const double e = y - rho * g.m;
    const vec near = normal(broadcast(e), (vec){v_a, v_o});
    const double held = normal(broadcast(y - d->c * g.m), broadcast(v_l))[0];
    struct origins p;
    p.adhering = d->adhering * (1.0 - TAIL) * near[0];
    p.outlier = d->adhering * TAIL * near[1];
    p.held = d->lost * (1.0 - d->fresh) * held * d->less;
    p.fresh = d->lost > 1e-14 ? d->lost * d->fresh * any_share(d, y, noise, g) : 0.0;
    p.steady = d->neither * (1.0 - d->fresh_neither) * held * (1.0 - d->less); /* (S8) */
    p.neither = d->neither * d->fresh_neither / SPAN;
    p.all = p.adhering + p.outlier + p.held + p.fresh + p.steady + p.neither;
    p.all = larger(p.all, 1e-300);
    return p;
}

/* Kalman step of the demand: y = h m + e, e ~ N(0, v). */
static struct gaussian kalman(struct gaussian g, double h, double y, double v)
{
    const double k = g.v * h / (h * h * g.v + v);
    return (struct gaussian){g.m + k * (y - h * g.m), g.v * (1.0 - k * h)};
}

struct gaussian switching_drive_absorb(const struct switching_drive *d, double y, double noise,
                                       struct gaussian g, const struct origins *from)
{
    const double rho = ratio_of(&d->now), own = ratio_variance(&d->now) * g.m * g.m;
    const struct gaussian part[] = {
        kalman(g, rho, y, own + noise),
        kalman(g, rho, y, own + WIDE * WIDE * noise),
        kalman(g, d->c, y, d->v_c * g.m * g.m + noise),
        g,
    };
    const double weight[] = {
        from->adhering / from->all,
        from->outlier / from->all,
        (from->held + from->steady) / from->all,
        (from->fresh + from->neither) / from->all,
    };
    struct gaussian out = {0.0, 0.0};
    for (int k = 0; k < 4; k++)
        out.m += weight[k] * part[k].m;
    for (int k = 0; k < 4; k++)
        out.v += weight[k] * (part[k].v + square(part[k].m - out.m));
    out.v = larger(out.v, LEAST_V);
    return out;
}

/* (S10): the share of a drive that does not adhere. */
static void update_share(struct switching_drive *d, double y, double noise, struct gaussian g,
                         const struct origins *from)
{
    const double known = from->held + from->steady;
    const double gone = known + from->fresh + from->neither;
    if (!(gone > 1e-12 * from->all) || fabs(g.m) < LEAST_SHARED)
        return;
    const double m2 = g.m * g.m, most = SHARE_MOST * ratio_of(&d->before);
    const double k = d->v_c * g.m / (d->v_c * m2 + d->c * d->c * g.v + noise);
    const double share = clamp(y / g.m, -MOST_C, MOST_C);
    const double mean[] = {d->c + k * (y - d->c * g.m), clamp(share, 0.0, most), share};
    const double v_any = smaller((noise + share * share * g.v) / m2, SHARE_VARIANCE_MOST);
    const double v[] = {(1.0 - k * g.m) * d->v_c, v_any, v_any};
    const double weight[] = {known / gone, from->fresh / gone, from->neither / gone};
    double c = 0.0, v_c = 0.0;
    for (int j = 0; j < 3; j++)
        c += weight[j] * mean[j];
    for (int j = 0; j < 3; j++)
        v_c += weight[j] * (v[j] + square(mean[j] - c));
    d->c = c;
    d->v_c = clamp(v_c, 1e-6, SHARE_VARIANCE_MOST);
}

/* (S11): Kalman step of r and u, as if the drive adhered. */
static void update_ratio(struct switching_ratio *q, double y, double noise, struct gaussian g)
{
    if (fabs(g.m) < LEAST_DEMAND || !(g.v < SURE_DEMAND))
        return;
    const double rho = ratio_of(q), own = ratio_variance(q) * g.m * g.m;
    const double other = rho * rho * g.v + noise;
    const double h_r = (q->v_rr + q->v_ru) * g.m, h_u = (q->v_ru + q->v_uu) * g.m;
    const double k_r = h_r / (own + NOT_WHITE * other), k_u = h_u / (own + NOT_WHITE * other);
    const double most = STEP_CLIP * sqrt(own + other);
    const double e = clamp(y - rho * g.m, -most, most);
    q->r = clamp(q->r + k_r * e, 1.0 - R_MOST, 1.0 + R_MOST);
    q->u = clamp(q->u + k_u * e, -U_MOST, U_MOST);
    q->v_rr = larger(q->v_rr - k_r * h_r, 1e-6);
    q->v_ru = q->v_ru - k_r * h_u;
    q->v_uu = larger(q->v_uu - k_u * h_u, 1e-7);
}

void switching_drive_update(struct switching_drive *d, double y, double noise, struct gaussian g,
                            const struct origins *from, int unsure)
{
    update_share(d, y, noise, g, from);
    if (!unsure)
        update_ratio(&d->now, y, noise, g);
    /* (S9) */
    d->adhering = (from->adhering + from->outlier) / from->all;
    d->lost = (from->held + from->fresh) / from->all;
    d->neither = larger((from->steady + from->neither) / from->all, LEAST_P);
}
