/* Degradation: rate at which a motor grows warmer than the others, K/h, with its uncertainty. */
#ifndef TRACTION_THERMAL_TREND_H
#define TRACTION_THERMAL_TREND_H

#include "gateway/core/records.h"

/* Reset to nothing known. */
void trend_reset(struct trend *trend);

/* Add the deviation of a block of readings, K, which is `hours` long; NaN: no readings. */
void trend_add(struct trend *trend, double deviation_k, double hours);

/* Rate, K/h; NaN before enough has been observed. */
double trend_rate_k_h(const struct trend *trend);

/* Standard deviation of the rate, K/h; NaN likewise. */
double trend_sigma_k_h(const struct trend *trend);

/* Hours until the motor is limit_k warmer than the others; NaN if it need not be, or already is. */
double trend_hours_to(const struct trend *trend, double limit_k);

#endif
