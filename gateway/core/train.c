/* The train, as all its rotors and commands together show it, before any drive is judged.
 *
 * - Speeds: rotors.c.
 * - Loads: a drive that slides, or carries more than its command and than the others, is no measure
 *   for drives that adhere.
 * - Commands: a load that no command explains, and a command far from all others although its load
 *   is not, are errors of the `Status` message: neither a loss nor health is derived from them.
 * - State: a drive that is not in operation is not judged, and carries nothing that it could lose:
 *   a flag that was raised before its `Status` came is withdrawn if its wheel rolls along.
 *
 * Not in paper `adhesion`. Nothing here can fail: a number that is not known is NaN, every
 * comparison with NaN is false, and each condition is written so that false is the safe answer.
 * Divisors are ratings and constants; each ranking has room for all drives. */
#include "gateway/core/train.h"

#include <math.h>

#include "estimators/detect/command_response.h"
#include "estimators/numbers.h"
#include "gateway/core/rotors.h"

/* A rotor that is apart and carries more than the others for this time slides under its load; one
 * that loses or regains its grip passes through this state sooner. */
#define SLIDES_S 0.2
#define GRIPS   0.1 /* additional load, per unit of rated torque, if a lost rotor grips: no delay */
#define AGAINST 0.25 /* share of the others' load carried against them: it turns backwards */
/* Load beyond the command, per unit of rated torque and of the command, that wrong motor data
 * cannot explain; for this time: a command is up to 0.1 s old, and a drive follows it by a ramp. */
#define UNCOMMANDED          0.12
#define UNCOMMANDED_RELATIVE 0.15
#define COMMAND_LATE_S       0.3
/* A command is odd if it differs from the others' median by more than this factor and 0.1 of rated
 * torque, while its load is near theirs: relative, per unit of rated torque. */
#define FACTOR          2.0
#define FACTOR_FLOOR    0.1
#define LOAD_NEAR       0.25
#define LOAD_NEAR_FLOOR 0.05
#define ODD_S           0.15
#define MOST_COMMAND    3.0 /* per unit of rated torque; no drive delivers more */

/* Median load of the other drives, per unit; NaN if there are none. */
static double others_load(const struct train_tick *t, int k)
{
    return median_of_others(&t->loads, t->rotor[k].load, 0);
}

/* 1 if the load of drive k is near the median of the others; 0 if there are none. */
static int is_like_others(const struct train_tick *t, int k)
{
    const double load = others_load(t, k);
    return fabs(t->rotor[k].load - load) <= LOAD_NEAR * fabs(load) + LOAD_NEAR_FLOOR;
}

double most_load(double asked)
{
    return asked + UNCOMMANDED + UNCOMMANDED_RELATIVE * asked;
}

/* 1 if a drive has carried a load that its command does not explain, for too long. */
static int is_uncommanded(const struct train_tick *t, struct rotor *r,
                          const struct rotor_inputs *in)
{
    const double load = in->load_nm / r->rated_nm + r->acceleration_torque;
    const double sign = load >= 0.0 ? 1.0 : -1.0;
    const double most = larger(sign * in->previous_command_nm, sign * in->command_nm);
    const double asked = larger(0.0, most) / r->rated_nm;
    const int beyond = sign * load > most_load(asked);
    r->uncommanded_s = beyond ? r->uncommanded_s + t->tick_s : 0.0;
    return r->uncommanded_s > COMMAND_LATE_S;
}

/* 1 if a wheel slides under its load, or turns backwards: no measure for wheels that adhere. But a
 * lost wheel that carries more is regaining its grip. */
static int slides(const struct train_tick *t, int k)
{
    struct rotor *r = &t->rotor[k];
    const double others = others_load(t, k);
    const int more = r->apart && t->in[k].adhesion != FLAG_BAD && fabs(r->load) > fabs(others);
    r->slides_s = more ? r->slides_s + t->tick_s : 0.0;
    const int against = r->apart && r->load * others < -AGAINST * others * others;
    const int grips = r->away && more && fabs(r->load) > fabs(others) + GRIPS;
    return r->slides_s > SLIDES_S || against || grips;
}

/* Command without its sign, per unit of rated torque. */
static double relative_command(const struct train_tick *t, int k)
{
    return fabs(t->in[k].command_nm) / t->rotor[k].rated_nm;
}

