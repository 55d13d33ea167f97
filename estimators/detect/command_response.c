/* Response of a drive's load to its own command, without any other drive.
 *
 * A train is heavy: the rail carries the torque that a drive is commanded less the few percent that
 * accelerate its own rotor. A load that stays behind its command means a wheel that does not carry.
 * This detects what no comparison of drives can: a loss of all wheels, and of a single drive.
 *
 * Commands come late (every 100 ms). A load that falls may follow a command that has not been
 * received yet; so a deficit counts only if it outlasts a command that was sent after it began, or
 * if it is sudden, large, and has released the rotor: if the load falls first, the remaining torque
 * accelerates the wheel; if the torque falls first, it does not. Until then: UNDECIDED. Not in
 * paper `adhesion`.
 *
 * Nothing here can fail: the divisors are a ratio, which load_reference.c keeps near 1, and a
 * sigma, which is at least the floor of the spread. erfc is that of the C library and may differ in
 * its last bit between libraries: a probability then differs by some 1e-16, which decides a flag
 * only within that distance of its threshold. */
#include "estimators/detect/command_response.h"

#include <math.h>

#include "estimators/detect/load_reference.h"

#define THRESHOLD     0.12 /* share of the command that must be missing */
#define LEAST_COMMAND 0.1 /* with a smaller command a wheel carries nothing that could be missing */
#define OPEN          0.7 /* UNDECIDED */
#define STANDS        0.9 /* probability of a deficit that is real: less may be noise */
#define LARGE         0.5 /* share of the command that is missing in a sudden loss */
#define SUDDEN_S 0.015 /* time since a deficit was first seen: no load of a train falls so fast */
#define SPIN_UP  0.25  /* share of the missing load found in the acceleration of the rotor */
#define CONFIRMED_S    1e6  /* counts as confirmed by a command, while the deficit stands */
#define LAG_S          0.01 /* a command sent so long after a deficit is later than its cause */
#define STEADY         0.05 /* commands that differ by less may be learnt from */
#define CERTAINLY_GOOD 0.05 /* response that overrules a comparison, unless that is SURE */
#define VETOED         0.4  /* probability of a comparison that the response overrules, at most */
#define SURE           0.99 /* comparison that nothing overrules */
#define SQRT_HALF      (1.0 / 1.4142135623730951)

const double UNDECIDED = OPEN;

/* The larger, and the smaller, of two; the first if one is NaN. */
static double larger(double a, double b)
{
    return b > a ? b : a;
}

static double smaller(double a, double b)
{
    return b < a ? b : a;
}

/* Between two messages the command may be anywhere on its way, or further along it. */
static double ahead(const struct command_response *drive)
{
    return 2.0 * drive->command - drive->previous_command;
}

/* Least magnitude that the command can have; 0 if it may pass through zero. */
static double least_command(const struct command_response *drive)
{
    const double a = drive->command, b = drive->previous_command, c = ahead(drive);
    const int one_sign = smaller(smaller(a, b), c) > 0.0 || larger(larger(a, b), c) < 0.0;
    return one_sign ? smaller(smaller(fabs(a), fabs(b)), fabs(c)) : 0.0;
}

int is_coasting(const struct command_response *drive)
{
    const double most = larger(fabs(drive->command), fabs(drive->previous_command));
    return larger(most, fabs(ahead(drive))) < LEAST_COMMAND;
}

int is_asked(const struct command_response *drive)
{
    return drive->usable && !is_coasting(drive);
}

/* Note what is missing of the least load that the drive must carry, if it carries `load`. */
static void note_missing(struct command_response *drive, const struct load_spread *all,
                         const struct load_ratio *ratio, double load, double least)
{
    const double sign = drive->command > 0.0 ? 1.0 : -1.0;
    drive->missing = least * (1.0 - THRESHOLD) - sign * load / ratio->ratio;
    drive->missing_sigma = normalised_sigma(all, ratio, load, 1.0, 0.0);
}

/* Probability of a deficit, from the missing load alone. */
static double deficit_probability(const struct command_response *drive)
{
    return 0.5 * erfc(-drive->missing / drive->missing_sigma * SQRT_HALF);
}

/* Probability of a deficit; `braked`: the missing load may slow the rotor, if friction brakes slow
 * its train as much. They build up as fast as the rotor shows it: a deficit that stands already did
 * not begin with them. */
