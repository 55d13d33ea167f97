/* Bits of a frame to physical values. */
#ifndef TRACTION_DECODE_H
#define TRACTION_DECODE_H

#include "gateway/core/records.h"

/* Decode `frames` frames. message: (frames) their numbers in the codec; data: (frames,
 * PAYLOAD_BYTES). Fills value, in the DBC's units, and validity (enum signal_validity), both
 * (frames, codec->width). Columns without a signal are NaN and SIGNAL_ABSENT; so are all columns
 * if the number is not that of a message. A value that is not SIGNAL_VALID must not be used. */
void decode_frames(const struct codec *codec, int64_t frames, const int32_t *message,
                   const uint8_t *data, double *value, uint8_t *validity);

/* Raw values of all signals of one frame, absent ones too: sign-extended integers, and for a float
 * the bits of a double. message: its number, which is one of the codec's. Fills raw (signals). */
void raw_values(const struct codec *codec, int32_t message, const uint8_t *data, uint64_t *raw);

/* 1 if the selectors in a frame have values that select a signal of this message, else 0. */
int signal_present(const struct codec *codec, const struct message *message,
                   const struct signal *signal, const uint8_t *data);

#endif
