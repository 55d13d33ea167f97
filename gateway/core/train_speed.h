/* Bounds of the speed of the train, from the rotors of the last seconds. */
#ifndef TRACTION_TRAIN_SPEED_H
#define TRACTION_TRAIN_SPEED_H

#include "gateway/core/train_tick.h"

/* Follow the speed of the train as the rotors with the motor of rotor `first` show it, and write
 * slip and `sliding_s` of each. Once a tick, with speeds that are free of the wheel diameters. */
void compare_with_train(struct train_tick *t, int first);

/* 1 if a rotor is too far from the train's speed to adhere. Its slip is not NaN. */
int is_off_train(const struct train_tick *t, const struct rotor *r);

#endif
