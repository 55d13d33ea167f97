/* Comparison of the rotors' speeds, and the torque that accelerates them.
 *
 * - Acceleration: that of the median rotor, never of the wheel that is judged; of two, the slower
 *   in traction, the faster in braking. A load is credited with the part that its own rotor takes.
 * - Speed: a rotor that is more than MOST_CREEP from the median of the others never adheres. Wheel
 *   diameters are learnt, to within MOST_DIAMETER.
 *
 * Not in paper `adhesion`. Nothing here can fail: a number that is not known is NaN, every
 * comparison with NaN is false, and each condition is written so that false is the safe answer.
 * Divisors are ratings, constants, a diameter within MOST_DIAMETER of 1, or speeds of at least
 * LEAST_SPEED; that of `own_change` may be 0, which gives infinity, not a small change. Rankings
 * have room for all rotors, and `next_alike` is above the own index, so that its loops end. */
#include "gateway/core/rotors.h"

#include <math.h>

#include "estimators/numbers.h"
#include "gateway/core/train_speed.h"

#define ACCELERATION_TAU_S 0.5 /* time constant of the acceleration of a rotor, */
#define BRAKE_TAU_S        0.1 /* and of one that friction brakes may cause */
/* By its own motors a train accelerates by no more than a hill's part plus this share of the load:
 * what turns is a few percent of its inertia. All wheels running away together need more torque; so
 * does a train slowed by friction brakes, and the two cases cannot be distinguished. Against the
 * effort only a hill accelerates it; a rotor that does so by more has slid, and grips again. */
#define ROTATING_FLOOR 0.02
#define ROTATING_SHARE 0.08
/* A drive without others may be running away if it accelerates by more than this (per unit of rated
 * torque), or is this far from its own recent speed (as a share of it). A train of 1 m/s^2 is
 * beyond 1.7 m/s if it does not run away. */
#define SINGLE_CREDIT 0.05
#define SINGLE_CHANGE 0.3
#define GRIPS_S       1.0 /* a wheel that slid has regained its grip after this time */
/* A rotor whose estimated speed differs by more from its measured one, which is up to 10 ms old, is
 * no measure for others: share, and rad/s. */
#define SPEEDS_APART       0.05
#define SPEEDS_APART_RAD_S 1.0
#define TURNS_RAD_S        1.0 /* from this speed on, its sign is no noise */
/* An estimate that has been followed for a shorter time may still converge from a wrong start: if
 * it differs by more than LEARN_CREEP, the measured speed is used instead. */
#define FOLLOWED_S 0.2
#define MOST_CREEP                                                                                 \
    0.08 /* limit for a rotor against the others, which creep by a percent or two themselves */
#define MOST_APART 0.1 /* the same, diameters included, while its diameter is not known */
#define NEAR_S     0.1 /* a rotor is back after so long: one that turns backwards only passes */
/* A rotor that all others have left is compared with its own earlier speed for this time. A longer
 * time would break the rule that a rotor 10 % from the others is Adhering for at most 200 ms. */
#define ALONE_S          0.15
#define LEARN_CREEP      0.03 /* diameters are learnt from rotors that are no further from others */
#define DIAMETER_FIRST_S 3.0  /* time of adhering; until then any diameter is expected */
#define DIAMETER_TAU_S   60.0 /* after that, slow: a slip that grows over seconds is no diameter */
#define MOST_DIAMETER    0.06
#define SLIDING_S        0.05 /* a rotor that is so far off the train is lost after this time */

/* ---- Speeds and loads of this tick ---- */

/* Speed used for a drive whose filter tracks: estimated, measured, or NaN. */
static double tracked_speed(const struct rotor *r, const struct rotor_inputs *in, int64_t now_ns)
{
    const double measured = in->measured_rad_s;
    const double off = fabs(measured - in->speed_rad_s);
    if (off > SPEEDS_APART * fabs(measured) + SPEEDS_APART_RAD_S)
        return NAN;
    const int unreliable = r->followed_s < FOLLOWED_S || now_ns < r->unreliable_until_ns;
    const int guess = unreliable && off > LEARN_CREEP * fabs(measured);
    return guess ? measured : in->speed_rad_s;
}

