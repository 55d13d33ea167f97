/* Numbers of many ticks written as lines of a table.
 *
 * Each function that writes a part of a line returns the place after it. None can fail: a row that
 * has no valid form is left to the caller. */
#include "gateway/core/table_text.h"

#include <math.h>

enum { NS_PER_S = 1000000000, MAX_DIGITS = 20 };

static const double EXACT = 4503599627370496.0; /* 2^52: from there on doubles are whole numbers */
static const double POWER[] = {1.0, 1e1, 1e2, 1e3, 1e4}; /* of ten, by TABLE_MAX_DECIMALS */

/* Write a number that is not negative, with at least `count` digits. */
static uint8_t *write_number(uint8_t *at, uint64_t number, int count)
{
    uint8_t digits[MAX_DIGITS];
    int used = 0;
    for (uint64_t left = number; left > 0 || used < count; left /= 10)
        digits[used++] = (uint8_t)('0' + left % 10);
    while (used > 0)
        *at++ = digits[--used];
    return at;
}

/* Write a scaled number with its decimals after a point. */
static uint8_t *write_scaled(uint8_t *at, uint64_t scaled, int decimals)
{
    const uint64_t one = (uint64_t)POWER[decimals];
    at = write_number(at, scaled / one, 1);
    *at++ = '.';
    return write_number(at, scaled % one, decimals);
}

/* A value in units of its last decimal, rounded to the nearest, half to even. Exact, because the
 * rounding error of the product is itself a double. */
static uint64_t rounded(double value, int decimals)
{
    const double scaled = value * POWER[decimals], below = floor(scaled);
    const double beyond = scaled - below - 0.5;
    const double exact = beyond != 0.0 ? beyond : fma(value, POWER[decimals], -scaled);
    const uint64_t whole = (uint64_t)below;
    return whole + (exact > 0.0 || (exact == 0.0 && whole % 2 == 1));
}

static uint8_t *write_field(uint8_t *at, const struct table_column *column, int64_t row)
{
    *at++ = ',';
    if (column->code) {
        const struct table_word *word = &column->words[column->code[row]];
        for (int k = 0; k < word->length; k++)
            *at++ = word->text[k];
        return at;
    }
    const double value = column->value[row];
    if (isnan(value))
        return at;
    if (signbit(value))
        *at++ = '-';
    return write_scaled(at, rounded(fabs(value), column->decimals), column->decimals);
}

static int fits(const struct table *table, int64_t row)
{
    for (int32_t k = 0; k < table->column_count; k++) {
        const struct table_column *column = &table->columns[k];
        if (!column->code && fabs(column->value[row]) * POWER[column->decimals] >= EXACT)
            return 0;
    }
    return table->t_ns[row / table->drive_count] >= 0;
}

static uint8_t *write_line(uint8_t *at, const struct table *table, int64_t row)
{
    const uint64_t t_ns = (uint64_t)table->t_ns[row / table->drive_count];
    at = write_number(at, t_ns / NS_PER_S, 1);
    *at++ = '.';
    at = write_number(at, t_ns % NS_PER_S, 9);
    *at++ = ',';
    at = write_number(at, (uint64_t)table->nodes[row % table->drive_count], 1);
    for (int32_t k = 0; k < table->column_count; k++)
        at = write_field(at, &table->columns[k], row);
    *at++ = '\n';
    return at;
}

int64_t table_write(const struct table *table, int64_t first, int64_t last, uint8_t *text,
                    int64_t size, int64_t *filled)
{
    const int64_t most = TABLE_MAX_HEAD + (int64_t)table->column_count * TABLE_MAX_FIELD;
    uint8_t *at = text;
    int64_t row = first;
    while (row < last && text + size - at >= most && fits(table, row))
        at = write_line(at, table, row++);
    *filled = at - text;
    return row;
}
