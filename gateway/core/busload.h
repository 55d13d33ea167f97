/* Share of the bus in use over the last full second, with worst-case bit stuffing. */
#ifndef TRACTION_BUSLOAD_H
#define TRACTION_BUSLOAD_H

#include "gateway/core/records.h"

/* A tick begins: close the window if its second is over. */
void bus_load_tick(struct bus_load *load, int64_t now_ns);

/* Count received frames, rows of a block as in receive.h. The gateway's own frames are left out:
 * they are counted when they are sent. receiver: NULL if no frame is the gateway's own. */
void bus_load_receive(struct bus_load *load, const struct receiver *receiver,
                      const struct frame_columns *block, int64_t first, int64_t count);

/* Count one sent frame; fd: 1 for CAN FD; length: number of its data bytes. */
void bus_load_send(struct bus_load *load, int fd, uint8_t length);

/* Count the frames that `transmit` has filled. */
void bus_load_transmit(struct bus_load *load, const struct transmitter *tx, int frames,
                       const struct tx_frame *frame);

/* Load of the last closed window, % and at most 126; NaN before the first, or if it is too old. */
double bus_load_percent(const struct bus_load *load, int64_t now_ns);

#endif
