/* Ticks as a report keeps them, one row each. */
#ifndef TRACTION_TICK_LOG_H
#define TRACTION_TICK_LOG_H

#include "gateway/core/records.h"

/* 1: there is a log, and it has no room for a tick. */
int is_log_full(const struct tick_log *log);

/* The tick that has just ended, at now_ns, into a log; nothing where there is none, or it is full. */
void log_tick(const struct gateway *g, struct tick_log *log, int64_t now_ns);

#endif
