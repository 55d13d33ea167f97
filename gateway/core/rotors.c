/* Speeds of the rotors against one another, and what accelerates them.
 *
 * - Acceleration: that of the median rotor, never of the wheel that is judged; of two the slower in
 *   traction, the faster in braking. A load is credited with what its own rotor takes of it.
 * - Speed: a rotor more than MOST_CREEP from the median of the others is never adhering. Wheel
 *   diameters are learnt, to within MOST_DIAMETER.
 *
 * Not in paper `adhesion`. Nothing here can fail: a number that is not known is NaN, every
 * comparison with NaN is false, and each condition is written so that false is the safe answer.
 * Divisors are ratings, constants, a diameter within MOST_DIAMETER of 1, or speeds of at least
 * LEAST_SPEED; that of `own_change` may be 0, which gives infinity, no small change. Each ranking has
 * room for all rotors, and `next_alike` is above the own place, so that its loops end. */
#include "gateway/core/rotors.h"

#include <math.h>

#include "estimators/numbers.h"
#include "gateway/core/train_speed.h"

#define ACCELERATION_TAU_S 0.5 /* time constant of the acceleration of a rotor, */
#define BRAKE_TAU_S        0.1 /* and where friction brakes may be its cause */
/* By its own motors never more than a hill's part and this share of the load: what turns is a few
 * percent of the inertia of a train. All wheels that run away together need more; so does a train that
 * friction brakes slow, and which of the two it is nobody knows. */
#define ROTATING_FLOOR 0.02
#define ROTATING_SHARE 0.08
/* A drive without others that accelerates by more (per unit of rated torque), or is so far from its
 * own speed of late (as a share of it), may be running away. A train of 1 m/s^2 is beyond 1.7 m/s
 * when it is not. */
#define SINGLE_CREDIT 0.05
#define SINGLE_CHANGE 0.3
#define GRIPS_S       1.0 /* a wheel that slid has its grip back after so long */
/* An estimated speed that differs by more from the measured one, which is up to 10 ms old, is no
 * measure for others: share and rad/s. */
#define SPEEDS_APART       0.05
#define SPEEDS_APART_RAD_S 1.0
/* An estimate that has been followed for less may be on its way from a guess: beyond LEARN_CREEP
 * from it, the measured speed goes before it. */
#define FOLLOWED_S 0.2
#define MOST_CREEP                                                                                 \
    0.08 /* of a rotor against the others, which creep by a percent or two themselves */
#define MOST_APART 0.1 /* the same while its diameter is not known yet, diameters included */
#define NEAR_S     0.1 /* a rotor is back after so long: one that turns backwards passes by */
/* A rotor that all others have left is compared with its own speed before that for so long. Longer
 * would break the rule that a rotor 10 % from the others is Adhering for 200 ms at most. */
#define ALONE_S          0.15
#define LEARN_CREEP      0.03 /* diameters are learnt while a rotor is no further from the others */
#define DIAMETER_FIRST_S 3.0  /* of adhering; until then any diameter is expected */
#define DIAMETER_TAU_S   60.0 /* then so slowly: a slip that grows over seconds is no diameter */
#define MOST_DIAMETER    0.06
#define SLIDING_S        0.05 /* a rotor that is off the train by so much is lost after so long */

/* ---- Speeds and loads of this tick ---- */

/* The speed that is taken of a drive whose filter tracks: estimated, measured, or none. */
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

/* Speed and load of one rotor; 1 if its filter tracks. */
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
    r->load = copysign(1.0, in->speed_rad_s) * in->load_nm / r->rated_nm;
    return 1;
}

/* Speed and load of every rotor; whether the train brakes. The load of a wheel that slides is what
 * slows its rotor, and no effort: it counts only where all wheels slide. */
static void note(struct train_tick *t)
{
    double total[2] = {0.0, 0.0}; /* of rotors that turn with the others, of those that do not */
    int count[2] = {0, 0};
    for (int k = 0; k < t->n; k++) {
        struct rotor *r = &t->rotor[k];
        if (!note_rotor(t, r, &t->in[k]))
            continue;
        total[r->apart] += r->load;
        count[r->apart]++;
    }
    const int of = count[0] > 0 ? 0 : 1;
    t->effort = count[of] > 0 ? fabs(total[of]) / count[of] : 0.0;
    t->braking = total[of] < 0.0;
    t->drags = t->braking || t->effort < LEAST_EFFORT;
}

/* ---- Acceleration ---- */

/* Relative rate of a rotor, 1/s, so that it is the same for all diameters and gears; NaN where it is
 * slow. Follows the smoothed speed. */
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
    int count;    /* of how many rotors */
};

