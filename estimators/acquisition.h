/* Acquisition: speed and angle of a rotor from flux chords, and check of a filter against them. */
#ifndef TRACTION_ACQUISITION_H
#define TRACTION_ACQUISITION_H

#include "gateway/core/records.h"

/* Reset to nothing seen: after a long silence, or for a new motor. */
void acquisition_restart(struct acquisition *drive);

/* Feed m samples of any drives, in order of time; motors and drives: by `sample.drive`; dt: of a
 * sub-step, s. A sample that is not finite, or beyond any motor, breaks the chord it falls into. */
void acquisition_add(const struct filter_sample *samples, int m, const struct pmsm *motors,
                     struct acquisition *drives, const struct acquisition_limits *limits,
                     double dt);

/* Angle at the last sample, with constant speed since the last chord: in (-pi, pi], rad. */
double acquisition_theta(const struct acquisition *drive);

/* Start a filter at the last sample; meaningful if `ready`, always finite. Currents are those of
 * that sample with variance R (A^2, alpha and beta), w and theta come from the chords, T_L from the
 * electromagnetic torque (no acceleration assumed), with the rated torque, Nm, as deviation. */
void acquisition_start_filter(const struct acquisition *drive, const struct pmsm *motor,
                              const double *R, double T_rated, struct filter *filter);

/* enum consistency of a filter with the chords, both at the last sample; the caller must detect
 * silence. If the chords are not ready, a filter is still INCONSISTENT if its speed is far above
 * what their length allows: a rotor at rest cannot have moved the flux. A state that is not finite
 * is INCONSISTENT. */
int acquisition_check(const struct acquisition *drive, const struct filter *filter);

#endif
