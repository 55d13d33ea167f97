/* Losses of adhesion by the switching model: docs/switching.md, equations (S1) to (S24).
 *
 * Each drive adheres, has lost adhesion, or has a meaningless load; all share the demand of the
 * train, which walks, wobbles, turns and sometimes jumps. Given the demand the drives are
 * independent, so the posterior is a mixture of at most SWITCHING_KEPT hypotheses, each a demand
 * and N small filters. In a step each hypothesis proposes up to eight, which are weighed, merged if
 * they agree, and the likeliest are kept: the cost is linear in N. Not in paper `adhesion`.
 *
 * Nothing here can fail: divisors are a variance with a floor, a sum of probabilities that
 * has one, a ratio within 1.5 R_MOST of 1, or a count that is not 0; arguments of logarithms have
 * floors; known loads are finite. Indices are below SWITCHING_KEPT, SWITCHING_TRIED, n. */
#include "estimators/detect/switching.h"

#include <math.h>

#include "estimators/detect/switching_drive.h"
#include "estimators/detect/switching_mixture.h"
#include "estimators/detect/switching_noise.h"
#include "estimators/elementary.h"
#include "estimators/numbers.h"

#define STEP_SD         0.003 /* random walk of the demand in a step, standard deviation */
#define SLOPE_SD        0.003 /* random walk of its slope */
#define SLOPE_KEPT      0.9
#define MOVE_SD         0.04 /* standard deviation of a wobble, and of a turn: a change of slope */
#define MOVE            0.04 /* probability of either */
#define JUMP            0.02 /* probability that the demand jumps anywhere within SPAN */
#define EVENT           2e-4 /* probability that drives lose adhesion together, */
#define PART            0.3  /* each with this probability */
#define ALONE           1e-5 /* probability that one drive loses adhesion alone */
#define FULL_LOAD       0.25 /* demand from which on losses are as frequent as this */
#define HOPELESS        16.0 /* hypotheses whose logarithm is further below the best are left out */
#define UNKNOWN_V       0.01 /* variance of a demand that is not known */
#define ANEW_STEPS      50   /* steps for which most loads may be meaningless: 0.5 s */
#define LEAST_P         1e-12
#define LEAST_PRECISION 0.1 /* of a demand by all drives but one */
#define MOST_M          4.0

enum move { CALM, ONSETS, WOBBLE, TURN, MOVES };

/* Set the demand and the drives to nothing known. */
static void set_unknown(struct switching *s)
{
    s->kept = 1;
    s->contradicted = 0;
    s->hypotheses[0] = (struct switching_hypothesis){.v_mm = 1.0, .v_ss = 1e-4};
    for (int i = 0; i < s->n; i++)
        s->drives[i] = switching_drive_unknown();
}

void switching_reset(struct switching *s)
{
    s->ticks = 0;
    s->demand = 0.0;
    set_unknown(s);
    for (int i = 0; i < s->n; i++) {
        s->noises[i] = switching_noise_unknown();
        s->loads[i] = (struct switching_load){.load = 0.0};
        s->adhering[i] = s->drives[i].adhering;
        s->lost[i] = s->drives[i].lost;
    }
}

/* ---- One hypothesis and all loads ---- */

/* First sweep, (S13): the demand takes in the load of one drive after the other. */
static struct gaussian sweep_demand(const struct switching *s, struct switching_hypothesis *h,
                                    struct switching_drive *d, int anchor)
{
    struct gaussian g = {h->m, h->v_mm};
    for (int i = 0; i < s->n; i++) {
        d[i].precision = d[i].shift = 0.0;
        if (!s->loads[i].known || s->loads[i].apart || i == anchor)
            continue;
        const double y = s->loads[i].load, noise = switching_noise_of(s, i);
        const struct origins from = switching_drive_explain(&d[i], y, noise, g);
        const struct gaussian with = switching_drive_absorb(&d[i], y, noise, g, &from);
        h->log_weight += elementary_log(from.all);
        d[i].precision = larger(1.0 / with.v - 1.0 / g.v, 0.0);
        d[i].shift = d[i].precision > 0.0 ? with.m / with.v - g.m / g.v : 0.0;
        const double precision = 1.0 / g.v + d[i].precision;
        g = (struct gaussian){(g.m / g.v + d[i].shift) / precision, 1.0 / precision};
    }
    return g;
}