/* Note speed and load of one rotor; 1 if its filter tracks. */
static int note_rotor(const struct train_tick *t, struct rotor *r, const struct rotor_inputs *in)
{
    r->load = NAN;
    r->speed = in->measured_rad_s;
    if (in->health != HEALTH_TRACKING) {
        r->followed_s = 0.0;
        return 0;
    }
    r->followed_s += t->tick_s;
    r->speed = tracked_speed(r, in, t->now_ns);
    if (fabs(in->speed_rad_s) >= TURNS_RAD_S)
        r->forward = in->speed_rad_s < 0.0 ? -1 : 1;
    r->load = direction_of(r, in->load_nm) * in->load_nm / r->rated_nm;
    return 1;
}

/* Note speed and load of every rotor, and whether the train brakes. */
static void note(struct train_tick *t)
{
    double total = 0.0;
    int count = 0;
    for (int k = 0; k < t->n; k++) {
        struct rotor *r = &t->rotor[k];
        if (!note_rotor(t, r, &t->in[k]))
            continue;
        total += r->load;
        count++;
    }
    t->effort = count > 0 ? fabs(total) / count : 0.0;
    t->braking = total < 0.0;
}

/* ---- Acceleration ---- */

/* Relative rate of a rotor, 1/s, which is the same for all diameters and gears; NaN if the rotor is
 * slow. Updates the smoothed speed. */
static double relative_rate(double *smoothed, double speed, double tick_s, double tau_s)
{
    const double before = isnan(*smoothed) ? speed : *smoothed;
    *smoothed = before + tick_s / tau_s * (speed - before);
    return fabs(before) >= LEAST_SPEED ? (speed - before) / tau_s / before : NAN;
}

/* Rates of the median rotor, 1/s. */
struct rates {
    double steady;
    double quick; /* the same, less smoothed */
    int count;    /* number of rotors */
};

static struct rates median_rates(struct train_tick *t)
{
    struct ranking steady = {.numbers = t->workspace}, quick = {.numbers = t->workspace + t->n};
    for (int k = 0; k < t->n; k++) {
        struct rotor *r = &t->rotor[k];
        if (isnan(r->speed)) {
            /* A drive whose measured speed differs from the estimate is still followed. */
            if (isnan(r->load))
                r->slow_speed = r->quick_speed = NAN;
            continue;
        }
        ranking_add(&steady,
                    relative_rate(&r->slow_speed, r->speed, t->tick_s, ACCELERATION_TAU_S));
        ranking_add(&quick, relative_rate(&r->quick_speed, r->speed, t->tick_s, BRAKE_TAU_S));
    }
    sort_ascending(steady.numbers, steady.count);
    sort_ascending(quick.numbers, quick.count);
    return (struct rates){.steady = median_of_others(&steady, NAN, t->braking),
                          .quick = median_of_others(&quick, NAN, t->braking),
                          .count = steady.count};
}

/* Torque, per unit of the rated one, by which a rotor follows a rate; 0: not known. */
static double torque_at(const struct rotor *r, double rate, double speed)
{
    const double torque = r->inertia_kg_m2 * rate * speed / r->rated_nm;
    return isnan(torque) ? 0.0 : clamp(torque, -MOST_ACCELERATION, MOST_ACCELERATION);
}

/* Torque by which each rotor follows the median of all. */
static void accelerate(struct train_tick *t)
{
    const struct rates rates = median_rates(t);
    const int quick = fabs(rates.steady) * ACCELERATION_TAU_S > SINGLE_CHANGE;
    const int slows = t->braking && rates.quick < 0.0;
    for (int k = 0; k < t->n; k++) {
        struct rotor *r = &t->rotor[k];
        const double load = isnan(r->load) ? 0.0 : fabs(r->load);
        const int with_effort = (rates.steady > 0.0) == (r->load > 0.0);
        const double most = ROTATING_FLOOR + (with_effort ? ROTATING_SHARE * load : 0.0);
        const double own = torque_at(r, rates.steady, r->slow_speed);
        r->acceleration_torque = clamp(own, -most, most);
        r->brake_torque = 0.0;
        if (slows)
            r->brake_torque = torque_at(r, rates.quick, r->quick_speed) - r->acceleration_torque;
        r->uncertain = rates.count < 2 && (fabs(own) > SINGLE_CREDIT || quick);
    }
}

