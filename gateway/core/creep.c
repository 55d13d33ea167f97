/* Creep of each wheel relative to the reference speed of its train, and utilised adhesion.
 *
 * - Creep: speed of the wheel over the reference speed (train_speed.c), minus 1. Positive: the
 *   wheel is faster than its train, in either direction; below -1: it turns backwards. Wheel
 *   diameters are the learnt ones.
 * - Utilisation: load over rated torque, without its sign. The configuration has no normal force;
 *   the utilised adhesion, force over normal force, is this times the coefficient at which rated
 *   torque is transmitted.
 *
 * The reference itself creeps by OWN_CREEP. The spread of wheels that adhere is that observed.
 * While no wheel adheres, the reference follows no wheel; its error is its change since then plus
 * what a train can change its speed by in that time. The load has its own standard deviation.
 *
 * Not in paper `adhesion`. Nothing here can fail: divisors are ratings, which are above 0, and a
 * speed of at least LEAST_SPEED; a number that is not known is NaN, comparisons with NaN are false,
 * and each is written so that false is the safe answer. `next_of` is above `k`, so that its loops
 * end; roots are taken of a sum of squares, or of NaN. */
#include "gateway/core/creep.h"

#include <math.h>

#include "estimators/numbers.h"
#include "gateway/core/train_tick.h"

#define OWN_CREEP               0.01
#define SPEED_SIGMA             0.1   /* rad/s, standard deviation of the speed of a rotor */
#define MOST_CREEP_SIGMA        0.254 /* largest value of its signal, as the next two */
#define LEAST_UTILISATION_SIGMA 0.005
#define MOST_UTILISATION_SIGMA  1.27

/* Reference that the rotors of one motor are compared with. */
struct reference {
    double speed; /* rad/s; NaN: not known, or too slow */
    double sigma; /* standard deviation, as a share of the speed */
};

static int next_of(const struct adhesion *a, int k)
{
    const int next = a->rotors[k].next_alike;
    return next > k ? next : a->n;
}

/* Direction of rotation; 1: forwards, -1: backwards. */
static int8_t way_of(const struct rotor_inputs *in)
{
    const double speed = isnan(in->measured_rad_s) ? in->speed_rad_s : in->measured_rad_s;
    return speed < 0.0 ? -1 : 1;
}

/* Share by which a wheel is faster than the train; NaN: not known. */
static double creep_of(const struct adhesion *a, int k, double train)
{
    const struct rotor *r = &a->rotors[k];
    const int back = r->way * way_of(&a->rotor_inputs[k]) < 0;
    return (back ? -fabs(r->speed) : fabs(r->speed)) / train - 1.0;
}

/* Reference of the rotors with the motor of rotor `first`. */
static struct reference refer(const struct adhesion *a, const struct drive_status *status,
                              int first)
{
    struct rotor *train = &a->rotors[first];
    const double speed = train->train_speed >= LEAST_SPEED ? train->train_speed : NAN;
    double squares = 0.0;
    int adhering = 0;
    for (int k = first; k < a->n; k = next_of(a, k)) {
        struct rotor *r = &a->rotors[k];
        const int good = status[k].flag[FLAG_ADHESION].state == FLAG_GOOD && !isnan(r->load);
        if (good || isnan(speed))
            r->way = isnan(speed) ? 0 : way_of(&a->rotor_inputs[k]);
        const double creep = creep_of(a, k, speed);
        if (!good || isnan(creep))
            continue;
        squares += square(creep);
        adhering++;
    }
    train->unsure_s = adhering > 0 ? 0.0 : train->unsure_s + a->tick_s;
    train->sure_speed = adhering > 0 ? speed : train->sure_speed;
    const double rate = MOST_ACCELERATION * train->rated_nm / train->inertia_kg_m2;
    const double drift = (rate * train->unsure_s + fabs(speed - train->sure_speed)) / speed;
    const double spread = adhering > 0 ? squares / adhering : 0.0;
    return (struct reference){speed, sqrt(square(OWN_CREEP) + spread + square(drift))};
}

/* A number with its standard deviation; NaN for both unless both are known. */
static void fill(double number, double sigma, double most, double *out, double *out_sigma)
{
    const int known = isfinite(number) && sigma <= most;
    *out = known ? number : NAN;
    *out_sigma = known ? sigma : NAN;
}

static void fill_creep(const struct adhesion *a, int k, const struct reference *train,
                       struct drive_status *out)
{
    const double creep = creep_of(a, k, train->speed);
    const double of_train = (1.0 + creep) * train->sigma, of_rotor = SPEED_SIGMA / train->speed;
    fill(creep, sqrt(square(of_train) + square(of_rotor)), MOST_CREEP_SIGMA, &out->creep,
         &out->creep_sigma);
}

static void fill_utilisation(const struct rotor *r, struct drive_status *out)
{
    const double sigma = larger(LEAST_UTILISATION_SIGMA, out->load_sigma_nm / r->rated_nm);
    fill(fabs(out->load_nm) / r->rated_nm, sigma, MOST_UTILISATION_SIGMA, &out->utilisation,
         &out->utilisation_sigma);
}

void estimate_creep(const struct adhesion *a, struct drive_status *status)
{
    for (int first = 0; first < a->n; first++) {
        fill_utilisation(&a->rotors[first], &status[first]);
        if (a->rotors[first].motor != first)
            continue;
        const struct reference train = refer(a, status, first);
        for (int k = first; k < a->n; k = next_of(a, k))
            fill_creep(a, k, &train, &status[k]);
    }
}
