/* Log of ticks for a report, one row each. */
#ifndef TRACTION_TICK_LOG_H
#define TRACTION_TICK_LOG_H

#include "gateway/core/records.h"

/* 1 if there is a log that has no room for another tick. */
int is_log_full(const struct tick_log *log);

/* Log the tick that has just ended, at now_ns; does nothing if there is no log, or it is full. */
void log_tick(const struct gateway *g, struct tick_log *log, int64_t now_ns);

#endif
