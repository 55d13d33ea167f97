/* Numbers of many ticks written as lines of a table. */
#ifndef TRACTION_TABLE_TEXT_H
#define TRACTION_TABLE_TEXT_H

#include "gateway/core/records.h"

/* Write the rows from `first` to `last` - 1 as lines into text (size) while there is room: seconds
 * with nine decimals, node, the columns, with commas between them. Numbers are as by printf's
 * %.*f, NaN is an empty field. Returns the first row not written: there is no room, its time is
 * below 0, or a number has 2^52 units of its last decimal or more. *filled: bytes written. */
int64_t table_write(const struct table *table, int64_t first, int64_t last, uint8_t *text,
                    int64_t size, int64_t *filled);

#endif
