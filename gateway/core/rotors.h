/* Comparison of the rotors' speeds: the first half of train.c. */
#ifndef TRACTION_ROTORS_H
#define TRACTION_ROTORS_H

#include "gateway/core/train_tick.h"

/* Update speeds, loads and accelerations of this tick; find rotors that are apart or run away;
 * learn wheel diameters. Needs all of the workspace. */
void follow_rotors(struct train_tick *t);

/* It cannot be observed whether friction brakes cause a missing load (`braked`, 1 or 0). If all
 * wheels are lost, this one gains creep meanwhile; beyond MOST_CREEP it may not adhere. */
void follow_braked(struct rotor *r, int braked, double tick_s);

#endif
