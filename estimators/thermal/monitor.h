/* Detection of thermal faults in operation: compares blocks of residuals and judges each motor. */
#ifndef TRACTION_THERMAL_MONITOR_H
#define TRACTION_THERMAL_MONITOR_H

#include "gateway/core/records.h"

/* Close a block: compare the motors. workspace: 8 numbers per motor. */
void thermal_close_block(const struct thermal_config *config,
                         const struct thermal_motor_config *known, struct thermal_motor *motor,
                         int motors, double *workspace);

/* Effect of disturbances and faults on one motor, for its mean inputs of a block. */
void thermal_surroundings(const struct thermal_config *config, const struct thermal_parameters *p,
                          const struct thermal_sums *inputs, struct imm_surroundings *out);

/* Pass the block that was closed last through the filters of one motor. */
void thermal_judge_block(const struct thermal_config *config,
                         const struct thermal_motor_config *known, struct thermal_motor *motor);

/* Add one sample of all motors: reading (motor_count, THERMAL_POINTS) degC, input (motor_count),
 * NaN if not available. The last sample of a block closes it. */
void thermal_monitor_add_sample(struct thermal_monitor *all, const double *reading,
                                const struct thermal_input *input);

/* Close a block: judge the motors that still wait for the one before, and compare all; then they
 * wait to be judged. */
void thermal_monitor_close_block(struct thermal_monitor *all);

/* Judge at most `count` of the waiting motors, so that a block of many does not delay one tick. */
void thermal_monitor_judge(struct thermal_monitor *all, int count);

/* 1 if sensor q has crept away, which is likely, and a step of step_k K brings it back. */
int thermal_sensor_returns(const struct thermal_motor *motor, int q, double step_k);

/* Fill kind (motors, THERMAL_KINDS): present probability of every kind of fault. A sensor that has
 * stepped is certainly off, whatever other fault exists. */
void thermal_kinds(const struct thermal_motor *motor, int motors, double *kind);

/* Log likelihood of one motor's fault-free blocks: off (blocks, THERMAL_POINTS) K relative to the
 * others, inputs (blocks). config: with one mode. */
double thermal_likelihood(const struct thermal_config *config,
                          const struct thermal_motor_config *known, const double *off,
                          const struct thermal_sums *inputs, int blocks);

/* Predictions of the healthy filter for the same blocks, each from those before: mean (blocks,
 * THERMAL_POINTS) K, cov (blocks, THERMAL_POINTS, THERMAL_POINTS) K^2 without the readings' noise.
 * config: with one mode. */
void thermal_expected(const struct thermal_config *config, const struct thermal_motor_config *known,
                      const double *off, const struct thermal_sums *inputs, int blocks,
                      double *mean, double *cov);

#endif
