/* Measured speeds beside the estimates: load by an observer, and input that cannot be right. */
#ifndef TRACTION_MOTION_H
#define TRACTION_MOTION_H

#include "gateway/core/records.h"

/* Once a tick, after the filters: follow the readings of Motion, check currents and Motion against
 * one another (plausibility.c), and select the source of each estimate. Changes `estimates` to what
 * is to be used, and sets `implausible` of drives whose input cannot be what it seems. */
void observe_load(struct motion_monitor *m, int64_t now_ns);

/* The first and the last part of it. */
void follow_readings(const struct motion_monitor *m);
void select_sources(struct motion_monitor *m, int64_t now_ns);

#endif
