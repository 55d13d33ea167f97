/* Thermal networks of the simulator. */
#ifndef TRACTION_SIM_THERMAL_H
#define TRACTION_SIM_THERMAL_H

#include "sim/records.h"

/* One explicit step of `dt` s of M networks: temperatures (M, SIM_NODES) degC. sources: (M,
 * SIM_NODES) W; links: (M, SIM_NODES, SIM_NODES + 1) W/K, the last column to the air; capacity:
 * (SIM_NODES) J/K, above 0; air_c: (M) degC. All time constants are above 20 s, so a step of 10 ms
 * errs below 1e-3. */
void sim_heat_step(int64_t motors, const double *sources, const double *links,
                   const double *capacity, const double *air_c, double dt, double *temperatures);

/* All steps of a record, from the temperatures (M, SIM_NODES) on; fills out (K, M, SIM_NODES) with
 * the temperatures at the end of the steps `at`. */
void sim_heat_record(const struct sim_heat_record *record, double *temperatures, double *out);

#endif
