/* The gateway: one period of it, and many. */
#ifndef TRACTION_TICK_H
#define TRACTION_TICK_H

#include "gateway/core/records.h"

/* Ticks at now_ns, a period later and so on: their number, at most `ticks`.
 *
 * Tick k takes the rows from ends[k - 1] (0 for the first) to ends[k] of `frames`. What goes out is in
 * `g->sent`; the largest probabilities of loss of these ticks are in `g->peak`. Ends behind the first
 * tick in which a flag changed, or which had emergencies, for those are read by Python (`tick` of the
 * receiver), or which filled `g->log`; and before a tick whose frames are not in order of stamp and
 * identifier, or for whose own frames there is no room. With a detector that is not in the core a tick
 * stops at STAGE_DETECT: `g->stage` says so, nothing of `frames` counts, and `finish_tick` does the
 * rest. */
int64_t run(struct gateway *g, const struct frame_columns *frames, const int64_t *ends,
            int64_t ticks, int64_t now_ns);

/* `run` with one tick, of all rows; only what a tick looks at has to be given. 0 if nothing is done, for
 * rows in another order; 2 if something of the tick is left to Python: a detector, emergencies; else 1. */
int run_one(struct gateway *g, int64_t frames, int64_t *t_ns, uint32_t *can_id, uint8_t *flags,
            uint8_t *length, uint8_t *data, int64_t now_ns);

/* The rest of a tick that was left at STAGE_DETECT, once the detector has filled `loss_probability`,
 * `loss_known` and `common` of `g->adhesion`. */
void finish_tick(struct gateway *g, int64_t now_ns);

#endif