void follow_braked(struct rotor *r, int braked, double tick_s)
{
    const double slow = larger(LEAST_SPEED, fabs(r->quick_speed));
    const double torque = fabs(r->acceleration_torque + r->brake_torque) * r->rated_nm;
    const double rate = braked ? torque / (r->inertia_kg_m2 * slow) : -MOST_CREEP / GRIPS_S;
    r->braked_creep = larger(0.0, r->braked_creep + rate * tick_s);
    if (r->braked_creep > MOST_CREEP) {
        r->braked_creep = MOST_CREEP; /* the uncertainty ends with its cause */
        r->uncertain = 1;
    }
}

/* ---- Speeds against one another ---- */

/* Ascending speeds of the rotors of one motor. */
struct speeds {
    struct ranking tracked; /* of those that are tracked */
    struct ranking all;     /* sorted only if fewer than two are tracked: else it is not used */
};

/* Rank the speeds of the rotors with the motor of rotor `first`. */
static struct speeds rank_speeds(const struct train_tick *t, int first)
{
    struct speeds out = {.tracked.numbers = t->workspace, .all.numbers = t->workspace + t->n};
    for (int k = first; k < t->n; k = next_alike(t, k)) {
        const struct rotor *r = &t->rotor[k];
        ranking_add(&out.all, r->speed);
        if (!isnan(r->load))
            ranking_add(&out.tracked, r->speed);
    }
    sort_ascending(out.tracked.numbers, out.tracked.count);
    if (out.tracked.count < 2)
        sort_ascending(out.all.numbers, out.all.count);
    return out;
}

/* Median speed of the other rotors that are tracked, else of all others; NaN without any. */
static double reference_speed(const struct train_tick *t, const struct speeds *speeds,
                              const struct rotor *r)
{
    const double own = isnan(r->load) ? NAN : r->speed;
    const double tracked = median_of_others(&speeds->tracked, own, t->braking);
    return isnan(tracked) ? median_of_others(&speeds->all, r->speed, t->braking) : tracked;
}

/* Relative change of a rotor's speed from its recent mean. */
static double own_change(const struct rotor *r)
{
    return r->speed * r->diameter / fabs(r->slow_speed) - 1.0;
}

/* 1 if all other wheels have left a rotor just now, and its speed has not changed. known: number of
 * rotors of its motor with known speed, this one included; away: number of these that are away. */
static int stays(const struct train_tick *t, struct rotor *r, int known, int away)
{
    const int inside = !isnan(r->speed);
    const int others = known - inside;
    const int alone = others > 0 && away - (inside && r->away) == others;
    r->alone_s = alone ? r->alone_s + t->tick_s : 0.0;
    const int kept = fabs(own_change(r)) <= LEARN_CREEP;
    return r->alone_s > 0.0 && r->alone_s <= ALONE_S && kept;
}

/* Slip of a wheel relative to the train, or to the others if that is more: a drive that alone is
 * tracked determines the train's speed itself. */
static double slip_of(const struct train_tick *t, const struct rotor *r)
{
    const double against_others = (t->braking ? -1.0 : 1.0) * r->creep;
    return isnan(r->slip) || against_others > r->slip ? against_others : r->slip;
}

/* 1 if a wheel has left the others in the direction of the effort, until it is back: its own speed
 * has changed, not theirs. */
static int runs_away(const struct train_tick *t, const struct rotor *r)
{
    const double effort = t->braking ? -1.0 : 1.0;
    const double slip = slip_of(t, r);
    if (r->away)
        return slip > LEARN_CREEP;
    return slip > MOST_CREEP && effort * own_change(r) > LEARN_CREEP;
}

/* Compare before a diameter is known: what has been learnt so far may be a slip that grows. */
static void compare_unknown_diameters(struct train_tick *t, int first)
{
    int any_unknown = 0;
    for (int k = first; k < t->n; k = next_alike(t, k)) {
        t->rotor[k].far = 0;
        any_unknown = any_unknown || t->rotor[k].learnt_s < DIAMETER_FIRST_S;
    }
    if (!any_unknown)
        return;
    const struct speeds speeds = rank_speeds(t, first);
    for (int k = first; k < t->n; k = next_alike(t, k)) {
        struct rotor *r = &t->rotor[k];
        if (r->learnt_s >= DIAMETER_FIRST_S)
            continue;
        const double others = reference_speed(t, &speeds, r);
        const double creep = others >= LEAST_SPEED ? r->speed / others - 1.0 : 0.0;
        r->far = fabs(creep) > MOST_APART;
    }
}

