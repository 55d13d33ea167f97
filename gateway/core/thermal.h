/* Temperatures of the motors: readings, seconds, window averages, and evidence for two flags. */
#ifndef TRACTION_THERMAL_H
#define TRACTION_THERMAL_H

#include "gateway/core/records.h"

/* Reset to nothing received; constants stay. */
void temperatures_reset(struct temperature_monitor *all);

/* One tick: receive the readings of the last frames (receiver->tick), then advance_temperatures and
 * report_temperatures. */
void monitor_temperatures(struct temperature_monitor *all, const struct receiver *receiver,
                          int64_t now_ns, struct flag_inputs *out);

/* Value of one point (of READING_POINTS) in a decoded row of temperatures, degC; NaN: not valid. */
double reading_c(const struct receiver *receiver, int64_t row, int point);

/* Receive the readings of the last frames. 1 if there were any. */
int receive_temperatures(struct temperature_monitor *all, const struct receiver *receiver);

/* Once per temperature cycle, average what is valid; once a second, feed the thermal model, which
 * judges one motor per tick. received: 1 if there were readings in this tick. receiver: NULL if
 * nothing else is known of the drives. */
void advance_temperatures(struct temperature_monitor *all, const struct receiver *receiver,
                          int received, int64_t now_ns);

/* Report the evidence of every motor if it can have changed since the last call: fills the
 * temperature fields of out (drive_count). */
void report_temperatures(struct temperature_monitor *all, int64_t now_ns, struct flag_inputs *out);

/* Report the evidence of motor j; returns until when it stands if nothing is received. */
int64_t report_motor(struct temperature_monitor *all, int j, int64_t now_ns,
                     struct flag_inputs *out);

#endif
