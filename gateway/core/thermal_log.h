/* What the sensors read, cycle by cycle: what a calibration is learnt from. */
#ifndef TRACTION_THERMAL_LOG_H
#define TRACTION_THERMAL_LOG_H

#include "gateway/core/records.h"

/* Note the last temperature cycle, if it has not been noted yet. There has to be room for it. */
void note_temperature_cycle(struct temperature_log *log, const struct temperature_monitor *all,
                            int64_t now_ns);

/* Ticks at now_ns, a period later and so on, in which nothing but temperatures, and what they are
 * learnt with, is worked out: frames are received, and cycles noted. Their number, at most `ticks`.
 * Tick k takes the rows from ends[k - 1] (0 for the first) to ends[k] of `frames`. Ends before a tick
 * for whose cycle there is no room in `log`, or whose frames are not in order. */
int64_t run_temperatures(struct gateway *g, struct temperature_log *log,
                         const struct frame_columns *frames, const int64_t *ends, int64_t ticks,
                         int64_t now_ns);

#endif
