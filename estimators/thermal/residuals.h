/* Residuals of every motor's readings, sample by sample. */
#ifndef TRACTION_THERMAL_RESIDUALS_H
#define TRACTION_THERMAL_RESIDUALS_H

#include "gateway/core/records.h"

/* Reset a motor to nothing known; it starts with its next readings. */
void thermal_motor_reset(const struct thermal_config *config, struct thermal_motor *motor);

/* Find the lumps x (THERMAL_LUMPS) degC of a motor with readings (THERMAL_POINTS) degC, NaN
 * without; returns 1. 0: there is no reading at all, x is not changed. */
int thermal_motor_start(const struct thermal_parameters *p, const struct thermal_input *u,
                        const double *reading, double *x);

/* Add one sample of all motors to the current block: reading (motors, THERMAL_POINTS) degC, input
 * (motors), NaN without. A motor that is cut out, or whose inputs were unknown for too long, is
 * reset and is `lost`. */
void thermal_add_sample(struct thermal_monitor *all, const double *reading,
                        const struct thermal_input *input);

#endif
