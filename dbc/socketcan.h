/* What recvmmsg(2) has read from a SocketCAN socket, taken apart. */
#ifndef TRACTION_SOCKETCAN_H
#define TRACTION_SOCKETCAN_H

#include "gateway/core/records.h"

/* Read n messages into rows, one for each that is a CAN frame; data behind its length is 0.
 *
 * The control of each message is set back to `control_capacity` bytes. Stamps are monotonic:
 * `clock->now_ns` less the age of the stamp of the kernel, which is between 0 and `max_age_ns`; of a
 * message without stamp: now. Fills `counts` but for `drops_seen`, which it keeps from call to call.
 */
void unpack_frames(struct socket_message *messages, int n, size_t control_capacity,
                   const struct socket_clock *clock, const struct frame_columns *rows,
                   struct socket_counts *counts);

#endif
