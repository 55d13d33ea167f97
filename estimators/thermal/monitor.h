/* Thermal faults while they happen: blocks of residuals compared, every motor judged. */
#ifndef TRACTION_THERMAL_MONITOR_H
#define TRACTION_THERMAL_MONITOR_H

#include "gateway/core/records.h"

/* A block is complete: compare the motors. workspace: 8 numbers per motor. */
void thermal_close_block(const struct thermal_config *config,
                         const struct thermal_motor_config *known, struct thermal_motor *motor,
                         int motors, double *workspace);

/* What one motor's mean inputs of a block make of disturbances and faults. */
void thermal_surroundings(const struct thermal_config *config, const struct thermal_parameters *p,
                          const struct thermal_sums *inputs, struct imm_surroundings *out);

/* The block that was closed last through the filters of one motor. */
void thermal_judge_block(const struct thermal_config *config,
                         const struct thermal_motor_config *known, struct thermal_motor *motor);

/* Log likelihood of one motor's fault-free blocks: off (blocks, THERMAL_POINTS) K from the others,
 * inputs (blocks). config: with one mode. */
double thermal_likelihood(const struct thermal_config *config,
                          const struct thermal_motor_config *known, const double *off,
                          const struct thermal_sums *inputs, int blocks);

#endif
