/* How fast a motor grows warmer than the others: degradation, K/h, with its uncertainty. */
#ifndef TRACTION_THERMAL_TREND_H
#define TRACTION_THERMAL_TREND_H

#include "gateway/core/records.h"

/* Nothing is known. */
void trend_reset(struct trend *trend);

/* Deviation of a block of readings, K, which is `hours` long; NaN: there was none. */
void trend_add(struct trend *trend, double deviation_k, double hours);

/* Rate, K/h; NaN before enough was observed. */
double trend_rate_k_h(const struct trend *trend);

#endif
