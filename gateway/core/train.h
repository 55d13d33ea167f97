/* The train, as all its rotors and commands together show it, before any drive is judged. */
#ifndef TRACTION_TRAIN_H
#define TRACTION_TRAIN_H

#include "gateway/core/records.h"

/* Reset n rotors to nothing known; their ratings (rated_nm, inertia_kg_m2, motor) stay. */
void train_reset(struct rotor *rotors, int n);

/* Once a tick of `tick_s` s, after the estimates and before they are compared. Clears command_valid
 * of inputs whose command cannot be right. Sets `not_judged`, health and reason of drives whose
 * estimate is not used. `workspace` holds 2 n numbers. */
void assess_train(struct rotor *rotors, struct rotor_inputs *inputs, int n, int64_t now_ns,
                  double tick_s, double *workspace);

/* Largest load, per unit of rated torque, of a drive that is asked for `asked`, also per unit. */
double most_load(double asked);

#endif