static struct rates median_rates(struct train_tick *t)
{
    struct ranking steady = {.numbers = t->workspace}, quick = {.numbers = t->workspace + t->n};
    for (int k = 0; k < t->n; k++) {
        struct rotor *r = &t->rotor[k];
        if (isnan(r->speed)) {
            /* Beside a measured speed that is apart the drive is still followed. */
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

/* Torque, per unit of the rated one, that takes a rotor through its part of a rate; 0: not known. */
static double torque_at(const struct rotor *r, double rate, double speed)
{
    const double torque = r->inertia_kg_m2 * rate * speed / r->rated_nm;
    return isnan(torque) ? 0.0 : clamp(torque, -MOST_ACCELERATION, MOST_ACCELERATION);
}

/* What every rotor takes to follow the median of all. */
static void accelerate(struct train_tick *t)
{
    const struct rates rates = median_rates(t);
    const int quick = fabs(rates.steady) * ACCELERATION_TAU_S > SINGLE_CHANGE;
    const int slows = t->braking && rates.quick < 0.0;
    for (int k = 0; k < t->n; k++) {
        struct rotor *r = &t->rotor[k];
        const double load = isnan(r->load) ? 0.0 : fabs(r->load);
        const double most = ROTATING_FLOOR + ROTATING_SHARE * load;
        r->acceleration_torque = clamp(torque_at(r, rates.steady, r->slow_speed), -most, most);
        r->brake_torque = 0.0;
        if (slows)
            r->brake_torque = torque_at(r, rates.quick, r->quick_speed) - r->acceleration_torque;
        r->uncertain = rates.count < 2 && (fabs(r->acceleration_torque) > SINGLE_CREDIT || quick);
    }
}

void follow_braked(struct rotor *r, int braked, double tick_s)
{
    const double slow = larger(LEAST_SPEED, fabs(r->quick_speed));
    const double torque = fabs(r->acceleration_torque + r->brake_torque) * r->rated_nm;
    const double rate = braked ? torque / (r->inertia_kg_m2 * slow) : -MOST_CREEP / GRIPS_S;
    r->braked_creep = larger(0.0, r->braked_creep + rate * tick_s);
    if (r->braked_creep > MOST_CREEP) {
        r->braked_creep = MOST_CREEP; /* the doubt ends with its cause */
        r->uncertain = 1;
    }
}

/* ---- Speeds against one another ---- */

/* Ascending speeds of the rotors of one motor. */
struct speeds {
    struct ranking tracked; /* of those that are tracked */
    struct ranking all;     /* sorted where fewer than two are tracked: else nobody asks for them */
};

/* Of the rotors with the motor of rotor `first`. */
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

/* Median speed of the others that are tracked, else of all others; NaN without any. */
static double reference_speed(const struct train_tick *t, const struct speeds *speeds,
                              const struct rotor *r)
{
    const double own = isnan(r->load) ? NAN : r->speed;
    const double tracked = median_of_others(&speeds->tracked, own, t->drags);
    return isnan(tracked) ? median_of_others(&speeds->all, r->speed, t->drags) : tracked;
}

/* By what share a rotor is faster than it was of late. */
static double own_change(const struct rotor *r)
{
    return r->speed * r->diameter / fabs(r->slow_speed) - 1.0;
}

/* 1 if all other wheels have left a rotor just now, and it is as fast as before. known: rotors of its
 * motor whose speed is known, itself among them; away: how many of these are away. */
static int stays(const struct train_tick *t, struct rotor *r, int known, int away)
{
    const int inside = !isnan(r->speed);
    const int others = known - inside;
    const int alone = others > 0 && away - (inside && r->away) == others;
    r->alone_s = alone ? r->alone_s + t->tick_s : 0.0;
    const int kept = fabs(own_change(r)) <= LEARN_CREEP;
    return r->alone_s > 0.0 && r->alone_s <= ALONE_S && kept;
}

/* Slip of a wheel against the train, or against the others where that is more: a drive that alone is
 * tracked leads the train's speed by itself. */
static double slip_of(const struct train_tick *t, const struct rotor *r)
{
    const double against_others = (t->drags ? -1.0 : 1.0) * r->creep;
    return isnan(r->slip) || against_others > r->slip ? against_others : r->slip;
}

/* 1 if a wheel has left the others for the side that the effort takes it to, until it is back: its
 * own speed has changed, not theirs. */
static int runs_away(const struct train_tick *t, const struct rotor *r)
{
    const double effort = t->drags ? -1.0 : 1.0;
    const double slip = slip_of(t, r);
    if (r->away)
        return slip > LEARN_CREEP;
    return slip > MOST_CREEP && effort * own_change(r) > LEARN_CREEP;
}

/* Before its diameter is known: what has been learnt so far may be a slip that grows. */
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

/* Creep of every rotor against the others, and which of them run away. */
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
        /* Only such as have turned with the others. */
        const int known = r->learnt_s >= DIAMETER_ROUGH_S;
        r->sliding = known && r->away && r->sliding_s > SLIDING_S;
    }
}

/* Which rotors are too far from the others to be adhering. */
static void find_apart(struct train_tick *t, int first)
{
    int known = 0, away = 0;
    for (int k = first; k < t->n; k = next_alike(t, k)) {
        const int inside = !isnan(t->rotor[k].speed);
        known += inside;
        away += inside && t->rotor[k].away;
    }
    for (int k = first; k < t->n; k = next_alike(t, k)) {
        struct rotor *r = &t->rotor[k];
        const int left = stays(t, r, known, away);
        r->uncertain = r->uncertain || (r->far && !left);
        if (isnan(r->creep) && isnan(r->slip)) {
            /* Nobody sees whether it is back. */
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

/* Speed in the direction of the train: negative for a wheel that brakes without grip until it turns
 * backwards. A drive may be mounted the other way round: its own sign while it adhered decides. */
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

/* What is left between the speeds of wheels that adhere, while none is lost. */
static void learn_diameters(struct train_tick *t)
{
    for (int k = 0; k < t->n; k++)
        /* A drive that is cut out keeps its flag, and stops nobody from learning. */
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
