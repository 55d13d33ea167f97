/* Reference speed of the train, which no message carries: a bound, by the rotors of recent seconds.
 *
 * No train changes its speed faster than by MOST_ACCELERATION, and on a bad rail by no more than
 * its motors explain: if other axles brake it harder, the flag is `Unknown`. No braking wheel turns
 * faster than its train, no driving wheel slower. So the leading rotor, the fastest in braking, the
 * slowest in traction, is followed at this rate at most: wheels that all slide at once leave this
 * speed, however their loads respond to their commands. If the bound has fallen behind the train,
 * it returns CATCH_UP times as fast.
 *
 * A wheel off the bound by MOST_SLIP does not adhere. It is lost if it is off by SLIDING_SLIP even
 * from a bound HARDER times as fast (at least MOST_ACCELERATION), and its own speed has changed.
 *
 * The term of the field is reference speed. Not in paper `adhesion`. Nothing here can fail: the
 * divisor is an inertia, which is configured, or a speed of at least LEAST_SPEED; comparisons with NaN
 * are false, and each is written so that false is the safe answer. */
#include "gateway/core/train_speed.h"

#include <math.h>

#include "estimators/numbers.h"

/* Mean load, per unit of rated torque, from which on motors can make wheels slide. */
#define LEAST_EFFORT 0.1
#define CATCH_UP     4.0
#define HARDER       2.0
#define UNSEEN_S     1.0    /* after longer without a tracked rotor, nothing is known */
#define MOST_SLIP    0.06   /* slip of adhering wheels, one or two percent of creep each included */
#define SLIP_OF_TWO  0.08   /* the same for two drives: the reference has the noise of one */
#define MOST_DIFFERENCE 0.1 /* the same while too little has been learnt of the diameters */
/* On a bad rail a train changes its speed by hills and by a share of its motors' mean load. */
#define HILL         0.02
#define ROTATING     0.15
#define AHEAD_S      0.05 /* a lost wheel that is caught is ahead of the train for less, */
#define CARRIES      0.5  /* or carries less, as a share of the mean load */
#define SLIDING_SLIP 0.2  /* larger than any creep at which less slip would carry less */

/* 1 if drive k shows the speed of the train: it adheres; or it has been ahead of the bound under
 * load for too long to be a lost wheel that is caught and passes the train's speed. */
static int is_measure(const struct train_tick *t, int k)
{
    return t->in[k].adhesion == FLAG_GOOD || t->rotor[k].ahead_s > AHEAD_S;
}

/* The fastest rotor in braking, the slowest in traction, of those that are tracked; only of those
 * that are a measure, if there are any; NaN if none is tracked. A rotor that carries against the
 * others (it may turn backwards) is no bound. */
static double leading_speed(const struct train_tick *t, int first)
{
    double lead = NAN;
    int adheres = 0; /* 1 if the leading rotor so far is a measure */
    for (int k = first; k < t->n; k = next_alike(t, k)) {
        const struct rotor *r = &t->rotor[k];
        const int good = is_measure(t, k);
        const int with_train = t->braking ? r->load <= 0.0 : r->load >= 0.0;
        if (!with_train || !isfinite(r->speed) || good < adheres)
            continue;
        const int leads = t->braking ? r->speed > lead : r->speed < lead;
        lead = leads || isnan(lead) || good > adheres ? r->speed : lead;
        adheres = good;
    }
    return lead;
}

/* The bound after a tick in which the speed of the train may change by `most`. */
static double follow_lead(double bound, double lead, double most, int braking)
{
    if (isnan(bound) || isnan(lead))
        return isnan(lead) ? bound : lead;
    const double down = braking ? most : CATCH_UP * most;
    const double up = braking ? CATCH_UP * most : most;
    return clamp(lead, bound - down, bound + up);
}

/* 1 if the rail is bad under any rotor. A drive that is cut out keeps its flag; it is left out. */
static int is_bad_rail(const struct train_tick *t, int first)
{
    for (int k = first; k < t->n; k = next_alike(t, k))
        if (t->rotor[k].apart || (t->in[k].adhesion == FLAG_BAD && t->in[k].operating))
            return 1;
    return 0;
}

/* Change of a rotor's speed in a tick by a torque, per unit of the rated one. */
static double change_in_tick(const struct train_tick *t, const struct rotor *r, double share)
{
    return share * r->rated_nm / r->inertia_kg_m2 * t->tick_s;
}

/* Follow both bounds of this tick, in the record of the first rotor. */
static void follow_train(struct train_tick *t, int first)
{
    struct rotor *train = &t->rotor[first];
    const double lead = leading_speed(t, first);
    train->unseen_s = isnan(lead) ? train->unseen_s + t->tick_s : 0.0;
    if (train->unseen_s > UNSEEN_S || (!isnan(lead) && t->effort < LEAST_EFFORT))
        train->train_speed = train->train_limit = lead;
    const double by_motors = HILL + ROTATING * t->effort;
    const int less = is_bad_rail(t, first) && by_motors < MOST_ACCELERATION;
    const double share = less ? by_motors : MOST_ACCELERATION;
    const double bound = change_in_tick(t, train, share);
    const double limit = change_in_tick(t, train, larger(MOST_ACCELERATION, HARDER * share));
    train->train_speed = follow_lead(train->train_speed, lead, bound, t->braking);
    train->train_limit = follow_lead(train->train_limit, lead, limit, t->braking);
}

void compare_with_train(struct train_tick *t, int first)
{
    follow_train(t, first);
    const struct rotor *train = &t->rotor[first];
    const double bound = train->train_speed, limit = train->train_limit;
    const double effort = t->braking ? -1.0 : 1.0;
    const int known = t->effort >= LEAST_EFFORT && bound >= LEAST_SPEED && limit >= LEAST_SPEED;
    for (int k = first; k < t->n; k = next_alike(t, k)) {
        struct rotor *r = &t->rotor[k];
        r->slip = known ? effort * (r->speed / bound - 1.0) : NAN;
        const int slides = known && effort * (r->speed / limit - 1.0) > SLIDING_SLIP;
        const int ahead = r->slip < 0.0 && r->learnt_s >= DIAMETER_ROUGH_S;
        const int carries = effort * r->load > CARRIES * t->effort;
        r->ahead_s = ahead && carries ? r->ahead_s + t->tick_s : 0.0;
        r->sliding_s = slides && !isnan(r->load) ? r->sliding_s + t->tick_s : 0.0;
    }
}

int is_off_train(const struct train_tick *t, const struct rotor *r)
{
    const double most = t->n < 3 ? SLIP_OF_TWO : MOST_SLIP;
    return r->slip > (r->learnt_s < DIAMETER_ROUGH_S ? MOST_DIFFERENCE : most);
}