static double find_deficit(struct command_response *drive, const struct load_spread *all,
                           const struct load_ratio *ratio, double least)
{
    note_missing(drive, all, ratio, drive->load, least);
    const double p = deficit_probability(drive);
    if (!(p > OPEN) || drive->deficit_s > 0.0)
        return p;
    note_missing(drive, all, ratio, drive->braked_load, least);
    const double slowed = deficit_probability(drive);
    drive->braked = slowed <= OPEN;
    if (drive->braked)
        return slowed;
    note_missing(drive, all, ratio, drive->load, least);
    return p;
}

/* 1 if a large part of the load has suddenly gone, and the rotor is free. */
static int spins_up(const struct command_response *drive, double least)
{
    const double sign = drive->command > 0.0 ? 1.0 : -1.0;
    const double gone = least - sign * drive->load;
    return gone >= LARGE * least && sign * drive->acceleration_torque >= SPIN_UP * gone &&
           drive->deficit_s <= SUDDEN_S;
}

double respond(struct command_response *drive, const struct load_spread *all,
               const struct load_ratio *ratio, double dt, uint8_t *valid)
{
    const double least = least_command(drive);
    *valid = drive->usable && least >= LEAST_COMMAND;
    drive->braked = 0;
    const double p = *valid ? find_deficit(drive, all, ratio, least) : 0.0;
    const double more = spins_up(drive, least) ? CONFIRMED_S : dt;
    drive->deficit_s = p > STANDS ? drive->deficit_s + more : 0.0;
    if (!*valid)
        return OPEN;
    /* First seen in this tick, it may be a tick old, and the lag of the filter adds to that. */
    const int confirmed = drive->command_age_s + LAG_S + dt <= drive->deficit_s;
    return p > OPEN && !confirmed ? OPEN : p;
}

/* 1 if the load answers a command that has just come and equals the one before: then it has not
 * changed meanwhile. 0 while friction brakes may slow the rotor. */
static int answers(const struct command_response *drive, double dt)
{
    const double near = STEADY * larger(fabs(drive->command), LEAST_COMMAND);
    const double change = fabs(drive->command - drive->previous_command);
    const int slowed = fabs(drive->braked_load - drive->load) > near;
    return drive->usable && change <= near && drive->command_age_s < dt && !slowed;
}

void learn_responses(const struct command_response *drives, struct load_spread *all,
                     struct load_ratio *ratios, const uint8_t *healthy, int n, double dt,
                     struct load_observation *workspace)
{
    int any = 0;
    for (int i = 0; i < n; i++) {
        const int known = answers(&drives[i], dt);
        workspace[i] = (struct load_observation){
            .load = drives[i].load,
            .common = drives[i].command,
            .known = (uint8_t)known,
            .healthy = known && healthy[i],
        };
        any |= known;
    }
    if (!any)
        return;
    update_spread(all, ratios, workspace, n, 0);
    update_ratios(all, ratios, workspace, n, 0);
}

double fuse_loss(const struct command_response *drive, double compared, int compared_known,
                 double p_response, int response_valid, int runs_away)
{
    if (!compared_known)
        return p_response;
    if (response_valid) {
        /* Either can be evidence of a loss. A drive that certainly answers its command is not lost
         * by a comparison that is not SURE: it may have taken a slipping majority for normal. */
        const int outvoted = p_response < CERTAINLY_GOOD && compared <= SURE;
        return larger(outvoted ? smaller(compared, VETOED) : compared, p_response);
    }
    if (!is_asked(drive))
        return compared;
    /* While commands pass through zero, drives do not follow at exactly the same instant: a
     * comparison is no evidence of a loss, nor of adhesion if the rotor runs away. */
    return runs_away ? larger(compared, p_response) : smaller(compared, OPEN);
}

int is_severe_loss(const struct command_response *drive, double common, double normalised,
                   double sigma, double part, double spreads)
{
    const double wanted = common != 0.0 ? common : drive->command;
    const double carried = common != 0.0 ? normalised : drive->load;
    const double missing = wanted > 0.0 ? wanted - carried : carried - wanted;
    return wanted != 0.0 && missing > larger(part * fabs(wanted), spreads * sigma);
}
