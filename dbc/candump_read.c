/* Candump text to frames, for the usual line of a log. dbc/candump/grammar.py has the grammar of
 * all lines and decides on those that are left to it here.
 *
 *     line      = stamp gap name gap id "#" (classic | fd) [" R" | " T"] [CR] LF
 *     stamp     = "(" 1 to 10 digits "." (6 digits | 9 digits) ")"    below 9,000,000,000 s
 *     gap       = 1 to 21 blanks
 *     name      = 1 to 21 bytes, no blank and no control character
 *     id        = 3 hexadecimal digits, up to 7FF
 *     classic   = 0 to 8 bytes, two hexadecimal digits each
 *     fd        = "#" flags, and 0 to 64 bytes, as many as a CAN FD frame can have
 *
 * Each function that reads a part of a line returns the place after it, or NULL if the text is
 * not such a part or the function was called with NULL. None can fail: no byte at or after `end` is
 * read, and no part of a line contains a line end, so no line end is skipped. */
#include "dbc/candump_read.h"

#include <stddef.h>

#include "dbc/fd_length.h"

enum { MAX_SECONDS_DIGITS = 10, MICROSECONDS = 6, NANOSECONDS = 9, MAX_GAP = 21 };
enum { CLASSIC_BYTES = 8, SHORTEST_LINE = 17 }; /* `(0.000000) a 123#` */
enum { IS_HEX = 16, DELETE = 127 };

/* A hexadecimal digit: IS_HEX and its value. Any other character: 0. */
static const uint8_t HEX[256] = {
    ['0'] = 16, 17, 18, 19, 20, 21,         22, 23, 24, 25, ['A'] = 26,
    27,         28, 29, 30, 31, ['a'] = 26, 27, 28, 29, 30, 31,
};

/* Read at most `most` decimal digits; their number goes into *count. */
static const uint8_t *read_digits(const uint8_t *at, const uint8_t *end, int most, int *count,
                                  int64_t *number)
{
    int64_t value = 0;
    int k = 0;
    for (; k < most && at + k < end; k++) {
        const unsigned digit = (unsigned)at[k] - '0';
        if (digit > 9)
            break;
        value = 10 * value + digit;
    }
    *count = k;
    *number = value;
    return at + k;
}

/* Read a stamp, in ns. The largest one is below 2^63. */
static const uint8_t *read_stamp(const uint8_t *at, const uint8_t *end, int64_t *t_ns)
{
    int64_t seconds, fraction;
    int count, decimals;
    if (at == end || *at != '(')
        return NULL;
    at = read_digits(at + 1, end, MAX_SECONDS_DIGITS, &count, &seconds);
    if (count == 0 || seconds >= 9000000000 || at == end || *at != '.')
        return NULL;
    at = read_digits(at + 1, end, NANOSECONDS, &decimals, &fraction);
    if ((decimals != MICROSECONDS && decimals != NANOSECONDS) || at == end || *at != ')')
        return NULL;
    *t_ns = seconds * 1000000000 + fraction * (decimals == MICROSECONDS ? 1000 : 1);
    return at + 1;
}

static const uint8_t *read_gap(const uint8_t *at, const uint8_t *end)
{
    if (!at)
        return NULL;
    const uint8_t *first = at;
    while (at < end && *at == ' ')
        at++;
    if (at == first || at - first > MAX_GAP)
        return NULL;
    return at;
}

static const uint8_t *read_name(const uint8_t *at, const uint8_t *end)
{
    if (!at)
        return NULL;
    const uint8_t *first = at;
    while (at < end && *at > ' ' && *at != DELETE)
        at++;
    return at > first && at - first <= CANDUMP_MAX_NAME ? at : NULL;
}

/* Read three digits and the `#` after them. */
static const uint8_t *read_id(const uint8_t *at, const uint8_t *end, uint32_t *can_id)
{
    if (!at || end - at < 4 || at[3] != '#')
        return NULL;
    const unsigned high = HEX[at[0]], middle = HEX[at[1]], low = HEX[at[2]];
    if (!(high & middle & low & IS_HEX) || high > (IS_HEX | 7))
        return NULL;
    *can_id = (high & 7) << 8 | (middle & 15) << 4 | (low & 15);
    return at + 4;
}

/* Read a second `#` and the flags of a CAN FD frame; a classic frame has neither. */
static const uint8_t *read_flags(const uint8_t *at, const uint8_t *end, uint8_t *flags)
{
    *flags = 0;
    if (!at || at == end || *at != '#')
        return at;
    const unsigned bits = end - at >= 2 ? HEX[at[1]] : 0;
    *flags = (uint8_t)(FRAME_FD | (bits & 1 ? FRAME_BRS : 0) | (bits & 2 ? FRAME_ESI : 0));
    return bits & IS_HEX ? at + 2 : NULL;
}

