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

/* Its standard deviation, K/h; NaN likewise. */
double trend_sigma_k_h(const struct trend *trend);

/* Hours until the motor is limit_k warmer than the others; NaN where that need not come, or has. */
double trend_hours_to(const struct trend *trend, double limit_k);

#endif
