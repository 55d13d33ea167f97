/* Physical values to bits of a frame, by the DBC alone.
 *
 * No function here can fail: indices are as in dbc/decode.c; `scale` is not 0, and if a damaged
 * record had 0, the quotient would be infinite or NaN, which each conversion below bounds first. */
#include "dbc/encode.h"

#include <float.h>
#include <math.h>

#include "dbc/bytes.h"
#include "dbc/decode.h"
#include "dbc/rounding.h"

/* Bits of a signed integer. After the two comparisons the number is within int64_t. */
static uint64_t signed_bits(const struct signal *signal, double raw)
{
    const int64_t low = (int64_t)(signal->key_min - signal->sign);
    const int64_t high = (int64_t)(signal->key_max - signal->sign);
    int64_t whole = low;
    if (raw >= TWO_63)
        whole = high;
    else if (raw > -TWO_63)
        whole = round_half_even(raw);
    if (whole < low)
        whole = low;
    if (whole > high)
        whole = high;
    return (uint64_t)whole;
}

/* Bits of an unsigned integer. From 2^63 on a double is a whole number. */
static uint64_t unsigned_bits(const struct signal *signal, double raw)
{
    uint64_t whole = signal->key_min;
    if (raw >= 2.0 * TWO_63)
        whole = signal->key_max;
    else if (raw >= TWO_63)
        whole = (uint64_t)raw;
    else if (raw > 0.0)
        whole = (uint64_t)round_half_even(raw);
    if (whole < signal->key_min)
        return signal->key_min;
    return whole > signal->key_max ? signal->key_max : whole;
}

static double bounded(double x, double low, double high)
{
    if (!(x > low)) /* NaN as well */
        return low;
    return x < high ? x : high;
}

/* Bits of a float: within its range, whose ends a negative scale swaps, and that of its type. */
static uint64_t float_bits(const struct signal *signal, double raw)
{
    const double one = (signal->float_min - signal->offset) / signal->scale;
    const double other = (signal->float_max - signal->offset) / signal->scale;
    const double largest = signal->type == SIGNAL_FLOAT32 ? (double)FLT_MAX : DBL_MAX;
    const double low = bounded(one < other ? one : other, -largest, largest);
    const double high = bounded(one < other ? other : one, -largest, largest);
    const double number = bounded(raw, low, high);
    return signal->type == SIGNAL_FLOAT32 ? bits_of_float((float)number) : bits_of_double(number);
}

/* Bits of a signal whose physical value is given. */
static uint64_t bits_of(const struct signal *signal, double value)
{
    if (!isfinite(value))
        return signal->has_none ? signal->key_none ^ signal->sign : signal->start;
    const double raw = (value - signal->offset) / signal->scale;
    if (signal->type >= SIGNAL_FLOAT32)
        return float_bits(signal, raw);
    return (signal->sign ? signed_bits(signal, raw) : unsigned_bits(signal, raw)) & signal->mask;
}

/* Write bits into bytes in which these bits are 0. */
static void write_bits(const struct signal *signal, uint64_t bits, uint8_t *data)
{
    uint8_t *bytes = data + signal->first_byte;
    const unsigned ninth = signal->ninth_bits;
    if (signal->big_endian) {
        if (ninth)
            bytes[8] |= (uint8_t)(bits << (8 - ninth));
        store_big(bytes, load_big(bytes) | bits >> ninth << signal->shift);
    } else {
        if (ninth)
            bytes[8] |= (uint8_t)(bits >> (64 - signal->shift)); /* the shift is 1 to 7 here */
        store_little(bytes, load_little(bytes) | bits << signal->shift);
    }
}

void encode_frame(const struct codec *codec, int32_t message, const double *value,
                  const uint8_t *given, uint8_t *data)
{
    const struct message *layout = &codec->messages[message];
    const struct signal *signals = &codec->signals[layout->first_signal];
    for (int b = 0; b < PAYLOAD_BYTES; b++)
        data[b] = 0;
    /* Selectors first: they decide which other signals are in the frame. */
    for (int depth = 0; depth <= layout->mux_depth; depth++) {
        for (int k = 0; k < layout->signal_count; k++) {
            const struct signal *signal = &signals[k];
            if (signal->mux_depth != depth)
                continue;
            const uint64_t bits = given[k] ? bits_of(signal, value[k]) : signal->start;
            if (bits && (depth == 0 || signal_present(codec, layout, signal, data)))
                write_bits(signal, bits, data);
        }
    }
}

void encode_frames(const struct codec *codec, int32_t message, int64_t frames, int64_t columns,
                   const double *value, const uint8_t *given, uint8_t *data)
{
    for (int64_t i = 0; i < frames; i++)
        encode_frame(codec, message, value + i * columns, given, data + i * PAYLOAD_BYTES);
}
