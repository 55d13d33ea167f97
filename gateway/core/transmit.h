/* Status to frames: frames that are due, encoded, counted and protected. */
#ifndef TRACTION_TRANSMIT_H
#define TRACTION_TRANSMIT_H

#include "gateway/core/records.h"

/* Make all messages due at now_ns; their cycles start there. */
void transmit_restart(struct transmitter *tx, int64_t now_ns);

/* Update those of `tx->counts` that come from receiver, missed ticks and bus load. */
void update_counts(struct transmitter *tx, const struct receiver *receiver,
                   const struct integrity *integrity, const struct bus_load *load, int64_t now_ns);

/* Frames of a tick in the order of their identifiers: returns their number, at most
 * tx->message_count, for which `frame` has room. Messages are sent in their cycles; one with
 * `on_change` also in the tick in which a thermal flag, or one of sensor, comm, estimator and
 * overrun, differs from the tick before. What is not known is sent as the signal's not-available
 * code, or as Unknown; no value of an earlier tick is repeated. status: (tx->drive_count). */
int transmit(struct transmitter *tx, const struct drive_status *status,
             const struct train_status *train, int64_t now_ns, struct tx_frame *frame);

#endif
