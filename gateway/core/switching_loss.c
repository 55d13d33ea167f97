/* The detector `switching`: from the switching model to the probability that the flags use.
 *
 * The switching model (estimators/detect/switching.c) compares the drives. No comparison detects
 * that all drives have lost adhesion at once: common_loss.c derives this from their commands.
 *
 * Unknown is a valid result: a drive that is not certain to adhere or to be lost has no flag.
 *
 * Nothing here can fail: there is at least one drive, all command ratios are at least RATIO_FLOOR
 * (loads.c), nothing else divides, and comparisons with NaN are false, the safe answer. */
#include "gateway/core/switching_loss.h"

#include <math.h>

#include "estimators/detect/command_response.h"
#include "estimators/detect/switching.h"
#include "estimators/numbers.h"
#include "gateway/core/common_loss.h"
#include "gateway/core/train.h"
#include "gateway/core/train_tick.h"

#define MOST_LOAD 2.0  /* per unit of rated torque; no drive carries more */
#define SURE      0.99 /* probability of a loss that needs no confirmation */
#define GRIPS     0.5  /* least probability of adhering for `Adhering` */
#define DOUBTED   0.1  /* largest probability of a loss for it, unless the flag is bad: */
                       /* at the end of a loss the probability is late, not wrong */
#define ANSWERS 0.1    /* largest probability of a deficit of a drive that carries what is asked */
#define FULL_COMMAND 0.9 /* share of the largest command of the last seconds */
#define COUNTS       0.5 /* probability of a drive that adheres, or that stays behind its command */
#define ACCUSED      0.7
/* Common load, per unit of rated torque, from which the comparison alone is evidence of a loss:
 * with less, the friction of each wheel is as large as a loss. */
#define ACCUSING_LOAD 0.2
#define LITTLE        0.1 /* load, per unit of rated torque, of a wheel that carries nothing */
#define CUT_OUT 0.2 /* share of its largest command, less than of a drive that follows a flag */
/* A drive that follows its own flag changes its torque between two `Status` frames: by this share
 * of the largest command per second, but by no more than this share of its own. */
#define RETURN_PER_S 1.0
#define RETURN_MOST  0.3
/* A lost wheel has gripped again once it carries what is asked. Then its own slip control may hold
 * back its load, or its inertia add to it: for HELD_BACK_S at most, and for LOAD_BACK_S once the
 * load is that of the others, or until it slides again. Meanwhile it is no measure for them. */
#define HELD_BACK_S 2.0
#define LOAD_BACK_S 0.1
#define UNSEEN_S    0.1  /* least time in which a wheel runs away and grips again */
#define BACK        0.9  /* probability of adhering from which the load is back */
#define SLIDES      0.05 /* creep in the direction of the effort; 3 % of slow wheels is noise */

/* Standard deviation by which the load of a drive that reduces its torque may differ from its last
 * command. */
static double command_error(const struct adhesion *a, int k, double load)
{
    const struct drive_load *mine = &a->loads[k];
    if (!mine->derating_active || mine->asked_ratio >= 1.0)
        return 0.0;
    const int obeyed = mine->command_ratio < 1.0;
    const double moved =
        obeyed ? RETURN_PER_S * a->responses[k].command_age_s : 1.0 - mine->asked_ratio;
    return fabs(load) * clamp(moved / mine->asked_ratio, 0.0, RETURN_MOST);
}

/* 1 if drive k certainly carries what it is asked for, and that is as much as a while ago: a
 * sliding wheel may carry the torque to which its drive has reduced the command. */
static int answers(const struct adhesion *a, int k)
{
    const struct drive_load *mine = &a->loads[k];
    const int full = fabs(a->responses[k].command) >= FULL_COMMAND * mine->most_asked;
    return full && mine->response_valid && mine->p_response <= ANSWERS;
}

/* 1 if drive k was never asked for as much as the demand: the load of a wheel that gripped again has
 * been taken for the demand. */
static int never_asked(const struct adhesion *a, int k)
{
    return a->rotor_inputs[k].command_valid && fabs(a->common) > most_load(a->loads[k].most_asked);
}

/* 1 if some drive has neither run away nor gripped again just now: it is a measure for others. */
static int any_measure(const struct adhesion *a)
{
    for (int k = 0; k < a->n; k++)
        if (a->known[k] && !a->rotors[k].away && !(a->loads[k].regripped_s > 0.0))
            return 1;
    return 0;
}

