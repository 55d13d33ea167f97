/* Plain lines of text logs other than candump's: time, a head, data. */
#ifndef TRACTION_TEXT_READ_H
#define TRACTION_TEXT_READ_H

#include "gateway/core/records.h"

/* Read the complete lines of text (size), one row per line, `rows` at most. Fills
 * `t_ns`, `length` and `data` of `frames`, `head` (rows) with the index of the line's head in
 * `heads` (TEXT_HEADS), or -1 for a line that is not plain, and `line_start` (rows + 1): where each
 * line starts, and where the next one would. New heads are added. Returns the number of lines. */
int64_t text_read(const uint8_t *text, int64_t size, int64_t rows, const struct text_shape *shape,
                  const struct frame_columns *frames, struct text_head *heads, int32_t *head,
                  int64_t *line_start);

#endif