/* 1 if the command of drive k, a valid one, is far from the others' although its load is not. */
static int is_odd_command(const struct train_tick *t, int k)
{
    struct rotor *r = &t->rotor[k];
    const double own = relative_command(t, k);
    const double others = median_of_others(&t->commands, own, 0);
    const int far = own > FACTOR * others + FACTOR_FLOOR || own < others / FACTOR - FACTOR_FLOOR;
    r->odd_s = far && is_like_others(t, k) ? r->odd_s + t->tick_s : 0.0;
    return r->odd_s > ODD_S || own > MOST_COMMAND;
}

/* 1 if a flagged drive that is off rolls: its wheel turns with the others, one of which adheres, or at
 * constant speed. */
static int rolls_along(const struct train_tick *t, int k)
{
    int rolls = is_steady(&t->rotor[k]);
    for (int i = 0; i < t->n; i++)
        rolls = rolls || t->in[i].adhesion == FLAG_GOOD;
    return rolls && turns_along(&t->rotor[k]);
}

static void do_not_judge(struct rotor_inputs *in, uint8_t health, uint8_t reason)
{
    in->not_judged = 1;
    in->health = health;
    in->health_reason = reason;
}

/* Find loads that no command explains. */
static void assess_loads(struct train_tick *t)
{
    t->loads = (struct ranking){.numbers = t->workspace};
    for (int k = 0; k < t->n; k++)
        ranking_add(&t->loads, t->rotor[k].load);
    sort_ascending(t->loads.numbers, t->loads.count);
    for (int k = 0; k < t->n; k++) {
        struct rotor *r = &t->rotor[k];
        struct rotor_inputs *in = &t->in[k];
        r->above = 0;
        if (!in->command_valid || in->health != HEALTH_TRACKING) {
            r->uncommanded_s = 0.0;
        } else if (in->operating && is_uncommanded(t, r, in)) {
            in->command_valid = 0;
            do_not_judge(in, HEALTH_INPUT_INVALID, REASON_RANGE);
        } else {
            const int sliding = slides(t, k);
            r->above = sliding || (r->uncommanded_s > 0.0 && !is_like_others(t, k));
        }
    }
}

/* Find commands that cannot be right; all are compared before any is dropped. */
static void assess_commands(struct train_tick *t)
{
    t->commands = (struct ranking){.numbers = t->workspace + t->n};
    for (int k = 0; k < t->n; k++)
        if (t->in[k].command_valid)
            ranking_add(&t->commands, relative_command(t, k));
    sort_ascending(t->commands.numbers, t->commands.count);
    for (int k = 0; k < t->n; k++)
        t->rotor[k].odd = t->in[k].command_valid && is_odd_command(t, k);
    for (int k = 0; k < t->n; k++) {
        struct rotor_inputs *in = &t->in[k];
        in->command_valid = in->command_valid && !t->rotor[k].odd;
        in->withdrawn = !in->operating && in->adhesion == FLAG_BAD && rolls_along(t, k);
        if (!in->operating && in->health != HEALTH_INPUT_INVALID)
            do_not_judge(in, HEALTH_UNKNOWN, REASON_NOT_AVAILABLE);
    }
}

double limit_loss(struct rotor *r, const struct rotor_inputs *in, double p, int64_t now_ns)
{
    const int no_evidence =
        now_ns < r->unreliable_until_ns || r->uncommanded_s > 0.0 || in->may_be_off;
    if (!no_evidence || !(p > UNDECIDED))
        return p;
    r->uncertain = 1;
    return UNDECIDED;
}

void train_reset(struct rotor *rotors, int n)
{
    for (int k = 0; k < n; k++)
        rotors[k] = (struct rotor){
            .rated_nm = rotors[k].rated_nm,
            .inertia_kg_m2 = rotors[k].inertia_kg_m2,
            .motor = rotors[k].motor,
            .speed = NAN,
            .load = NAN,
            .slow_speed = NAN,
            .quick_speed = NAN,
            .creep = NAN,
            .train_speed = NAN,
            .train_limit = NAN,
            .slip = NAN,
            .diameter = 1.0,
            .unreliable_until_ns = NO_TIME,
        };
    for (int k = n - 1; k >= 0; k--) {
        const int first = rotors[k].motor;
        if (first == k)
            continue;
        rotors[k].next_alike = rotors[first].next_alike;
        rotors[first].next_alike = k;
    }
}

void assess_train(struct rotor *rotors, struct rotor_inputs *inputs, int n, int64_t now_ns,
                  double tick_s, double *workspace)
{
    struct train_tick t = {.rotor = rotors,
                           .in = inputs,
                           .n = n,
                           .now_ns = now_ns,
                           .tick_s = tick_s,
                           .workspace = workspace};
    follow_rotors(&t);
    assess_loads(&t);
    assess_commands(&t);
}
