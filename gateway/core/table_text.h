/* Numbers of many ticks as lines of a table. */
#ifndef TRACTION_TABLE_TEXT_H
#define TRACTION_TABLE_TEXT_H

#include "gateway/core/records.h"

/* Lines of the rows from `first` to `last` - 1 into text (size), as long as there is room: seconds with
 * nine decimals, node, then the columns, with commas between them. A number has the bytes of printf's
 * %.*f, and NaN is an empty field. Returns the first row that is not written: for want of room, before
 * the time 0, or with a number of 2^52 units of its last decimal and more. The bytes are in *filled. */
int64_t table_write(const struct table *table, int64_t first, int64_t last, uint8_t *text,
                    int64_t size, int64_t *filled);

#endif