/* Second sweep, (S14): each drive compared with all others. */
static struct gaussian sweep_drives(const struct switching *s, struct switching_drive *d,
                                    int anchor, struct gaussian g)
{
    for (int i = 0; i < s->n; i++) {
        if (!s->loads[i].known || i == anchor)
            continue;
        /* Never less than the precision of the prior demand, whose variance is at most about 1. */
        const double without = larger(1.0 / g.v - d[i].precision, LEAST_PRECISION);
        const struct gaussian others = {(g.m / g.v - d[i].shift) / without, 1.0 / without};
        const double y = s->loads[i].load, noise = switching_noise_of(s, i);
        const struct origins from = switching_drive_explain(&d[i], y, noise, others);
        if (!s->loads[i].apart) {
            const struct gaussian with = switching_drive_absorb(&d[i], y, noise, others, &from);
            d[i].precision = larger(1.0 / with.v - without, 0.0);
            d[i].shift = d[i].precision > 0.0 ? with.m / with.v - others.m * without : 0.0;
            const double precision = without + d[i].precision;
            g = (struct gaussian){(others.m * without + d[i].shift) / precision, 1.0 / precision};
        }
        switching_drive_update(&d[i], y, noise, others, &from, s->loads[i].unsure);
    }
    return g;
}

/* Both sweeps; the slope follows the update of the demand, (S15). anchor: a drive from which the
 * demand already comes, or -1. */
static void weigh(const struct switching *s, struct switching_hypothesis *h,
                  struct switching_drive *d, int anchor)
{
    const struct gaussian before = {h->m, h->v_mm};
    const struct gaussian g = sweep_drives(s, d, anchor, sweep_demand(s, h, d, anchor));
    const double k = h->v_ms / before.v;
    h->s += k * (g.m - before.m);
    h->v_ss = larger(h->v_ss - k * k * (before.v - g.v), 1e-9);
    h->v_ms = k * g.v;
    h->m = g.m;
    h->v_mm = g.v;
}

/* ---- Events of a step ---- */

/* (S1): a step of the demand. */
static struct switching_hypothesis walk(struct switching_hypothesis h)
{
    const double v_mm = h.v_mm + 2.0 * h.v_ms + h.v_ss + STEP_SD * STEP_SD;
    h.m = clamp(h.m + h.s, -MOST_M, MOST_M);
    h.s = SLOPE_KEPT * h.s;
    h.v_ms = v_mm < 1.0 ? SLOPE_KEPT * (h.v_ms + h.v_ss) : 0.0;
    h.v_ss = smaller(SLOPE_KEPT * SLOPE_KEPT * h.v_ss + SLOPE_SD * SLOPE_SD, 0.01);
    h.v_mm = smaller(v_mm, 1.0);
    return h;
}

/* Relative frequency of losses: wheels that carry little hold. */
static double frequency(double demand)
{
    const double x = smaller(fabs(demand) / FULL_LOAD, 1.0);
    return x * x * x;
}

/* (S16): the demand continues, wobbles or turns; drives lose adhesion alone, or together. */
static struct switching_hypothesis moved(struct switching_hypothesis h, enum move move)
{
    const double often = larger(EVENT * frequency(h.m), LEAST_P);
    const double p[MOVES] = {
        [CALM] = 1.0 - EVENT - JUMP - 2.0 * MOVE, [ONSETS] = often, [WOBBLE] = MOVE, [TURN] = MOVE};
    h.log_weight += elementary_log(p[move]);
    if (move == WOBBLE || move == TURN)
        h.v_mm += MOVE_SD * MOVE_SD;
    if (move == TURN) {
        h.v_ms += 0.5 * MOVE_SD * MOVE_SD;
        h.v_ss += 0.5 * MOVE_SD * MOVE_SD;
    }
    return h;
}

