/* Load of each drive compared with its command, per unit of its rated torque.
 *
 * Commands make loads comparable: a drive with half the command of the others should carry
 * half the load. Not in paper `adhesion`, in which all drives have the same command.
 *
 * Nothing here can fail: divisors are rated torques and the period of a tick (configured, above 0),
 * a largest command above COASTING, and a ratio that is above 0. Comparisons with NaN are false,
 * and each is written so that false is the safe answer. */
#include "gateway/core/loads.h"

#include <math.h>

#include "estimators/numbers.h"
#include "estimators/order_statistics.h"
#include "gateway/core/train_tick.h"

#define COASTING 0.05 /* share of rated torque; smaller commands are not compared with each other */
#define ASKED_TAU_S   10.0 /* time constant with which the largest command is forgotten */
#define RATIO_FLOOR   0.2  /* least divisor of a load */
#define RATIO_UNKNOWN 0.1  /* a drive with a smaller command carries too little to be compared */
/* Drives. With fewer, a sudden loss is recognised by the speed of the rotor. With more, if the
 * loads of all fall, this may be a load step of the train, and the next commands decide. */
#define ENOUGH_TO_COMPARE 2

/* The number, or 0 if it is not known. */
static double known_or_zero(double x)
{
    return isnan(x) ? 0.0 : x;
}

/* Command of drive k over its rated torque. */
static double relative_command(const struct adhesion *a, const struct drive_input *drives, int k)
{
    return fabs(drives[k].command) / a->rotors[k].rated_nm;
}

/* Median load of the drives that do not follow their own flag; NaN if there are none. */
static double median_load(const struct adhesion *a, int64_t now_ns)
{
    struct ranking loads = {.numbers = a->workspace};
    for (int k = 0; k < a->n; k++)
        if (!is_soon_after(a->loads[k].flagged_ns, now_ns))
            ranking_add(&loads, a->rotors[k].load);
    sort_ascending(loads.numbers, loads.count);
    return median_of_others(&loads, NAN, 0);
}

/* Find drives that follow their own flag: down to 30 % of the torque and back. */
static void find_derating(struct adhesion *a, const struct drive_input *drives,
                          const struct drive_status *status, int64_t now_ns)
{
    const double kept = 1.0 - smaller(a->tick_s / ASKED_TAU_S, 1.0);
    for (int k = 0; k < a->n; k++) {
        const struct flag *flag = &status[k].flag[FLAG_ADHESION];
        struct drive_load *mine = &a->loads[k];
        const int bad = flag->state == FLAG_BAD;
        mine->derating_active = bad || elapsed(flag->since_ns, now_ns) < DERATING_NS;
        if (bad)
            mine->flagged_ns = now_ns;
        const double asked =
            a->rotor_inputs[k].command_valid ? relative_command(a, drives, k) : 0.0;
        mine->most_asked = larger(asked, kept * mine->most_asked);
    }
}

/* The largest command, per unit; *steady: all are steady, except those that follow a flag. */
static double largest_command(const struct adhesion *a, const struct drive_input *drives,
                              int *steady)
{
    double largest = 0.0;
    *steady = 1;
    for (int k = 0; k < a->n; k++) {
        *steady = *steady && (drives[k].command_steady || a->loads[k].derating_active);
        if (a->rotor_inputs[k].command_valid)
            largest = larger(relative_command(a, drives, k), largest);
    }
    return largest;
}

/* Ratio of every command to the largest one; 1 where the ratio has no meaning.
 *
 * `Status` frames of the drives are up to a cycle apart, so commands that change with the train
 * differ only because of their age. They are compared while all are steady; the command of a drive
 * that follows its own flag is always compared. */
