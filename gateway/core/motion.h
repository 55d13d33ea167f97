/* Comparison of measured speeds with the estimates: load by an observer, and implausible input. */
#ifndef TRACTION_MOTION_H
#define TRACTION_MOTION_H

#include "gateway/core/records.h"

/* Once a tick, after the filters: follow the readings of Motion, check currents and Motion against
 * each other (plausibility.c), and select the source of each estimate. Changes `estimates` to those
 * that are to be used, and sets `implausible` of drives with implausible input. */
void observe_load(struct motion_monitor *m, int64_t now_ns);

/* The first and the last part of observe_load. */
void follow_readings(const struct motion_monitor *m);
void select_sources(struct motion_monitor *m, int64_t now_ns);

#endif