/* Copy the drives of `from` to trial k. */
static struct switching_drive *copied(const struct switching *s, int k,
                                      const struct switching_drive *from)
{
    struct switching_drive *d = drives_of(s->trial_drives, s, k);
    for (int i = 0; i < s->n; i++)
        d[i] = from[i];
    return d;
}

/* The same, predicted by one step. */
static struct switching_drive *predicted(const struct switching *s, int k,
                                         const struct switching_drive *from, double begin)
{
    struct switching_drive *d = copied(s, k, from);
    for (int i = 0; i < s->n; i++)
        switching_drive_predict(&d[i], begin);
    return d;
}

/* Demand that the load of drive i indicates, if the drive adheres. */
static double demand_of(const struct switching *s, const struct switching_drive *d, int i)
{
    return s->loads[i].load / ratio_of(&d[i].now);
}

static int may_lead(const struct switching *s, int i)
{
    return s->loads[i].known && !s->loads[i].apart;
}

/* The two drives with the strongest loads of one sign; -1: there is none. */
static void find_strongest(const struct switching *s, const struct switching_drive *d, double sign,
                           int strongest[2])
{
    double most[2] = {0.0, 0.0};
    strongest[0] = strongest[1] = -1;
    for (int i = 0; i < s->n; i++) {
        const double x = may_lead(s, i) ? sign * demand_of(s, d, i) : 0.0;
        if (x > most[0]) {
            most[1] = most[0];
            strongest[1] = strongest[0];
            most[0] = x;
            strongest[0] = i;
        } else if (x > most[1]) {
            most[1] = x;
            strongest[1] = i;
        }
    }
}

/* (S17): the demand jumps to the load of drive j, which adheres; drives that carry more do not, so
 * that no jump is counted twice. */
static void jump(const struct switching *s, struct switching_hypothesis *h,
                 struct switching_drive *d, int j)
{
    const double rho = ratio_of(&d[j].now), x = s->loads[j].load / rho;
    const double far = clamp(x - h->m, -1.0, 1.0);
    for (int i = 0; i < s->n; i++) {
        const double theirs = may_lead(s, i) ? demand_of(s, d, i) : 0.0;
        if (i == j || theirs * x <= 0.0 || fabs(theirs) <= fabs(x))
            continue;
        d[i].neither += d[i].adhering * 1e-9;
        d[i].adhering = d[i].lost = 0.0;
    }
    d[j].adhering = 1.0 - 1e-9;
    d[j].lost = 0.0;
    d[j].neither = 1e-9;
    h->m = x;
    h->v_mm = (switching_noise_of(s, j) + ratio_variance(&d[j].now) * x * x) / (rho * rho);
    h->s = 0.5 * far;
    h->v_ms = 0.0;
    h->v_ss = 1e-4 + square(0.5 * far);
    weigh(s, h, d, j);
    d[j].precision = d[j].shift = 0.0;
}

static double best_of(const struct switching *s, int tried)
{
    double best = -HUGE_VAL;
    for (int k = 0; k < tried; k++)
        best = larger(s->trials[k].log_weight, best);
    return best;
}

/* Append to the first `tried` trials the jumps of one hypothesis; returns the number of trials.
 * later: its drives a step later. */