void compare_by_memory(struct adhesion *a)
{
    struct switching *s = a->switching;
    const int measured = any_measure(a);
    int count = 0;
    for (int k = 0; k < a->n; k++) {
        struct switching_load *in = &s->loads[k];
        const double load = a->loads[k].load / a->loads[k].command_ratio;
        in->known = a->known[k] && isfinite(load);
        in->load = in->known ? clamp(load, -MOST_LOAD, MOST_LOAD) : 0.0;
        in->gain = 1.0 / a->loads[k].command_ratio - 1.0;
        in->error = command_error(a, k, in->load);
        in->sigma = a->loads[k].sigma;
        in->source = a->loads[k].by_observer;
        in->answers = (uint8_t)(answers(a, k) || never_asked(a, k));
        in->apart = a->rotors[k].away || (measured && a->loads[k].regripped_s > 0.0);
        in->unsure = a->rotors[k].away || a->rotors[k].uncertain;
        count += a->known[k] != 0;
    }
    if (a->n > 1) {
        switching_tick(s);
    } else {
        /* A single drive is not compared. */
        s->adhering[0] = 1.0;
        s->lost[0] = 0.0;
        s->demand = s->loads[0].load;
    }
    for (int k = 0; k < a->n; k++) {
        a->loss_probability[k] = s->lost[k];
        a->loss_known[k] = count >= 2 && a->known[k];
    }
    a->common = s->demand;
}

/* 1 if drive k adheres and turns with the others. */
static int holds(const struct adhesion *a, int k)
{
    return a->known[k] && a->switching->adhering[k] >= GRIPS && !a->rotors[k].far;
}

/* 1 if any drive adheres, so that others can be lost beside it. If none does, the demand may be
 * anything; wheels that never turned alike need not carry alike. */
static int any_adheres(const struct adhesion *a)
{
    for (int k = 0; k < a->n; k++)
        if (holds(a, k))
            return 1;
    return 0;
}

static int any_asked(const struct adhesion *a)
{
    for (int k = 0; k < a->n; k++)
        if (is_asked(&a->responses[k]))
            return 1;
    return 0;
}

/* 1 if a rotor that is tracked carries nothing and turns with the others. */
static int turns_freely(const struct rotor *r)
{
    return turns_along(r) && fabs(r->load) <= LITTLE;
}

/* 1 if drive k rolls: the train is asked for nothing, and the drive turns freely at constant speed.
 * If all slow down, friction brakes may be the cause: all may slide. */
static int rolls(const struct adhesion *a, int k)
{
    const struct rotor *r = &a->rotors[k];
    return a->responses[k].usable && turns_freely(r) && is_steady(r);
}

/* 1 if drive k, cut out of a train that is driven, rolls with wheels that adhere. Its command comes
 * after its load has gone, so it may be flagged. A drive that follows its flag is asked for more. */
static int rolls_along(const struct adhesion *a, int k)
{
    const struct command_response *own = &a->responses[k];
    const double most = a->loads[k].most_asked;
    const int less = most <= LITTLE || fabs(own->command) < CUT_OUT * most;
    const int cut_out = a->rotor_inputs[k].command_valid && less && is_coasting(own);
    if (!cut_out || !turns_freely(&a->rotors[k]))
        return 0;
    for (int i = 0; i < a->n; i++)
        if (holds(a, i) && is_asked(&a->responses[i]) && !a->rotors[i].away)
            return 1;
    return 0;
}

/* 1 if drive k can be judged at all. */
static int is_comparable(const struct adhesion *a, int k, double all)
{
    const int asked = is_asked(&a->responses[k]);
    const int idle = a->responses[k].usable && !asked;
    const struct drive_load *mine = &a->loads[k];
    const int behind = mine->response_valid && mine->p_response > COUNTS;
    const int low = !(fabs(a->common_smoothed) >= ACCUSING_LOAD) && !behind;
    /* A drive that is asked for nothing cannot lose anything. */
    if (a->switching->lost[k] >= ACCUSED && (idle || (low && all == 0.0)))
        return 0;
    return a->known[k] && ((a->loss_known[k] && a->comparable) || asked);
}

/* 1 if a drive beside drive k adheres and carries what it is asked for: then the commands are right,
 * and no brake, hill or ramp explains what drive k is missing of its own. */
static int another_answers(const struct adhesion *a, int k)
{
    for (int i = 0; i < a->n; i++)
        if (i != k && holds(a, i) && answers(a, i))
            return 1;
    return 0;
}

/* Probability of a loss for the flags: above `raise_probability`, below
 * `clear_probability`, or UNDECIDED in between. any: a drive adheres. */
static double verdict(const struct adhesion *a, int k, double all, int any, int bad,
                      uint8_t *uncertain)
{
    const double adhering = a->switching->adhering[k], lost = a->switching->lost[k];
    const struct drive_load *mine = &a->loads[k];
    double p = lost + adhering * all;
    /* A wheel that has run away and stays behind its command, however slowly that developed; or one
     * that seems to, beside one that does not: what the comparison learnt of it may be a loss. */
    const int seems_lost = mine->p_response >= UNDECIDED && another_answers(a, k);
    if (mine->response_valid && (a->rotors[k].away || seems_lost))
        p = larger(p, mine->p_response);
    /* If no drive adheres, the demand may be anything: then a drive that carries what it is asked
     * for adheres. */
    if (!any && answers(a, k))
        return mine->p_response;
    const int behind = mine->response_valid && mine->p_response >= a->rules->raise_probability;
    if (p >= a->rules->raise_probability && !any && !behind) {
        *uncertain = 1;
        return UNDECIDED;
    }
    /* While commands pass through zero, drives do not follow at exactly the same instant. */
    const int passing = is_asked(&a->responses[k]) && !mine->response_valid;
    if (p >= a->rules->raise_probability)
        return passing && !a->rotors[k].away ? UNDECIDED : p;
    if (all > 0.0 && adhering >= COUNTS)
        return UNDECIDED;
    if (!(adhering >= GRIPS && (bad || lost <= DOUBTED)))
        *uncertain = 1;
    return p;
}

