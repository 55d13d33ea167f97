/* Frames of a tick to samples, readings and the state of every channel. */
#ifndef TRACTION_RECEIVE_H
#define TRACTION_RECEIVE_H

#include "gateway/core/records.h"

/* Take in the frames of one tick, in order of stamp and identifier: look up whose each is, verify
 * it, decode it, pair samples, note what Motion and Status say; then notice silence. The columns
 * are those of a block (dbc/block.py): t_ns, can_id, flags, length (frames), data (frames,
 * PAYLOAD_BYTES). Every frame ends in one of `receiver->counters`. Returns 1; or 0, and nothing is
 * done, for frames in another order. */
int receive_frames(struct receiver *receiver, int64_t frames, const int64_t *t_ns,
                   const uint32_t *can_id, const uint8_t *flags, const uint8_t *length,
                   const uint8_t *data, int64_t now_ns);

/* A tick without frames: notice silence, and note why each channel is unknown (`reason`). */
void check_timeouts(struct receiver *receiver, int64_t now_ns);

/* Index of the channel that an identifier belongs to, or enum id_owner. */
int64_t lookup_id(const struct receiver *receiver, uint32_t can_id, uint8_t flags);

/* `busy_s` and the seconds that frames take on the wire, the gateway's own left out. classic_s, fd_s:
 * seconds by number of data bytes (256). receiver: NULL where no frame is its own. */
double bus_time(const struct receiver *receiver, int64_t frames, const uint32_t *can_id,
                const uint8_t *flags, const uint8_t *length, const double *classic_s,
                const double *fd_s, double busy_s);

#endif
