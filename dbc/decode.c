/* Bits of a frame to physical values, by the DBC alone.
 *
 * No function here can fail: `data` has PAYLOAD_BYTES bytes, which contain the eight bytes from
 * `first_byte` (at most 56) on; a ninth one is read only where dbc/codec_tables.py found one; every
 * other index is from the constant tables. Nothing is divided. */
#include "dbc/decode.h"

#include <math.h>

#include "dbc/bytes.h"

/* Bits of a signal. One of 58 bits or more that is not byte-aligned can end in a ninth byte. */
static inline uint64_t read_bits(const struct signal *signal, const uint8_t *data)
{
    const uint8_t *bytes = data + signal->first_byte;
    /* Without a branch: the byte order of the next signal depends on the frames. */
    const uint64_t little = load_little(bytes), big = load_big(bytes);
    const uint64_t swapped = -(uint64_t)signal->big_endian;
    uint64_t bits = ((big & swapped) | (little & ~swapped)) >> signal->shift;
    const unsigned ninth = signal->ninth_bits;
    if (ninth && signal->big_endian)
        bits = bits << ninth | (uint64_t)bytes[8] >> (8 - ninth);
    else if (ninth)
        bits |= (uint64_t)bytes[8] << (64 - signal->shift); /* the shift is 1 to 7 here */
    return bits & signal->mask;
}

/* Two's complement of the signal's width extended to 64 bits; an unsigned number stays as it is. */
static uint64_t sign_extended(const struct signal *signal, uint64_t bits)
{
    return (bits ^ signal->sign) - signal->sign;
}

/* Number that the bits of a float represent. */
static double float_of(const struct signal *signal, uint64_t bits)
{
    if (signal->type == SIGNAL_FLOAT64)
        return double_of_bits(bits);
    return (double)float_of_bits((uint32_t)bits);
}

int signal_present(const struct codec *codec, const struct message *message,
                   const struct signal *signal, const uint8_t *data)
{
    for (int depth = signal->mux_depth; depth > 0; depth--) {
        const struct signal *selector =
            &codec->signals[message->first_signal + signal->multiplexer];
        const int64_t raw = (int64_t)sign_extended(selector, read_bits(selector, data));
        const struct mux_range *ranges = &codec->mux_ranges[signal->first_range];
        int selected = 0;
        for (int r = 0; r < signal->range_count; r++)
            selected |= ranges[r].low <= raw && raw <= ranges[r].high;
        if (!selected)
            return 0;
        signal = selector;
    }
    return 1;
}

/* Validity of an integer by its key. */
static uint8_t judge(const struct signal *signal, uint64_t key)
{
    if (key - signal->valid_first < signal->valid_count)
        return SIGNAL_VALID;
    if (signal->has_none && key == signal->key_none)
        return SIGNAL_NOT_AVAILABLE;
    if (key < signal->key_min || key > signal->key_max)
        return SIGNAL_OUT_OF_RANGE;
    if (signal->saturates && (key == signal->key_min || key == signal->key_max))
        return SIGNAL_SATURATED;
    return SIGNAL_VALID;
}

/* Decode a signal that is in the frame; returns its validity. */
static uint8_t decode_signal(const struct signal *signal, const uint8_t *data, double *value)
{
    const uint64_t bits = read_bits(signal, data);
    if (signal->type >= SIGNAL_FLOAT32) {
        *value = float_of(signal, bits) * signal->scale + signal->offset;
        const int inside = signal->float_min <= *value && *value <= signal->float_max;
        return inside ? SIGNAL_VALID : SIGNAL_OUT_OF_RANGE;
    }
    double number = (double)(int64_t)sign_extended(signal, bits);
    if (signal->type == SIGNAL_UINT64)
        number = (double)bits;
    *value = number * signal->scale + signal->offset;
    return judge(signal, bits ^ signal->sign);
}

/* Signals of a listed message that are in a frame, one bit for each. */
static uint64_t present_signals(const struct codec *codec, const struct message *message,
                                const uint8_t *data)
{
    const struct signal *selector = &codec->signals[message->first_signal + message->selector];
    return codec->present[message->first_present + read_bits(selector, data)];
}

/* The value, or NaN (all bits set) if `present` is 0. No branch: a selector is hard to predict. */
static double value_if(unsigned present, double value)
{
    return double_of_bits(bits_of_double(value) | ((uint64_t)present - 1));
}

/* One frame of a message without selectors. */
static void decode_plain(const struct signal *signals, int count, const uint8_t *data,
                         double *value, uint8_t *validity)
{
    for (int k = 0; k < count; k++)
        validity[k] = decode_signal(&signals[k], data, &value[k]);
}

/* Decode one frame of any message; a signal that is not in the frame becomes NaN. */
static void decode_multiplexed(const struct codec *codec, const struct message *message,
                               const uint8_t *data, double *value, uint8_t *validity)
{
    const struct signal *signals = &codec->signals[message->first_signal];
    const uint64_t listed = message->is_listed ? present_signals(codec, message, data) : 0;
    for (int k = 0; k < message->signal_count; k++) {
        double physical;
        unsigned code = decode_signal(&signals[k], data, &physical);
        unsigned present = (unsigned)(listed >> k % 64) & 1;
        if (!message->is_listed)
            present = (unsigned)signal_present(codec, message, &signals[k], data);
        value[k] = value_if(present, physical);
        validity[k] = (uint8_t)(code + (1 - present) * (SIGNAL_ABSENT - code));
    }
}

/* Columns from `first` on, which have no signal. */
static void leave_blank(int first, int width, double *value, uint8_t *validity)
{
    for (int k = first; k < width; k++)
        value[k] = NAN;
    for (int k = first; k < width; k++)
        validity[k] = SIGNAL_ABSENT;
}

void decode_frames(const struct codec *codec, int64_t frames, const int32_t *message,
                   const uint8_t *data, double *value, uint8_t *validity)
{
    const int width = codec->width, messages = codec->message_count;
    for (int64_t i = 0; i < frames; i++) {
        int count = 0;
        if (message[i] >= 0 && message[i] < messages) {
            const struct message *layout = &codec->messages[message[i]];
            count = layout->signal_count;
            if (layout->mux_depth > 0)
                decode_multiplexed(codec, layout, data, value, validity);
            else
                decode_plain(&codec->signals[layout->first_signal], count, data, value, validity);
        }
        leave_blank(count, width, value, validity);
        data += PAYLOAD_BYTES;
        value += width;
        validity += width;
    }
}

void raw_values(const struct codec *codec, int32_t message, const uint8_t *data, uint64_t *raw)
{
    const struct message *layout = &codec->messages[message];
    const struct signal *signals = &codec->signals[layout->first_signal];
    for (int k = 0; k < layout->signal_count; k++) {
        const uint64_t bits = read_bits(&signals[k], data);
        if (signals[k].type == SIGNAL_FLOAT32)
            raw[k] = bits_of_double(float_of(&signals[k], bits));
        else
            raw[k] = sign_extended(&signals[k], bits);
    }
}
