/* Plain lines of text logs (ASC, TRC) to times, heads, data; dbc/logs/text.py handles all others.
 *
 *     line  = word* time word{n} (blank+ byte)* anything LF      byte = two hexadecimal digits
 *
 * A head is the n words between time and data, with the blanks between them: channel, identifier,
 * direction, length. The same heads recur, so Python parses each of them only once.
 *
 * Each function that reads a part of a line returns the place after it, or NULL if the text is
 * not such a part. None can fail: no byte at or after `end` is read, the search for a head
 * ends after TEXT_PROBES places, and a time is checked before it is multiplied. */
#include "dbc/text_read.h"

#include <stddef.h>
#include <string.h>

enum { IS_HEX = 16, MAX_DECIMALS = 9, MAX_DIGITS = 12, TEXT_PROBES = 32 };
static const int64_t LATEST_NS = INT64_C(4000000000000000000);

/* A hexadecimal digit: IS_HEX and its value. Any other character: 0. */
static unsigned hex_digit(uint8_t c)
{
    if (c >= '0' && c <= '9')
        return IS_HEX | (unsigned)(c - '0');
    const unsigned letter = (unsigned)(c | 32) - 'a';
    return letter < 6 ? IS_HEX | (letter + 10) : 0;
}

static int is_blank(uint8_t c)
{
    return c == ' ' || c == '\t';
}

static const uint8_t *skip_blanks(const uint8_t *at, const uint8_t *end)
{
    while (at < end && is_blank(*at))
        at++;
    return at;
}

/* The place after a word that starts here; NULL if none does. */
static const uint8_t *skip_word(const uint8_t *at, const uint8_t *end)
{
    const uint8_t *first = at;
    while (at < end && *at > ' ')
        at++;
    return at > first ? at : NULL;
}

/* Read a decimal number of units, in ns: digits, and optionally a point and up to nine more. */
static const uint8_t *read_time(const uint8_t *at, const uint8_t *end, int64_t unit_ns,
                                int64_t *t_ns)
{
    int64_t whole = 0, part = 0, scale = 1;
    int digits = 0, decimals = 0;
    for (; at < end && *at >= '0' && *at <= '9' && digits <= MAX_DIGITS; at++, digits++)
        whole = 10 * whole + (*at - '0');
    if (digits == 0 || digits > MAX_DIGITS || whole > LATEST_NS / unit_ns)
        return NULL;
    if (at < end && *at == '.') {
        for (at++; at < end && *at >= '0' && *at <= '9' && decimals <= MAX_DECIMALS; at++) {
            part = 10 * part + (*at - '0');
            scale *= 10;
            decimals++;
        }
    }
    if (decimals > MAX_DECIMALS || (unit_ns % scale != 0 && part != 0))
        return NULL;
    *t_ns = whole * unit_ns + (unit_ns % scale == 0 ? part * (unit_ns / scale) : 0);
    return at < end && is_blank(*at) ? at : NULL;
}

/* Index of a head in the table, to which it is added if it is new; -1: there is no room. */
static int32_t find_head(struct text_head *heads, const uint8_t *text, int64_t size)
{
    if (size <= 0 || size > TEXT_MAX_HEAD)
        return -1;
    uint32_t hash = 2166136261u;
    for (int64_t k = 0; k < size; k++)
        hash = (hash ^ text[k]) * 16777619u;
    for (uint32_t probe = 0; probe < TEXT_PROBES; probe++) {
        const uint32_t place = (hash + probe) % TEXT_HEADS;
        struct text_head *one = &heads[place];
        if (one->length == 0) {
            for (int64_t k = 0; k < size; k++)
                one->text[k] = text[k];
            one->length = (uint8_t)size;
            return (int32_t)place;
        }
        if (one->length == size && memcmp(one->text, text, (size_t)size) == 0)
            return (int32_t)place;
    }
    return -1;
}

/* Read bytes, each after a blank; fills a row. Returns their number, at most PAYLOAD_BYTES. */
static uint8_t read_bytes(const uint8_t *at, const uint8_t *end, uint8_t *data)
{
    int count = 0;
    for (int k = 0; k < PAYLOAD_BYTES; k++)
        data[k] = 0;
    while (count < PAYLOAD_BYTES) {
        const uint8_t *word = skip_blanks(at, end);
        if (word == at || end - word < 2)
            break;
        const unsigned high = hex_digit(word[0]), low = hex_digit(word[1]);
        if (!(high & low & IS_HEX) || (end - word > 2 && word[2] > ' '))
            break;
        data[count++] = (uint8_t)((high & 15) << 4 | (low & 15));
        at = word + 2;
    }
    return (uint8_t)count;
}

/* Read one line, without its line end, into a row. Returns the index of its head, or -1. */
static int32_t read_line(const uint8_t *at, const uint8_t *end, const struct text_shape *shape,
                         const struct frame_columns *frames, int64_t row, struct text_head *heads)
{
    at = skip_blanks(at, end);
    for (int k = 0; at && k < shape->words_before; k++) {
        at = skip_word(at, end);
        at = at ? skip_blanks(at, end) : NULL;
    }
    at = at ? read_time(at, end, shape->unit_ns, &frames->t_ns[row]) : NULL;
    if (!at)
        return -1;
    const uint8_t *head = skip_blanks(at, end);
    at = head;
    for (int k = 0; at && k < shape->head_words; k++) {
        const uint8_t *word = skip_blanks(at, end);
        at = skip_word(word, end);
        if (k == shape->marker_word && at && (at - word != 1 || *word != shape->marker))
            return -1;
    }
    if (!at)
        return -1;
    frames->length[row] = read_bytes(at, end, &frames->data[row * PAYLOAD_BYTES]);
    return find_head(heads, head, at - head);
}

int64_t text_read(const uint8_t *text, int64_t size, int64_t rows, const struct text_shape *shape,
                  const struct frame_columns *frames, struct text_head *heads, int32_t *head,
                  int64_t *line_start)
{
    int64_t row = 0, at = 0;
    line_start[0] = 0;
    for (; row < rows && at < size; row++) {
        const uint8_t *line_end = memchr(text + at, '\n', (size_t)(size - at));
        if (!line_end)
            break;
        head[row] = read_line(text + at, line_end, shape, frames, row, heads);
        at = line_end - text + 1;
        line_start[row + 1] = at;
    }
    return row;
}
