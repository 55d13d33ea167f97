/* Frames to candump text. */
#ifndef TRACTION_CANDUMP_WRITE_H
#define TRACTION_CANDUMP_WRITE_H

#include "gateway/core/records.h"

/* Write the line of one frame, without its line end, to text (CANDUMP_MAX_TEXT). flags and dlc as in
 * enum frame_flag and `struct frame_columns`; data (length). Returns the bytes of the line; 0 for
 * a time, an identifier, a name, flags or a length that candump cannot express. */
int64_t candump_write_line(int64_t t_ns, int64_t can_id, int32_t flags, int32_t dlc, int64_t length,
                           const uint8_t *data, const struct interface_name *name, uint8_t *text);

/* Write the lines of the frames from row `first` to `last` - 1, with line ends, as long as
 * text (size) has room and a line can express the frame. names: by `channel`. Returns the first row
 * that is not written; *filled is the number of bytes written. */
int64_t candump_write(const struct frame_columns *frames, int64_t first, int64_t last,
                      const struct interface_name *names, uint8_t *text, int64_t size,
                      int64_t *filled);

#endif