/* Read data bytes, as many as a frame with these flags can have; fills a row of PAYLOAD_BYTES. */
static const uint8_t *read_data(const uint8_t *at, const uint8_t *end, uint8_t flags, uint8_t *data,
                                uint8_t *length)
{
    const int most = flags ? PAYLOAD_BYTES : CLASSIC_BYTES;
    int count = 0;
    for (int k = 0; k < PAYLOAD_BYTES; k++)
        data[k] = 0;
    for (; at && end - at >= 2; at += 2) {
        const unsigned high = HEX[at[0]], low = HEX[at[1]];
        if (!(high & low & IS_HEX))
            break;
        if (count == most)
            return NULL;
        data[count++] = (uint8_t)(high << 4 | (low & 15));
    }
    *length = (uint8_t)count;
    return is_fd_length(count) ? at : NULL; /* up to 8, any length is valid */
}

/* Read what may follow the data, with the direction; returns the place of the line end. */
static const uint8_t *read_end(const uint8_t *at, const uint8_t *end, uint8_t *flags)
{
    if (!at)
        return NULL;
    if (end - at > 2 && at[0] == ' ' && (at[1] == 'R' || at[1] == 'T')) {
        *flags |= at[1] == 'T' ? FRAME_TX : 0;
        at += 2;
    }
    if (at < end && *at == '\r')
        at++;
    return at < end && *at == '\n' ? at : NULL;
}

/* Index of an interface name, which is added if it is new; -1 if the table is full. */
static int find_name(struct interface_name *names, const uint8_t *text, int64_t size)
{
    for (int n = 0; n < CANDUMP_NAMES; n++) {
        struct interface_name *name = &names[n];
        int64_t same = 0;
        if (name->length == 0) {
            for (; same < size; same++)
                name->text[same] = text[same];
            name->length = (uint8_t)size;
            return n;
        }
        if (name->length != size)
            continue;
        while (same < size && name->text[same] == text[same])
            same++;
        if (same == size)
            return n;
    }
    return -1;
}

/* Read a line with a frame into a row; returns the place of its line end. */
static const uint8_t *read_frame(const uint8_t *at, const uint8_t *end,
                                 const struct frame_columns *frames, int64_t row,
                                 struct interface_name *names)
{
    uint8_t *flags = &frames->flags[row], *data = &frames->data[row * PAYLOAD_BYTES];
    at = read_stamp(at, end, &frames->t_ns[row]);
    at = read_gap(at, end);
    const uint8_t *name = at;
    at = read_name(at, end);
    const uint8_t *name_end = at;
    at = read_gap(at, end);
    at = read_id(at, end, &frames->can_id[row]);
    at = read_flags(at, end, flags);
    at = read_data(at, end, *flags, data, &frames->length[row]);
    at = read_end(at, end, flags);
    if (!at)
        return NULL;
    const int channel = find_name(names, name, name_end - name);
    frames->channel[row] = (uint16_t)channel;
    return channel < 0 ? NULL : at;
}

/* Kind of a line without a plain frame, as far as its first characters and its length show it. */
static enum candump_line classify(const uint8_t *line, const uint8_t *end)
{
    if (end > line && end[-1] == '\r')
        end--;
    const uint8_t *at = line;
    while (at < end && (*at == ' ' || *at == '\t'))
        at++;
    if (at == end)
        return LINE_BLANK;
    if (*line == '#' || *line == ';' || (*line == '/' && end - line > 1 && line[1] == '/'))
        return LINE_COMMENT;
    const int may_be_known = *line == '(' || *line == 'D'; /* `DROPCOUNT: ...` */
    return may_be_known && end - line >= SHORTEST_LINE ? LINE_OTHER : LINE_MALFORMED;
}

int64_t candump_read(const uint8_t *text, int64_t start, int64_t size, int64_t rows,
                     const struct frame_columns *frames, struct interface_name *names,
                     uint8_t *kind, int64_t *line_start)
{
    const uint8_t *end = text + size;
    int64_t row = 0;
    line_start[0] = start;
    for (const uint8_t *line = text + start; row < rows; row++) {
        const uint8_t *at = read_frame(line, end, frames, row, names);
        if (at) {
            kind[row] = frames->flags[row] & FRAME_FD ? LINE_FD : LINE_CLASSIC;
        } else {
            for (at = line; at < end && *at != '\n';)
                at++;
            if (at == end)
                break;
            kind[row] = (uint8_t)classify(line, at);
        }
        line = at + 1;
        line_start[row + 1] = line - text;
    }
    return row;
}
