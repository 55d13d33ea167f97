/* Candump text to frames. */
#ifndef TRACTION_CANDUMP_READ_H
#define TRACTION_CANDUMP_READ_H

#include "gateway/core/records.h"

/* Read the complete lines of text (size) from `start` on, one row per line, `rows` at most. Fills
 * `kind` (rows) with an enum candump_line, the columns but `dlc` of each line that has a frame, and
 * `line_start` (rows + 1): where each line starts, and where the next one would start. names
 * (CANDUMP_NAMES): interface names so far; new ones are added. Returns the number of lines. */
int64_t candump_read(const uint8_t *text, int64_t start, int64_t size, int64_t rows,
                     const struct frame_columns *frames, struct interface_name *names,
                     uint8_t *kind, int64_t *line_start);

#endif
