/* Thermal model of a motor as five lumps, with the inputs on the bus: currents, speed, ambient. */
#ifndef TRACTION_THERMAL_MODEL_H
#define TRACTION_THERMAL_MODEL_H

#include "gateway/core/records.h"

/* Lump on which each sensor is. */
extern const int THERMAL_SEEN[THERMAL_POINTS];

/* K, least rise of a frame over the air that cooling is computed with. */
extern const double THERMAL_LEAST_RISE_K;

/* One backward Euler step of dt s: lumps x (THERMAL_LUMPS) degC, in place. extra: heat that no healthy
 * motor has, K/s into each lump. */
void thermal_model_step(const struct thermal_parameters *p, const struct thermal_input *u,
                        const double *extra, double dt, double *x);

/* Steps with the inputs u[0], u[1], .. starting at lumps x, changed in place; fills out (count,
 * THERMAL_LUMPS) with the lumps at the end of the steps at[0] <= at[1] <= .., and stops after the
 * last of these. */
void thermal_model_simulate(const struct thermal_parameters *p, const struct thermal_input *u,
                            const double *extra, double dt, const int64_t *at, int64_t count,
                            double *x, double *out);

/* Fill a (THERMAL_LUMPS, THERMAL_LUMPS) 1/s: rates at which deviations of the lumps change; row:
 * the lump that changes. */
void thermal_model_system_matrix(const struct thermal_parameters *p, double current_square,
                                 double speed, double *a);

/* Resistance of the winding at `winding` degC relative to that at 60 degC. */
double thermal_model_resistance(double winding);

#endif
