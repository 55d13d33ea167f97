/* Signs of a second sender of one message. */
#ifndef TRACTION_SEQUENCE_H
#define TRACTION_SEQUENCE_H

#include "gateway/core/records.h"

/* Evaluate the counter of a frame with a good checksum. step: counter steps since the frame before,
 * a full turn if it is the same; identical: 1 if the frame equals the last one, byte for byte.
 * After enough signs, frames of the message are rejected until `rejected_until_ns`. */
void guard_sequence(struct sequence_guard *guard, int64_t t_ns, int32_t step, int32_t identical);

#endif
