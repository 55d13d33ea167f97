/* From status to frames: what is due, encoded, counted and protected. */
#ifndef TRACTION_TRANSMIT_H
#define TRACTION_TRANSMIT_H

#include "gateway/core/records.h"

/* Everything is due at now_ns; the cycles count from there. */
void transmit_restart(struct transmitter *tx, int64_t now_ns);

/* Fill what of `tx->counts` the receiver, the missed ticks and the load of the bus tell. */
void update_counts(struct transmitter *tx, const struct receiver *receiver,
                   const struct integrity *integrity, const struct bus_load *load, int64_t now_ns);

/* Frames of a tick in the order of their identifiers: their number, at most tx->message_count, for
 * which there is room in `frame`. Messages go out in their cycles; one with `on_change` also in the
 * tick in which a thermal flag, or one of sensor, comm, estimator and overrun, is another than in the
 * tick before. What is not known goes out as the signal's not-available code, or as Unknown; no
 * value of an earlier tick is repeated. status: (tx->drive_count). */
int transmit(struct transmitter *tx, const struct drive_status *status,
             const struct train_status *train, int64_t now_ns, struct tx_frame *frame);

#endif
