/* Evidence from one motor's temperatures: of its sensors, and by its thermal model or MAISD. */
#ifndef TRACTION_THERMAL_EVIDENCE_H
#define TRACTION_THERMAL_EVIDENCE_H

#include "gateway/core/records.h"

/* Evidence if nothing is known, for this enum reason. */
struct thermal_evidence no_evidence(uint8_t reason);

/* Judge motor j. Two questions are kept apart, so that a dead sensor never makes a motor hot: is
 * each sensor valid, and, if all are, what is wrong with the motor. */
void judge_temperatures(const struct temperature_monitor *all, int j, int64_t now_ns,
                        struct thermal_evidence *out);

/* Feed a complete second to the thermal model: its monitor, steps and trends. Without a model, find
 * the motors that are cut out, which otherwise the monitor does. */
void add_thermal_second(struct temperature_monitor *all);

#endif
