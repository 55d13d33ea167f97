/* Hypotheses of the switching model: which are kept, and their common result. */
#ifndef ESTIMATORS_DETECT_SWITCHING_MIXTURE_H
#define ESTIMATORS_DETECT_SWITCHING_MIXTURE_H

#include "gateway/core/records.h"

/* Drives of hypothesis k, or of trial k. */
static inline struct switching_drive *drives_of(struct switching_drive *all,
                                                const struct switching *s, int k)
{
    return all + (size_t)k * (size_t)s->n;
}

/* Keep the likeliest of the first `tried` trials, in falling order, as hypotheses; at least one is
 * tried. Their weights sum to 1. */
void switching_reduce(struct switching *s, int tried);

/* Average over all hypotheses: `demand`, `adhering`, `lost`. */
void switching_sum_up(struct switching *s);

#endif
