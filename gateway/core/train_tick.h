/* What train.c, rotors.c and train_speed.c share in a tick: all rotors, and how they are walked. Not for
 * cffi. */
#ifndef TRACTION_TRAIN_TICK_H
#define TRACTION_TRAIN_TICK_H

#include <math.h>

#include "estimators/order_statistics.h"
#include "gateway/core/records.h"

#define LEAST_SPEED 3.0 /* rad/s at the rotor; below it, relative speeds have no meaning */
/* Per unit of rated torque, accelerating a rotor: an emergency brake of 1.5 m/s^2 for the
 * 350 kW motor, including the wheelset behind its gear. */
#define MOST_ACCELERATION 0.15
#define NEAR              0.03 /* creep of a wheel that turns with the others */
#define STEADY            0.02 /* change of its speed within 0.5 s: no brake slows it */
#define DIAMETER_ROUGH_S  0.5  /* adhering for so long, a rotor has a diameter known to a percent */

/* Working data of assess_train. */
struct train_tick {
    struct rotor *rotor;
    struct rotor_inputs *in;
    int n;
    int64_t now_ns;
    double tick_s;
    double *workspace;       /* 2 n numbers */
    struct ranking loads;    /* of all drives, of this tick */
    struct ranking commands; /* valid ones of all drives, per unit of rated torque, without sign */
    double effort;           /* magnitude of their mean; follow_rotors writes it and: */
    int braking;             /* 1: the loads of all drives brake */
};

/* The sign that brings a load to the direction in which its train moves: a drive may be mounted the
 * other way round. Before its rotor has turned, each drive is assumed to pull. */
static inline double direction_of(const struct rotor *r, double load_nm)
{
    if (r->forward != 0)
        return r->forward;
    return load_nm < 0.0 ? -1.0 : 1.0;
}

/* 1 if a wheel turns with the others. */
static inline int turns_along(const struct rotor *r)
{
    return fabs(r->creep) <= NEAR && !r->apart;
}

/* 1 if the speed of a wheel is constant. */
static inline int is_steady(const struct rotor *r)
{
    const double slow = fabs(r->slow_speed);
    return fabs(r->speed * r->diameter - slow) <= STEADY * slow;
}

/* The next rotor with the same motor; n after the last one. */
static inline int next_alike(const struct train_tick *t, int k)
{
    const int next = t->rotor[k].next_alike;
    return next > k ? next : t->n;
}

#endif
