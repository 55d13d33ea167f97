/* The train as all its rotors and commands show it together, before any drive is judged. */
#ifndef TRACTION_TRAIN_H
#define TRACTION_TRAIN_H

#include "gateway/core/records.h"

/* Nothing known of n rotors; their ratings (rated_nm, inertia_kg_m2, motor) stay. */
void train_reset(struct rotor *rotors, int n);

/* Once a tick of `tick_s` s, after the estimates and before they are compared. Clears command_valid
 * of inputs whose command cannot be right, and says by `not_judged` of which drives the estimate is
 * not used, with health and reason. `workspace` holds 2 n numbers. */
void assess_train(struct rotor *rotors, struct rotor_inputs *inputs, int n, int64_t now_ns,
                  double tick_s, double *workspace);

#endif
