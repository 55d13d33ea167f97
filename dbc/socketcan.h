/* Messages that recvmmsg(2) has read from a SocketCAN socket, converted to frames. */
#ifndef TRACTION_SOCKETCAN_H
#define TRACTION_SOCKETCAN_H

#include "gateway/core/records.h"

/* Unpack n messages into rows, one for each that is a CAN frame; the bytes after its length are 0.
 *
 * The control size of each message is reset to `control_capacity` bytes. Stamps are monotonic:
 * `clock->now_ns` less the age of the kernel's stamp, kept within 0 to `max_age_ns`; now, if
 * there is no stamp. Fills `counts`; `drops_seen` is kept from call to call.
 */
void unpack_frames(struct socket_message *messages, int n, size_t control_capacity,
                   const struct socket_clock *clock, const struct frame_columns *rows,
                   struct socket_counts *counts);

#endif
