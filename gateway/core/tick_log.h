/* Ticks as a report keeps them, one row each. */
#ifndef TRACTION_TICK_LOG_H
#define TRACTION_TICK_LOG_H

#include "gateway/core/records.h"

/* 1: a log is wanted, and has no room for a tick. */
int is_log_full(const struct gateway *g);

/* The tick that has just ended, at now_ns, into `g->log`; nothing where none is wanted or it is full:
 * `run` ends before that, and whoever asks for single ticks makes room after each. */
void log_tick(struct gateway *g, int64_t now_ns);

#endif
