/* Which motors are cut out. */
#ifndef TRACTION_THERMAL_CUT_OUT_H
#define TRACTION_THERMAL_CUT_OUT_H

#include "gateway/core/records.h"

/* Add one sample of all motors' currents, NaN if unknown, and find the motors that are cut out. Where
 * no motor is driven, all stay what they were. */
void find_cut_out(const struct cut_out_config *config, const struct thermal_input *input,
                  int motors, struct motor_current *current);

#endif
