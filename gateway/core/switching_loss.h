/* The detector `switching`: from the switching model to the probability that the flags use. */
#ifndef TRACTION_SWITCHING_LOSS_H
#define TRACTION_SWITCHING_LOSS_H

#include "gateway/core/records.h"

/* Run the switching model: fills `loss_probability`, `loss_known` and `common`. */
void compare_by_memory(struct adhesion *a);

/* Fuse its results with the command responses of all drives, and with all that forbids a verdict.
 *
 * status: adhesion flags of the last tick. */
void judge_by_memory(struct adhesion *a, const struct drive_status *status, int64_t now_ns);

#endif
