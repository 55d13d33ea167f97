/* Causes that make the flags of all drives unknown: missed ticks, lost frames, an intruder. */
#ifndef TRACTION_INTEGRITY_H
#define TRACTION_INTEGRITY_H

#include "gateway/core/records.h"

/* One tick: use the driver's notes. own_frames: received with the gateway's own identifiers. */
void check_integrity(struct integrity *integrity, int64_t own_frames, int64_t now_ns);

/* enum reason why no adhesion flag is valid in this tick; REASON_NONE: no reason. For
 * thermal flags, which change slowly, only REASON_INTRUDER counts. */
int integrity_reason(const struct integrity *integrity);

/* 1 if ticks were missed recently. */
int is_overrun(const struct integrity *integrity);

/* Fill the train_inputs of this tick. common_mode: enum flag_state. */
void fill_train_inputs(const struct integrity *integrity, uint8_t common_mode,
                       struct train_inputs *out);

#endif
