/* Offsets and gain mismatch of the current sensors, learnt while the rotor turns; an open phase. */
#ifndef TRACTION_CURRENT_CALIBRATION_H
#define TRACTION_CURRENT_CALIBRATION_H

#include "gateway/core/records.h"

/* Correct the currents of m samples, in place, by the errors known so far, and learn from them.
 * chords: speeds of the drives; I_rated: their rated currents, A, above 0; dt: sub-step, s. A sample
 * that is not finite, or beyond any motor, restarts the revolution. */
void calibrate_currents(struct filter_sample *samples, int m, struct current_calibration *drives,
                        const struct acquisition *chords, const double *I_rated, double dt);

/* 1 if the current stays on one line although the rotor turns: a phase is open. w_e: electrical
 * speed, rad/s, from another source. If speed or current is too low, the result does not change. */
int is_single_axis_current(struct current_calibration *drive, double w_e);

#endif
