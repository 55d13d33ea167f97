/* Extended Kalman filter of one temperature: paper `thermal`, Table 2 and eq. (1). */
#ifndef TRACTION_RIVAL_EKF_H
#define TRACTION_RIVAL_EKF_H

#include "gateway/core/records.h"

/* Fill out (samples,) with the innovations of one point over their standard deviation, 0 if there
 * is no reading.
 *
 * reading (samples,): degC, not finite if there is none; at (samples,): step of `inputs` at whose
 * end each was taken, ascending, from 0; inputs: of this motor, at least up to the last step. */
void lumped_innovations(const struct lumped_model *model, const struct lumped_tuning *tuning,
                        const struct thermal_input *inputs, const double *reading,
                        const int64_t *at, int64_t samples, double *out);

#endif
