/* Speeds of the rotors against one another: the first half of train.c. */
#ifndef TRACTION_ROTORS_H
#define TRACTION_ROTORS_H

#include "gateway/core/records.h"

/* What assess_train works on. */
struct train_tick {
    struct rotor *rotor;
    struct rotor_inputs *in;
    int n;
    int64_t now_ns;
    double tick_s;
    double *rank; /* n numbers in ascending order, as rank_insert leaves them */
    int braking;  /* 1: the loads of all drives brake; written by follow_rotors */
};

/* One more number into the ascending first `count` of rank. */
void rank_insert(double x, int count, double *rank);

/* Median of the first `count`; of an even number the upper or the lower of the two; NaN of none. */
double rank_median(int count, int upper, const double *rank);

/* Speeds, loads and accelerations of this tick; who is apart from the others or runs away;
 * diameters of wheels. */
void follow_rotors(struct train_tick *t);

#endif
