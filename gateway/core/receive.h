/* Frames of a tick to samples, readings and the state of every channel. */
#ifndef TRACTION_RECEIVE_H
#define TRACTION_RECEIVE_H

#include "gateway/core/records.h"

/* Take in the frames of one tick, none too, in order of stamp and identifier: look up whose each is,
 * verify it, decode it, pair samples, note what Motion and Status say. The columns are those of a
 * block (dbc/frames.py): t_ns, can_id, flags, length (frames), data (frames, PAYLOAD_BYTES). Every
 * frame ends in one of `receiver->counters`. Returns 1; or 0, and nothing is done, for frames in
 * another order. */
int receive_frames(struct receiver *receiver, int64_t frames, const int64_t *t_ns,
                   const uint32_t *can_id, const uint8_t *flags, const uint8_t *length,
                   const uint8_t *data, int64_t now_ns);

/* After the frames of a tick: notice silence, and note why each channel is unknown (`reason`). */
void check_timeouts(struct receiver *receiver, int64_t now_ns);

/* Index of the channel that an identifier belongs to, or enum id_owner. */
int64_t lookup_id(const struct receiver *receiver, uint32_t can_id, uint8_t flags);

#endif
