/* Frames of a tick converted to samples, readings and the state of every channel. */
#ifndef TRACTION_RECEIVE_H
#define TRACTION_RECEIVE_H

#include "gateway/core/records.h"

/* Receive the frames of one tick, possibly none, in order of stamp and identifier: look up the
 * owner of each, verify and decode it, pair samples, store the values of Motion and Status. They
 * are `count` rows of a block, from `first`. Each frame is counted in one of `receiver->counters`.
 * Returns 1; or 0, with nothing done, if the frames are in another order. */
int receive_frames(struct receiver *receiver, const struct frame_columns *block, int64_t first,
                   int64_t count, int64_t now_ns);

/* After the frames of a tick: detect silence, and note why each channel is unknown (`reason`). */
void check_timeouts(struct receiver *receiver, int64_t now_ns);

/* Index of the channel of an identifier, or enum id_owner. */
int64_t lookup_id(const struct receiver *receiver, uint32_t can_id, uint8_t flags);

#endif