static void relate_commands(struct adhesion *a, const struct drive_input *drives, int64_t now_ns)
{
    int steady;
    const double largest = largest_command(a, drives, &steady);
    for (int k = 0; k < a->n; k++)
        a->loads[k].command_ratio = a->loads[k].asked_ratio = 1.0;
    if (largest <= COASTING)
        return;
    const double common = median_load(a, now_ns);
    for (int k = 0; k < a->n; k++) {
        struct drive_load *mine = &a->loads[k];
        if (!a->rotor_inputs[k].command_valid || !(steady || mine->derating_active))
            continue;
        const double ratio = relative_command(a, drives, k) / largest;
        const double load = a->rotors[k].load;
        mine->asked_ratio = larger(RATIO_FLOOR, ratio);
        /* The drive does not obey a command that makes its load less like those of the others. */
        const double off = ratio > 0.0 ? fabs(load / ratio - common) : HUGE_VAL;
        if (!(fabs(load - common) < off))
            mine->command_ratio = ratio;
    }
}

/* Find loads that may be compared, and their values in the direction of the train. Returns the number. */
static int find_known(struct adhesion *a, const struct drive_estimate *estimates)
{
    int count = 0;
    for (int k = 0; k < a->n; k++) {
        struct drive_load *mine = &a->loads[k];
        const int tracks = estimates[k].health == HEALTH_TRACKING && !a->rotors[k].above;
        a->known[k] = tracks && mine->command_ratio >= RATIO_UNKNOWN;
        mine->command_ratio = larger(RATIO_FLOOR, mine->command_ratio);
        const double load_nm = known_or_zero(estimates[k].load_nm);
        mine->load = direction_of(&a->rotors[k], load_nm) * load_nm / a->rotors[k].rated_nm;
        mine->sigma = known_or_zero(estimates[k].load_sigma_nm) / a->rotors[k].rated_nm;
        mine->by_observer = estimates[k].by_observer;
        count += a->known[k];
    }
    return count;
}

/* Torque that accelerated a rotor, mean over a tick: the larger of the last two ticks. A quick
 * speed control removes the torque within a tick; the speed that it could not hold is visible for
 * longer. speed: NaN if it is not known or not needed. */
static double spin_up(const struct adhesion *a, int k, double speed)
{
    struct drive_load *mine = &a->loads[k];
    const int first = isnan(mine->last_speed);
    const double last_speed = first ? speed : mine->last_speed;
    const double last = first ? 0.0 : mine->last_spin_up;
    mine->last_speed = speed;
    if (isnan(speed))
        return 0.0;
    const struct rotor *r = &a->rotors[k];
    const double torque = r->inertia_kg_m2 * (speed - last_speed) / a->tick_s / r->rated_nm;
    mine->last_spin_up = torque;
    return fabs(torque) >= fabs(last) ? torque : last;
}

void relate_loads(struct adhesion *a, const struct drive_estimate *estimates,
                  const struct drive_input *drives, const struct drive_status *status,
                  int64_t now_ns)
{
    find_derating(a, drives, status, now_ns);
    relate_commands(a, drives, now_ns);
    const int alone = find_known(a, estimates) < ENOUGH_TO_COMPARE;
    for (int k = 0; k < a->n; k++) {
        const struct rotor *r = &a->rotors[k];
        struct command_response *response = &a->responses[k];
        const double load = known_or_zero(estimates[k].load_nm) / r->rated_nm;
        response->load = load + r->acceleration_torque;
        response->braked_load = response->load + r->brake_torque;
        response->acceleration_torque =
            spin_up(a, k, alone ? estimates[k].speed_rad_s : (double)NAN);
        response->command = known_or_zero(drives[k].command) / r->rated_nm;
        response->previous_command = known_or_zero(drives[k].previous_command) / r->rated_nm;
        response->command_age_s = (double)elapsed(drives[k].command_ns, now_ns) / SECOND_NS;
        /* At a crawl what accelerates a train is a large part of its load: no answer to a command. */
        const int answers = a->known[k] && !estimates[k].crawls;
        response->usable = a->rotor_inputs[k].command_valid && answers;
    }
}
