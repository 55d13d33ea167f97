/* Physical values to bits of a frame. */
#ifndef TRACTION_ENCODE_H
#define TRACTION_ENCODE_H

#include "gateway/core/records.h"

/* Encode one frame of a message. message: its number, which is one of the codec's; value: (signals)
 * in the DBC's units; given: (signals) 1 to encode `value`, 0 to encode the start value. NaN and
 * infinity become the not-available code (the start value if the signal has none), and numbers out
 * of range become the nearer end of the range. Multiplexed signals are written if their selectors
 * select them. Fills data (PAYLOAD_BYTES); a protection header has its start values. */
void encode_frame(const struct codec *codec, int32_t message, const double *value,
                  const uint8_t *given, uint8_t *data);

/* The same for `frames` frames of one message. columns: columns of value (frames, columns) and
 * given (columns), no fewer than the message has signals. Fills data (frames, PAYLOAD_BYTES). */
void encode_frames(const struct codec *codec, int32_t message, int64_t frames, int64_t columns,
                   const double *value, const uint8_t *given, uint8_t *data);

#endif
