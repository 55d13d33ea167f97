/* Drives and train of the simulator. */
#ifndef TRACTION_SIM_PLANT_H
#define TRACTION_SIM_PLANT_H

#include "sim/records.h"

/* Torque on the rail, Nm, at sliding speed `slide`, m/s (sim/physics/adhesion.py has the source). */
double sim_creep_torque(const struct sim_contact *contact, double slide);

/* Move one drive by `steps` steps of `h` s at constant voltage, V. The friction brake opposes the
 * rotation: it stops the wheel but never turns it, and holds it at rest while motor and rail
 * together have no more torque than the brake. */
void sim_integrate(const struct sim_motor *motor, const struct sim_contact *contact, double u_alpha,
                   double u_beta, double h, int64_t steps, struct sim_drive *drive);

/* Move the train and its N drives by n periods; fills out (n, N, OUT_COLUMNS), the state at the end
 * of each. Drives report the train's command as theirs; `share` acts only on what they deliver.
 * Speed references are those of a rotor with a nominal wheel. While all friction brakes
 * are applied, the driver's demand falls to 0. */
void sim_advance(struct sim_train *train, const struct sim_motor *motors, struct sim_drive *drives,
                 const struct sim_schedule *schedule, double *out);

#endif
