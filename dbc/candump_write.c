/* Frames to candump text, as `candump -L` writes it; dbc/candump/grammar.py has the grammar of such lines.
 *
 * Each function that writes a part of a line returns the place after it. None can fail: only frames
 * that pass `fits` are written, in fewer than CANDUMP_MAX_TEXT bytes: 22 of stamp, 22 of name and
 * blank, 9 of identifier, 2 of CAN FD flags, 128 of data, 2 of a raw length, 2 of direction, 1 of
 * line end. */
#include "dbc/candump_write.h"

#include "dbc/fd_length.h"

enum { CLASSIC_BYTES = 8, MAX_RAW_DLC = 15, NS_PER_S = 1000000000 };

static const int64_t END_NS = INT64_C(9000000000) * NS_PER_S; /* fits in 64 bits */
static const int64_t STANDARD_ID = 0x7FF, EXTENDED_ID = 0x1FFFFFFF, ERROR_BIT = 0x20000000;
static const uint8_t DIGITS[] = "0123456789ABCDEF";

/* 1 if a line can express a frame with these flags, raw length and length of data. */
static int has_form(int32_t flags, int32_t dlc, int64_t length)
{
    if (flags & FRAME_ERROR && flags & (FRAME_REMOTE | FRAME_FD | FRAME_EXTENDED))
        return 0;
    if (flags & (FRAME_BRS | FRAME_ESI) && !(flags & FRAME_FD))
        return 0;
    if (flags & FRAME_REMOTE)
        return length == 0 && !(flags & FRAME_FD) && dlc <= MAX_RAW_DLC;
    if (flags & FRAME_FD)
        return is_fd_length(length) && dlc <= CLASSIC_BYTES;
    if (dlc > CLASSIC_BYTES) /* a raw length belongs to a full frame */
        return length == CLASSIC_BYTES && dlc <= MAX_RAW_DLC;
    return length <= CLASSIC_BYTES;
}

static int fits(int64_t t_ns, int64_t can_id, int32_t flags, int32_t dlc, int64_t length)
{
    const int long_id = flags & (FRAME_EXTENDED | FRAME_ERROR);
    const int64_t last_id = long_id ? EXTENDED_ID : STANDARD_ID;
    const int in_range = t_ns >= 0 && t_ns < END_NS && can_id >= 0 && can_id <= last_id;
    return in_range && has_form(flags, dlc, length);
}

/* The last `count` decimal digits of a number that is not negative. */
static uint8_t *write_decimal(uint8_t *at, int64_t number, int count)
{
    uint64_t left = (uint64_t)number;
    for (int k = count - 1; k >= 0; k--) {
        at[k] = (uint8_t)('0' + left % 10);
        left /= 10;
    }
    return at + count;
}

static uint8_t *write_hex(uint8_t *at, int64_t number, int count)
{
    for (int k = 0; k < count; k++)
        at[k] = DIGITS[number >> 4 * (count - 1 - k) & 15];
    return at + count;
}

static uint8_t *write_bytes(uint8_t *at, const uint8_t *data, int64_t length)
{
    for (int64_t k = 0; k < length; k++) {
        *at++ = DIGITS[data[k] >> 4];
        *at++ = DIGITS[data[k] & 15];
    }
    return at;
}

/* `(seconds.microseconds) `, or nanoseconds where they are needed. */
static uint8_t *write_stamp(uint8_t *at, int64_t t_ns)
{
    const int64_t seconds = t_ns / NS_PER_S, ns = t_ns % NS_PER_S;
    *at++ = '(';
    at = write_decimal(at, seconds, 10);
    *at++ = '.';
    at = ns % 1000 ? write_decimal(at, ns, 9) : write_decimal(at, ns / 1000, 6);
    *at++ = ')';
    *at++ = ' ';
    return at;
}

/* A remote frame has no data: `R` and the requested length; `R8_` and the raw length if above 8. */
static uint8_t *write_request(uint8_t *at, int32_t dlc)
{
    *at++ = 'R';
    if (dlc > CLASSIC_BYTES) {
        *at++ = '8';
        *at++ = '_';
    }
    if (dlc > 0)
        *at++ = DIGITS[dlc & 15];
    return at;
}

/* Write what follows the `#` of the identifier. */
static uint8_t *write_body(uint8_t *at, int32_t flags, int32_t dlc, int64_t length,
                           const uint8_t *data)
{
    if (flags & FRAME_REMOTE)
        return write_request(at, dlc);
    if (flags & FRAME_FD) {
        *at++ = '#';
        *at++ = DIGITS[(flags & FRAME_BRS ? 1 : 0) | (flags & FRAME_ESI ? 2 : 0)];
    }
    at = write_bytes(at, data, length);
    if (dlc > CLASSIC_BYTES) {
        *at++ = '_';
        *at++ = DIGITS[dlc & 15];
    }
    return at;
}

int64_t candump_write_line(int64_t t_ns, int64_t can_id, int32_t flags, int32_t dlc, int64_t length,
                           const uint8_t *data, const struct interface_name *name, uint8_t *text)
{
    if (name->length == 0 || !fits(t_ns, can_id, flags, dlc, length))
        return 0;
    const int long_id = flags & (FRAME_EXTENDED | FRAME_ERROR);
    uint8_t *at = write_stamp(text, t_ns);
    for (int k = 0; k < name->length; k++)
        *at++ = name->text[k];
    *at++ = ' ';
    at = write_hex(at, flags & FRAME_ERROR ? can_id | ERROR_BIT : can_id, long_id ? 8 : 3);
    *at++ = '#';
    at = write_body(at, flags, dlc, length, data);
    if (flags & FRAME_TX) { /* ` R` is left out, as by candump without -x */
        *at++ = ' ';
        *at++ = 'T';
    }
    return at - text;
}

int64_t candump_write(const struct frame_columns *frames, int64_t first, int64_t last,
                      const struct interface_name *names, uint8_t *text, int64_t size,
                      int64_t *filled)
{
    int64_t row = first, at = 0;
    for (; row < last && at + CANDUMP_MAX_TEXT <= size; row++) {
        const int64_t written = candump_write_line(
            frames->t_ns[row], frames->can_id[row], frames->flags[row], frames->dlc[row],
            frames->length[row], &frames->data[row * PAYLOAD_BYTES], &names[frames->channel[row]],
            &text[at]);
        if (written == 0)
            break;
        at += written;
        text[at++] = '\n';
    }
    *filled = at;
    return row;
}