/* Find the creep of every rotor relative to the others, and which rotors run away. */
static void compare_speeds(struct train_tick *t, int first)
{
    for (int k = first; k < t->n; k = next_alike(t, k))
        t->rotor[k].speed /= t->rotor[k].diameter;
    compare_with_train(t, first);
    const struct speeds speeds = rank_speeds(t, first);
    for (int k = first; k < t->n; k = next_alike(t, k)) {
        struct rotor *r = &t->rotor[k];
        const double others = reference_speed(t, &speeds, r);
        r->creep = NAN;
        if (others >= LEAST_SPEED && !isnan(r->speed))
            r->creep = r->speed / others - 1.0;
        if (!isnan(r->creep) || !isnan(r->slip))
            r->away = (uint8_t)runs_away(t, r);
        /* Only rotors that have turned with the others. */
        const int known = r->learnt_s >= DIAMETER_ROUGH_S;
        r->sliding = known && r->away && r->sliding_s > SLIDING_S;
    }
}

/* Find rotors that are too far from the others to adhere. */
static void find_apart(struct train_tick *t, int first)
{
    int known = 0, away = 0, lost = 0;
    for (int k = first; k < t->n; k = next_alike(t, k)) {
        const int inside = !isnan(t->rotor[k].speed);
        known += inside;
        away += inside && t->rotor[k].away;
        lost += inside && t->rotor[k].away && t->in[k].adhesion == FLAG_BAD;
    }
    for (int k = first; k < t->n; k = next_alike(t, k)) {
        struct rotor *r = &t->rotor[k];
        const int left = stays(t, r, known, away);
        /* Wheels that are known to slide are no measure. */
        if (lost > 0 && lost == known - !isnan(r->speed) && !r->away)
            r->far = 0;
        r->uncertain = r->uncertain || (r->far && !left);
        if (isnan(r->creep) && isnan(r->slip)) {
            /* It is not known whether it is back. */
            r->uncertain = r->uncertain || r->apart;
            continue;
        }
        const int off = isnan(r->slip) ? fabs(r->creep) > MOST_CREEP
                                       : is_off_train(t, r) || slip_of(t, r) > MOST_CREEP;
        const int beyond = off && !left;
        r->near_s = beyond ? 0.0 : r->near_s + t->tick_s;
        r->apart = r->near_s == 0.0 || (r->apart && r->near_s < NEAR_S);
        r->uncertain = r->uncertain || beyond;
    }
}

/* Speed in the direction of the train: negative if a wheel brakes without grip until it turns
 * backwards. A drive may be mounted the other way round: its sign while it adhered counts. */
static double along_train(const struct rotor *r)
{
    return r->way != 0 ? r->way * r->speed : fabs(r->speed);
}

/* Rotors are compared with those of the same motor. */
static void compare_alike(struct train_tick *t)
{
    for (int k = 0; k < t->n; k++)
        t->rotor[k].speed = along_train(&t->rotor[k]);
    for (int k = 0; k < t->n; k++) {
        if (t->rotor[k].motor != k)
            continue;
        compare_unknown_diameters(t, k);
        compare_speeds(t, k);
        find_apart(t, k);
    }
}

/* Learn the remaining speed differences of wheels that adhere, while none is lost. */
static void learn_diameters(struct train_tick *t)
{
    for (int k = 0; k < t->n; k++)
        /* A drive that is cut out keeps its flag, but does not stop the others from learning. */
        if (t->in[k].adhesion == FLAG_BAD && t->in[k].operating)
            return;
    for (int k = 0; k < t->n; k++) {
        struct rotor *r = &t->rotor[k];
        const int rough = r->learnt_s < DIAMETER_ROUGH_S;
        const double near = rough ? MOST_DIAMETER + LEARN_CREEP : LEARN_CREEP;
        if (t->in[k].adhesion != FLAG_GOOD || !(fabs(r->creep) <= near))
            continue;
        double wanted = r->diameter * (1.0 + r->creep);
        wanted = clamp(wanted, 1.0 - MOST_DIAMETER, 1.0 + MOST_DIAMETER);
        r->learnt_s += t->tick_s;
        const double longer = r->learnt_s < 10.0 * t->tick_s ? 10.0 * t->tick_s : r->learnt_s;
        const double tau = longer < DIAMETER_TAU_S ? longer : DIAMETER_TAU_S;
        r->diameter += t->tick_s / tau * (wanted - r->diameter);
    }
}

void follow_rotors(struct train_tick *t)
{
    note(t);
    accelerate(t);
    compare_alike(t);
    learn_diameters(t);
}
