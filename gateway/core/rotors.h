/* Speeds of the rotors against one another: the first half of train.c. */
#ifndef TRACTION_ROTORS_H
#define TRACTION_ROTORS_H

#include "estimators/order_statistics.h"
#include "gateway/core/records.h"

#define LEAST_SPEED 3.0 /* rad/s at the rotor; below it a share of the speed says nothing */
/* Per unit of rated torque, of what accelerates a rotor: an emergency brake of 1.5 m/s^2 for the
 * 350 kW motor, the wheelset behind its gear included. */
#define MOST_ACCELERATION 0.15
#define DIAMETER_ROUGH_S  0.5 /* of adhering, after which a diameter is known to within a percent */
/* Mean load, per unit of rated torque, down to which wheels slide by their motors. */
#define LEAST_EFFORT 0.1

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
    double effort;           /* magnitude of their mean; written by follow_rotors, as is: */
    int braking;             /* 1: the loads of all drives brake */
    int drags;               /* 1: a wheel that slides is slower than its train: it brakes, or no
                              * motor pulls, and all that can act are friction brakes */
};

/* The next rotor with the same motor; n after the last one. */
static inline int next_alike(const struct train_tick *t, int k)
{
    const int next = t->rotor[k].next_alike;
    return next > k ? next : t->n;
}

/* Speeds, loads and accelerations of this tick; who is apart from the others or runs away;
 * diameters of wheels. Needs all of the workspace. */
void follow_rotors(struct train_tick *t);

/* Whether a load is missing because of friction brakes (`braked`, 1 or 0) nobody knows. If it is a
 * loss of all wheels, this one has gained so much creep since; beyond MOST_CREEP it may not adhere. */
void follow_braked(struct rotor *r, int braked, double tick_s);

#endif
