/* Steps of sensors: no motor of 850 kg warms by kelvins within seconds. */
#ifndef TRACTION_STEP_DETECTOR_H
#define TRACTION_STEP_DETECTOR_H

#include "gateway/core/records.h"

/* Number of samples that the detector uses: before + after + settled. */
int step_window(const struct step_config *config);

/* Reset a sensor to nothing known. */
void step_reset(struct step_state *state);

/* 1 if the next sample shows whether a step that was seen is one. */
int step_is_due(const struct step_config *config, const struct step_state *state);

/* Jump that the latest `step_window` residuals x show, K; NaN for too few readings. */
double step_jump(const struct step_config *config, const double *x);

/* Add one more sample: x, the latest `step_window` residuals K (reading less model), the newest
 * last, NaN without a reading. others: jump of the other motors' sensors, K; 0 if there is none. */
void step_add_sample(const struct step_config *config, struct step_state *state, const double *x,
                     double others);

/* Fill out (count) K: offset of one sensor after each of its residuals x (count). */
void step_follow(const struct step_config *config, const double *x, int64_t count, double *out);

#endif