/* 1 if drive k has become known again: meanwhile it may have run away and gripped. */
static int is_known_again(const struct adhesion *a, int k, int bad)
{
    const int learnt = a->rotors[k].learnt_s >= DIAMETER_ROUGH_S;
    return a->known[k] && a->loads[k].unknown_s >= UNSEEN_S && learnt && !bad;
}

/* 1 if drive k adheres by the comparison and by its verdict p. */
static int carries(const struct adhesion *a, int k, double p)
{
    const int adheres = a->known[k] && a->switching->adhering[k] >= GRIPS;
    return adheres && p <= a->rules->clear_probability;
}

/* Update the time for which its own slip control may hold back drive k. grips: 1 if it adheres. */
static void follow_regrip(struct adhesion *a, int k, int grips, int bad)
{
    double *left_s = &a->loads[k].regripped_s;
    const struct rotor *r = &a->rotors[k];
    const double adhering = a->known[k] ? a->switching->adhering[k] : 0.0;
    const double slip = a->common < 0.0 ? -r->creep : r->creep;
    const double times = adhering >= BACK ? HELD_BACK_S / LOAD_BACK_S : 1.0;
    const int returns = bad || (r->apart && *left_s > 0.0);
    if (is_known_again(a, k, bad) || (grips && returns))
        *left_s = HELD_BACK_S;
    else if (r->away || !(slip <= SLIDES))
        *left_s = 0.0;
    else
        *left_s = larger(0.0, *left_s - times * a->tick_s);
}

/* Verdict on a drive that may be held back. If it has come back from a slide, the regrip clears the
 * flag; later it is not known what the rail would carry. uncertain: that of its rotor alone. */
static double held_back(struct adhesion *a, int k, double p, int bad, uint8_t uncertain)
{
    struct rotor *r = &a->rotors[k];
    if (!(a->loads[k].regripped_s > 0.0) || r->away || p <= a->rules->clear_probability)
        return p;
    const int clears = bad && r->apart;
    r->uncertain = clears ? uncertain : 1;
    return clears ? 0.0 : UNDECIDED;
}

/* 1 if a lost wheel has gripped just now: it turns with the others and carries at least the demand.
 * If that is more than any comparison explains, it gives back what it gained in speed. */
static int has_gripped(const struct adhesion *a, int k, int bad)
{
    const struct rotor *r = &a->rotors[k];
    const struct drive_load *mine = &a->loads[k];
    const int recent = bad || mine->regripped_s > 0.0;
    if (!recent || r->away || !turns_along(r))
        return 0;
    if (mine->response_valid && mine->p_response > DOUBTED)
        return 0;
    const double adhering = a->switching->adhering[k], lost = a->switching->lost[k];
    const int neither = a->known[k] && adhering < GRIPS && lost <= DOUBTED;
    const double load = copysign(1.0, a->common) * mine->load / mine->command_ratio;
    const int enough = load >= larger(LITTLE, fabs(a->common));
    return enough && (neither || r->above);
}

/* Judge a drive as one that adheres. */
static void clear_loss(struct adhesion *a, int k)
{
    a->loss_probability[k] = 0.0;
    a->loss_known[k] = 1;
    a->loads[k].severe_loss = 0;
}

void judge_by_memory(struct adhesion *a, const struct drive_status *status, int64_t now_ns)
{
    const double all = follow_common_loss(a);
    const int any = any_adheres(a), asked = any_asked(a);
    for (int k = 0; k < a->n; k++) {
        struct rotor *r = &a->rotors[k];
        const int bad = status[k].flag[FLAG_ADHESION].state == FLAG_BAD;
        if (asked ? rolls_along(a, k) : rolls(a, k)) {
            clear_loss(a, k);
            continue;
        }
        if (has_gripped(a, k, bad)) {
            clear_loss(a, k);
            follow_regrip(a, k, 1, bad);
            continue;
        }
        const uint8_t uncertain = r->uncertain;
        double p = verdict(a, k, all, any, bad, &r->uncertain);
        follow_regrip(a, k, carries(a, k, p), bad);
        p = held_back(a, k, p, bad, uncertain);
        a->loss_known[k] = (uint8_t)is_comparable(a, k, all);
        p = limit_loss(r, &a->rotor_inputs[k], p, now_ns);
        a->loss_probability[k] = p;
        a->loads[k].severe_loss = a->known[k] && p >= SURE;
    }
}
