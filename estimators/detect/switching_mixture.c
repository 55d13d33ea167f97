/* Reduction of the hypotheses: docs/switching.md, equations (S18) and (S19).
 *
 * Nothing here can fail: divisors are 1 or more, or a sum of probabilities with a floor;
 * logarithms are of 1 or more; indices are below SWITCHING_KEPT, SWITCHING_TRIED and n. */
#include "estimators/detect/switching_mixture.h"

#include <math.h>

#include "estimators/detect/switching_drive.h"
#include "estimators/elementary.h"
#include "estimators/numbers.h"

#define NEAR_V   0.5  /* demands are alike within this share of their variances, */
#define NEAR_P   0.2  /* and drives, within this difference of their probabilities */
#define UNLIKELY 20.0 /* a hypothesis whose log weight is lower than the best by this is dropped */

/* 1 if two hypotheses are alike, (S18). */
static int are_alike(const struct switching_hypothesis *a, const struct switching_drive *d_a,
                     const struct switching_hypothesis *b, const struct switching_drive *d_b, int n)
{
    if (square(a->m - b->m) > NEAR_V * (a->v_mm + b->v_mm))
        return 0;
    for (int i = 0; i < n; i++)
        if (fabs(d_a[i].adhering - d_b[i].adhering) >= NEAR_P)
            return 0;
    return 1;
}

/* (S19) for one drive; w and 1 - w: weights of both. */
static void merge_drive(struct switching_drive *a, const struct switching_drive *b, double w)
{
    const double z = 1.0 - w;
    const double gone_a = w * (1.0 - a->adhering), gone_b = z * (1.0 - b->adhering);
    const double w_a = (gone_a + 1e-300) / (gone_a + gone_b + 2e-300), w_b = 1.0 - w_a;
    const double c = w_a * a->c + w_b * b->c;
    a->v_c = w_a * (a->v_c + square(a->c - c)) + w_b * (b->v_c + square(b->c - c));
    a->c = c;
    a->now = mix_ratios(&a->now, w * a->adhering, &b->now, z * b->adhering);
    a->before =
        mix_ratios(&a->before, w * (1.0 - a->adhering), &b->before, z * (1.0 - b->adhering));
    a->adhering = w * a->adhering + z * b->adhering;
    a->lost = w * a->lost + z * b->lost;
    a->neither = w * a->neither + z * b->neither;
}

/* (S19): merge both, by their moments, into the likelier one. */
static void merge(struct switching_hypothesis *a, struct switching_drive *d_a,
                  const struct switching_hypothesis *b, const struct switching_drive *d_b, int n)
{
    const double other = elementary_exp(b->log_weight - a->log_weight);
    const double w = 1.0 / (1.0 + other), z = 1.0 - w;
    const double m = w * a->m + z * b->m, s = w * a->s + z * b->s;
    a->v_mm = w * (a->v_mm + square(a->m - m)) + z * (b->v_mm + square(b->m - m));
    a->v_ms = w * (a->v_ms + (a->m - m) * (a->s - s)) + z * (b->v_ms + (b->m - m) * (b->s - s));
    a->v_ss = w * (a->v_ss + square(a->s - s)) + z * (b->v_ss + square(b->s - s));
    a->m = m;
    a->s = s;
    a->log_weight += elementary_log(1.0 + other);
    for (int i = 0; i < n; i++)
        merge_drive(&d_a[i], &d_b[i], w);
}

/* Merge trial k into a hypothesis that is alike, or keep it if there is room. */
static void keep(struct switching *s, int k)
{
    const struct switching_hypothesis *h = &s->trials[k];
    const struct switching_drive *d = drives_of(s->trial_drives, s, k);
    for (int j = 0; j < s->kept; j++) {
        struct switching_drive *theirs = drives_of(s->drives, s, j);
        if (!are_alike(&s->hypotheses[j], theirs, h, d, s->n))
            continue;
        merge(&s->hypotheses[j], theirs, h, d, s->n);
        return;
    }
    if (s->kept >= SWITCHING_KEPT)
        return;
    struct switching_drive *mine = drives_of(s->drives, s, s->kept);
    for (int i = 0; i < s->n; i++)
        mine[i] = d[i];
    s->hypotheses[s->kept++] = *h;
}

void switching_reduce(struct switching *s, int tried)
{
    int rank[SWITCHING_TRIED] = {0};
    for (int k = 0; k < tried; k++) {
        int j = k;
        for (; j > 0 && s->trials[rank[j - 1]].log_weight < s->trials[k].log_weight; j--)
            rank[j] = rank[j - 1];
        rank[j] = k;
    }
    const double best = s->trials[rank[0]].log_weight;
    s->kept = 0;
    for (int k = 0; k < tried && s->trials[rank[k]].log_weight >= best - UNLIKELY; k++)
        keep(s, rank[k]);
    double total = 0.0;
    for (int k = 0; k < s->kept; k++)
        total += elementary_exp(s->hypotheses[k].log_weight - best);
    for (int k = 0; k < s->kept; k++)
        s->hypotheses[k].log_weight -= best + elementary_log(total);
}

void switching_sum_up(struct switching *s)
{
    s->demand = 0.0;
    for (int i = 0; i < s->n; i++)
        s->adhering[i] = s->lost[i] = 0.0;
    for (int k = 0; k < s->kept; k++) {
        const double w = elementary_exp(s->hypotheses[k].log_weight);
        const struct switching_drive *d = drives_of(s->drives, s, k);
        s->demand += w * s->hypotheses[k].m;
        for (int i = 0; i < s->n; i++) {
            s->adhering[i] += w * d[i].adhering;
            s->lost[i] += w * d[i].lost;
        }
    }
}
