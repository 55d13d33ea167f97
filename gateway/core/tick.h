/* The gateway: one period, and many. */
#ifndef TRACTION_TICK_H
#define TRACTION_TICK_H

#include "gateway/core/records.h"

/* Run ticks at now_ns, a period later and so on; returns their number, at most `ticks`.
 *
 * Tick k takes the rows from ends[k - 1] (0 for the first) to ends[k] of `frames`. Sent frames are
 * in `g->sent`; the largest probabilities of loss of these ticks are in `g->peak`. Stops after the
 * first tick in which a flag changed, or which had emergencies, because Python reads those (`tick`
 * of the receiver), or which filled `g->log`; and before a tick whose frames are not in order of
 * stamp and identifier, or for whose own frames there is no room. With a detector that is not in
 * the core a tick stops at STAGE_DETECT: `g->stage` shows it, the tick is not complete, and
 * `finish_tick` does the rest. */
int64_t run(struct gateway *g, const struct frame_columns *frames, const int64_t *ends,
            int64_t ticks, int64_t now_ns);

/* `run` with one tick of all rows; needs only the columns that a tick reads. 0: rows in another
 * order, nothing was done; 2: a part is left to Python, a detector or emergencies; else 1. */
int run_one(struct gateway *g, int64_t frames, int64_t *t_ns, uint32_t *can_id, uint8_t *flags,
            uint8_t *length, uint8_t *data, int64_t now_ns);

/* The rest of a tick that stopped at STAGE_DETECT, after the detector has filled
 * `loss_probability`, `loss_known` and `common` of `g->adhesion`. */
void finish_tick(struct gateway *g, int64_t now_ns);

#endif
