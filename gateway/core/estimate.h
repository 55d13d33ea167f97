/* Estimates by the filters: the samples of a tick through everything that learns from them. */
#ifndef TRACTION_ESTIMATE_H
#define TRACTION_ESTIMATE_H

#include "gateway/core/records.h"

/* Nothing known of any drive; motors, noise, settings and ratings stay. */
void estimator_reset(struct estimator *e);

/* One tick: calibrates the currents, acquires rotors, runs and adapts the filters, starts and drops
 * them, and fills `estimates` but for `health_reason`.
 *
 * receiver: samples of the tick, which `e->samples` has room for, and whose filter starts anew.
 * inputs: why currents are not valid, and whether the newest sample is fresh. */
void run_filters(struct estimator *e, const struct receiver *receiver,
                 const struct input_status *inputs, struct drive_estimate *estimates,
                 int64_t now_ns);

#endif
