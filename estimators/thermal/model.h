/* A motor as five lumps of heat, driven by what is on the bus: currents, speed, ambient. */
#ifndef TRACTION_THERMAL_MODEL_H
#define TRACTION_THERMAL_MODEL_H

#include "gateway/core/records.h"

/* Lump that each sensor is on. */
extern const int THERMAL_SEEN[THERMAL_POINTS];

/* K, least rise of a frame over the air that cooling is reckoned with. */
extern const double THERMAL_LEAST_RISE_K;

/* One backward Euler step of dt s: lumps x (THERMAL_LUMPS) degC, in place. extra: heat that no healthy
 * motor has, K/s into each lump. */
void thermal_model_step(const struct thermal_parameters *p, const struct thermal_input *u,
                        const double *extra, double dt, double *x);

/* Steps with the inputs u[0], u[1], .. from lumps x on, changed in place; fills out (count,
 * THERMAL_LUMPS) with the lumps at the end of the steps at[0] <= at[1] <= .., and ends with the last
 * of them. */
void thermal_model_simulate(const struct thermal_parameters *p, const struct thermal_input *u,
                            const double *extra, double dt, const int64_t *at, int64_t count,
                            double *x, double *out);

/* Fill a (THERMAL_LUMPS, THERMAL_LUMPS) 1/s: how fast deviations of the lumps change; row: lump that
 * changes. */
void thermal_model_system_matrix(const struct thermal_parameters *p, double current_square,
                                 double speed, double *a);

/* Resistance of the winding at `winding` degC, over that at 60 degC. */
double thermal_model_resistance(double winding);

#endif
