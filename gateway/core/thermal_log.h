/* Log of the sensors' readings, cycle by cycle, from which a calibration is learnt. */
#ifndef TRACTION_THERMAL_LOG_H
#define TRACTION_THERMAL_LOG_H

#include "gateway/core/records.h"

/* Log the last temperature cycle, unless it has been logged already. There must be room for it. */
void note_temperature_cycle(struct temperature_log *log, const struct temperature_monitor *all,
                            int64_t now_ns);

/* Run ticks at now_ns, a period later and so on, that compute only temperatures and what they are
 * learnt with: frames are received, and cycles logged. Returns their number, at most `ticks`. Tick
 * k takes the rows from ends[k - 1] (0 for the first) to ends[k] of `frames`. Stops before a tick
 * for whose cycle there is no room in `log`, or whose frames are not in order. */
int64_t run_temperatures(struct gateway *g, struct temperature_log *log,
                         const struct frame_columns *frames, const int64_t *ends, int64_t ticks,
                         int64_t now_ns);

#endif
