/* Hypotheses of the model with a memory: which are kept, and what they say together. */
#ifndef ESTIMATORS_DETECT_SWITCHING_MIXTURE_H
#define ESTIMATORS_DETECT_SWITCHING_MIXTURE_H

#include "gateway/core/records.h"

/* Drives of hypothesis, or trial, k. */
static inline struct switching_drive *drives_of(struct switching_drive *all,
                                                const struct switching *s, int k)
{
    return all + (size_t)k * (size_t)s->n;
}

/* The likeliest of the first `tried` trials, in falling order, become the hypotheses; at least one is
 * tried. Their weights sum to 1. */
void switching_reduce(struct switching *s, int tried);

/* What all hypotheses say together: `demand`, `adhering`, `lost`. */
void switching_sum_up(struct switching *s);

#endif
