/* The train, as all its rotors and commands together show it, before any drive is judged. */
#ifndef TRACTION_TRAIN_H
#define TRACTION_TRAIN_H

#include "gateway/core/records.h"

/* Reset n rotors to nothing known; their ratings (rated_nm, inertia_kg_m2, motor) stay. */
void train_reset(struct rotor *rotors, int n);

/* Once a tick of `tick_s` s, after the estimates and before they are compared. Clears command_valid
 * of inputs whose command cannot be right. Sets `not_judged`, health and reason of drives whose
 * estimate is not used, and `withdrawn`. `workspace` holds 2 n numbers. */
void assess_train(struct rotor *rotors, struct rotor_inputs *inputs, int n, int64_t now_ns,
                  double tick_s, double *workspace);

/* Probability of a loss of this drive, at most UNDECIDED while its load is no evidence: its currents
 * are unreliable, it carries more than it is asked for, or it may be off. */
double limit_loss(struct rotor *r, const struct rotor_inputs *in, double p, int64_t now_ns);

/* Largest load, per unit of rated torque, of a drive that is asked for `asked`, also per unit. */
double most_load(double asked);

#endif
