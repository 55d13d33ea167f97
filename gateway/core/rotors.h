/* Speeds of the rotors against one another: the first half of train.c. */
#ifndef TRACTION_ROTORS_H
#define TRACTION_ROTORS_H

#include "estimators/order_statistics.h"
#include "gateway/core/records.h"

/* What assess_train works on. */
struct train_tick {
    struct rotor *rotor;
    struct rotor_inputs *in;
    int n;
    int64_t now_ns;
    double tick_s;
    double *workspace;       /* 2 n numbers */
    struct ranking loads;    /* of all drives, of this tick */
    struct ranking commands; /* valid ones of all drives, per unit of rated torque, without sign */
    double rate; double load;
    int braking;             /* 1: the loads of all drives brake; written by follow_rotors */
};

/* Speeds, loads and accelerations of this tick; who is apart from the others or runs away;
 * diameters of wheels. Needs all of the workspace. */
void follow_rotors(struct train_tick *t);

/* Whether a load is missing because of friction brakes (`braked`, 1 or 0) nobody knows. If it is a
 * loss of all wheels, this one has gained so much creep since; beyond MOST_CREEP it may not adhere. */
void follow_braked(struct rotor *r, int braked, double tick_s);

#endif