static int propose_jumps(struct switching *s, const struct switching_hypothesis *walked,
                         const struct switching_drive *from, const struct switching_drive *later,
                         int tried)
{
    for (int sign = -1; sign <= 1; sign += 2) {
        int strongest[2];
        find_strongest(s, from, sign, strongest);
        for (int k = 0; k < 2 && strongest[k] >= 0; k++) {
            const int j = strongest[k];
            const double far = demand_of(s, from, j) - walked->m;
            /* A demand that is not known can be taken from any drive, not only from the first. */
            const double near = 4.0 * (walked->v_mm + MOVE_SD * MOVE_SD);
            if (walked->v_mm < UNKNOWN_V && square(far) < near)
                continue;
            struct switching_hypothesis h = *walked;
            const double p = larger(from[j].adhering + 0.01 * from[j].lost, LEAST_P);
            h.log_weight += elementary_log(JUMP / SPAN * p / ratio_of(&from[j].now));
            if (h.log_weight < best_of(s, tried) - 30.0)
                continue;
            jump(s, &h, copied(s, tried, later), j);
            s->trials[tried++] = h;
        }
    }
    return tried;
}

/* Propose everything that hypothesis k may become. */
static int propose(struct switching *s, int k, int tried)
{
    const struct switching_drive *from = drives_of(s->drives, s, k);
    const struct switching_hypothesis walked = walk(s->hypotheses[k]);
    const struct switching_drive *later =
        predicted(s, SWITCHING_TRIED, from, ALONE * frequency(walked.m));
    for (int move = CALM; move < MOVES; move++) {
        struct switching_hypothesis h = moved(walked, (enum move)move);
        if (h.log_weight < s->hypotheses[0].log_weight - HOPELESS)
            continue;
        weigh(s, &h, move == ONSETS ? predicted(s, tried, from, PART) : copied(s, tried, later),
              -1);
        s->trials[tried++] = h;
    }
    return propose_jumps(s, &walked, from, later, tried);
}

/* ---- What is learnt ---- */

/* (S20): scale the mean ratio of a hypothesis to 1. */
static void centre(struct switching_hypothesis *h, struct switching_drive *d, int n)
{
    double total = 0.0;
    for (int i = 0; i < n; i++)
        total += d[i].now.r;
    const double mean = total / n; /* within R_MOST of 1 */
    for (int i = 0; i < n; i++) {
        d[i].now.r = clamp(d[i].now.r / mean, 1.0 - R_MOST, 1.0 + R_MOST);
        d[i].before.r = clamp(d[i].before.r / mean, 1.0 - R_MOST, 1.0 + R_MOST);
    }
    h->m *= mean;
}

static void learn(struct switching *s)
{
    switching_learn_noises(s);
    for (int k = 0; k < s->kept; k++)
        centre(&s->hypotheses[k], drives_of(s->drives, s, k), s->n);
}

/* 1 if the load of drive i contradicts the model: it belongs to no state, or the drive counts as
 * lost and carries what its own command asks for. */
static int contradicts(const struct switching *s, int i)
{
    const int neither = s->adhering[i] + s->lost[i] < 0.5;
    const int accused = s->loads[i].answers && s->lost[i] >= 0.5;
    return s->loads[i].known && (neither || accused);
}

/* If most loads contradict the model for long, what has been learnt is wrong, (S21): for example
 * because of a loss that existed before anything was known. Then restart. */
static void begin_anew_if_contradicted(struct switching *s, int known)
{
    int nothing = 0;
    for (int i = 0; i < s->n; i++)
        nothing += contradicts(s, i);
    s->contradicted = 2 * nothing > known ? s->contradicted + 1 : 0;
    if (s->contradicted >= ANEW_STEPS)
        set_unknown(s);
}

void switching_step(struct switching *s)
{
    const double before = s->demand;
    int tried = 0, known = 0;
    for (int i = 0; i < s->n; i++)
        known += s->loads[i].known;
    switching_note_sources(s);
    for (int k = 0; k < s->kept; k++)
        tried = propose(s, k, tried);
    switching_reduce(s, tried);
    switching_sum_up(s);
    if (known > 1)
        learn(s);
    begin_anew_if_contradicted(s, known);
    switching_note_lag(s, fabs(s->demand - before));
}

void switching_tick(struct switching *s)
{
    if (s->ticks == 0)
        switching_step(s);
    s->ticks = s->ticks + 1 < s->every ? s->ticks + 1 : 0;
}
