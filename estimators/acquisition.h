/* Acquisition: speed and angle of a rotor from flux chords, and whether a filter agrees with them. */
#ifndef TRACTION_ACQUISITION_H
#define TRACTION_ACQUISITION_H

#include "gateway/core/records.h"

/* Nothing seen yet: after a long silence, or with a new motor. */
void acquisition_restart(struct acquisition *drive);

/* Feed m samples of any drives, in order of time; motors and drives by `sample.drive`, dt: sub-step,
 * s. A sample that is not finite, or beyond any motor, breaks the chord that it falls into. */
void acquisition_add(const struct filter_sample *samples, int m, const struct pmsm *motors,
                     struct acquisition *drives, const struct acquisition_limits *limits,
                     double dt);

/* Angle at the last sample, the speed constant since the last chord: in (-pi, pi], rad. */
double acquisition_theta(const struct acquisition *drive);

/* Start a filter at the last sample; meaningful where `ready`, finite always. Currents from that
 * sample with variance R (A^2, alpha and beta), w and theta from the chords, T_L from the
 * electromagnetic torque (no acceleration assumed) with the rated torque, Nm, as deviation. */
void acquisition_start_filter(const struct acquisition *drive, const struct pmsm *motor,
                              const double *R, double T_rated, struct filter *filter);

/* enum consistency of a filter with the chords, both at the last sample; silence is the caller's to
 * notice. Where the chords are not ready, a filter is INCONSISTENT still if its speed is far above
 * what their length allows: a rotor at rest cannot have moved the flux. A state that is not finite
 * is INCONSISTENT. */
int acquisition_check(const struct acquisition *drive, const struct filter *filter);

#endif
