/* From a model with a memory to what the flags are told: the detector `switching`. */
#ifndef TRACTION_SWITCHING_LOSS_H
#define TRACTION_SWITCHING_LOSS_H

#include "gateway/core/records.h"

/* What the detector finds: fills `loss_probability`, `loss_known` and `common`. */
void compare_by_memory(struct adhesion *a);

/* The same with the answers of all drives to their commands, and what forbids a verdict.
 *
 * status: adhesion flags so far; little: 1 where drives carry too little in common to accuse one. */
void judge_by_memory(struct adhesion *a, const struct drive_status *status, int little,
                     int64_t now_ns);

#endif
