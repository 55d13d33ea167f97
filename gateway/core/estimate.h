/* Estimates by the filters: everything that learns from the samples of a tick. */
#ifndef TRACTION_ESTIMATE_H
#define TRACTION_ESTIMATE_H

#include "gateway/core/records.h"

/* Reset all drives to nothing known; motors, noise, settings and ratings stay. */
void estimator_reset(struct estimator *e);

/* One tick: calibrates the currents, acquires rotors, runs and adapts the filters, starts and drops
 * them, and fills `estimates` except `health_reason`.
 *
 * receiver: samples of the tick, for which `e->samples` has room, and drives whose filter starts
 * anew. inputs: why currents are not valid, and whether the newest sample is fresh. */
void run_filters(struct estimator *e, const struct receiver *receiver,
                 const struct input_status *inputs, struct drive_estimate *estimates,
                 int64_t now_ns);

#endif
