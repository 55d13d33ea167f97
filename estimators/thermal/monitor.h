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

/* One sample of all motors: reading (motor_count, THERMAL_POINTS) degC, input (motor_count), NaN where
 * there is none. The last one of a block closes it. */
void thermal_monitor_add_sample(struct thermal_monitor *all, const double *reading,
                                const struct thermal_input *input);

/* A block ends: judge the motors that still wait for the one before, and compare all; now they wait
 * to be judged. */
void thermal_monitor_close_block(struct thermal_monitor *all);

/* Judge at most so many of the motors that wait: a block of many must not make one tick late. */
void thermal_monitor_judge(struct thermal_monitor *all, int count);

/* Fill kind (motors, THERMAL_KINDS): probability of every kind of fault by now. A sensor that has
 * stepped is off for certain, whatever else is wrong beside it. */
void thermal_kinds(const struct thermal_motor *motor, int motors, double *kind);

/* Log likelihood of one motor's fault-free blocks: off (blocks, THERMAL_POINTS) K from the others,
 * inputs (blocks). config: with one mode. */
double thermal_likelihood(const struct thermal_config *config,
                          const struct thermal_motor_config *known, const double *off,
                          const struct thermal_sums *inputs, int blocks);

/* What the healthy filter expects of the same blocks, each from those before: mean (blocks,
 * THERMAL_POINTS) K, cov (blocks, THERMAL_POINTS, THERMAL_POINTS) K^2 without the readings' noise.
 * config: with one mode. */
void thermal_expected(const struct thermal_config *config, const struct thermal_motor_config *known,
                      const double *off, const struct thermal_sums *inputs, int blocks,
                      double *mean, double *cov);

#endif
