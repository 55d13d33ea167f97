/* Detection of drives that have lost adhesion.
 *
 * Two criteria are fused. The detector compares the drives with one another; their loads are
 * normalised to full command, to the direction of the train and to the learnt ratio of each drive.
 * And the load of each drive is compared with its own command, which detects what no comparison
 * can: a loss of all drives at once, and a loss of a drive that runs alone.
 *
 * Nothing here can fail: the one divisor is a constant, comparisons with NaN are false, and each is
 * written so that false is the safe answer. */
#include "gateway/core/adhesion.h"

#include <math.h>

#include "estimators/detect/command_response.h"
#include "estimators/detect/load_reference.h"
#include "estimators/detect/switching.h"
#include "estimators/detect/variational.h"
#include "estimators/numbers.h"
#include "gateway/core/flags.h"
#include "gateway/core/loads.h"
#include "gateway/core/rotors.h"
#include "gateway/core/switching_loss.h"
#include "gateway/core/train.h"

/* Loads differ by this standard deviation for some seconds: curves, load steps. That is too short
 * to be learnt. */
#define TRANSIENT_SPREAD 0.035
/* Drives are compared from a common load of MORE_LOAD on, down to LEAST_LOAD: with less load, a
 * lost wheel cannot be distinguished from one that adheres. */
#define LEAST_LOAD 0.07
#define MORE_LOAD  0.10
#define LOAD_TAU_S 0.2 /* time constant of that common load: noise must not decide */
/* Missing load from which on noise is not the cause: share of the load, and multiple of sigma. */
#define SEVERE_SHARE 0.35
#define SEVERE_SIGMA 6.0
/* A drive with a more probable loss is not learnt from. The limit is not lower: learning only from
 * the best-looking loads would make the reference too good. */
#define PROBABLY_GOOD 0.5
#define SETTLED_NS    300000000 /* a load is learnt from after it has been known for this time */
/* An emergency comes before the `Status` that says whether the drive still operates: this is due
 * after STATUS_DUE_NS. One that is received within STATUS_LATE_NS may have been sent before. */
#define STATUS_DUE_NS  300000000
#define STATUS_LATE_NS 10000000

void adhesion_reset(struct adhesion *a, double spread)
{
    train_reset(a->rotors, a->n);
    load_reference_reset(&a->response_spread, a->response_ratios, a->n, spread);
    load_reference_reset(&a->spread, a->ratios, a->n, spread);
    for (int k = 0; k < a->n; k++) {
        a->rotor_inputs[k] = (struct rotor_inputs){.measured_rad_s = NAN};
        a->responses[k] = (struct command_response){.usable = 0};
        a->loads[k] = (struct drive_load){
            .command_ratio = 1.0,
            .asked_ratio = 1.0,
            .last_speed = NAN,
            .flagged_ns = NO_TIME,
            .known_since_ns = NO_TIME,
        };
        a->known[k] = a->compared[k] = a->loss_known[k] = a->may_learn[k] = 0;
        a->normalised[k] = a->sigma[k] = a->loss_probability[k] = 0.0;
    }
    if (a->switching)
        switching_reset(a->switching);
    a->common_mode = (struct flag){.state = FLAG_UNKNOWN, .evidence = FLAG_UNKNOWN};
    a->common_missing_s = 0.0;
    a->learn_ns = a->flagged_ns = NO_TIME;
    a->common = 0.0;
    a->common_smoothed = NAN;
    a->comparable = 0;
}

/* ---- Before the detector ---- */

/* 1 if a drive sent an emergency and no `Status` since: it may have stopped, or it may not. */
static int may_be_off(const struct drive_input *drive, int64_t now_ns)
{
    const int64_t then_ns = drive->emergency_ns;
    return then_ns >= 0 && elapsed(then_ns, now_ns) < STATUS_DUE_NS &&
           elapsed(then_ns, drive->command_ns) < STATUS_LATE_NS;
}

/* Find commands that cannot be right, and drives that cannot be judged. */
static void judge_train(struct adhesion *a, struct drive_estimate *estimates,
                        const struct input_status *inputs, const struct drive_input *drives,
                        const struct drive_status *status, int64_t now_ns)
{
    for (int k = 0; k < a->n; k++) {
        struct rotor_inputs *in = &a->rotor_inputs[k];
        in->measured_rad_s = inputs[k].speed_rad_s;
        in->command_valid = inputs[k].command_valid;
        in->speed_rad_s = estimates[k].speed_rad_s;
        in->load_nm = estimates[k].load_nm;
        in->health = estimates[k].health;
        in->command_nm = drives[k].command;
        in->previous_command_nm = drives[k].previous_command;
        in->operating = drives[k].operating;
        in->may_be_off = (uint8_t)may_be_off(&drives[k], now_ns);
        in->adhesion = status[k].flag[FLAG_ADHESION].state;
        in->not_judged = in->withdrawn = 0;
    }
    assess_train(a->rotors, a->rotor_inputs, a->n, now_ns, a->tick_s, a->workspace);
    for (int k = 0; k < a->n; k++) {
        const struct rotor_inputs *in = &a->rotor_inputs[k];
        if (in->not_judged) {
            struct drive_estimate *e = &estimates[k];
            e->speed_rad_s = e->load_nm = e->load_sigma_nm = e->nis = NAN;
            e->health = in->health;
            e->health_reason = in->health_reason;
        }
    }
}

/* Find loads that are a measure for others. A wheel that slides is lost whatever it carries. When
 * it grips it carries more than one that adheres, with the opposite sign if it turned backwards. */
static void find_compared(struct adhesion *a)
{
    double total = 0.0;
    for (int k = 0; k < a->n; k++)
        total += a->known[k] ? a->normalised[k] : 0.0;
    for (int k = 0; k < a->n; k++) {
        const double along = copysign(1.0, total) * a->normalised[k];
        a->compared[k] = a->known[k] && !a->rotors[k].sliding && !(along < -MORE_LOAD);
    }
}

void adhesion_prepare(struct adhesion *a, struct drive_estimate *estimates,
                      const struct input_status *inputs, const struct drive_input *drives,
                      const struct drive_status *status, int64_t now_ns)
{
    judge_train(a, estimates, inputs, drives, status, now_ns);
    relate_loads(a, estimates, drives, status, now_ns);
    for (int k = 0; k < a->n; k++) {
        const double load = a->loads[k].load, ratio = a->loads[k].command_ratio;
        a->normalised[k] = normalise_load(&a->ratios[k], load, ratio);
        a->sigma[k] = normalised_sigma(&a->spread, &a->ratios[k], load, ratio, TRANSIENT_SPREAD);
    }
    find_compared(a);
}

void adhesion_detect(struct adhesion *a)
{
    if (a->switching) {
        compare_by_memory(a);
        return;
    }
    int count = 0;
    for (int k = 0; k < a->n; k++)
        count += a->compared[k] != 0;
    for (int k = 0; k < a->n; k++) {
        a->loss_probability[k] = 0.0;
        a->loss_known[k] = count >= 2 && a->compared[k];
    }
    a->common = vb_detect(&a->priors, a->iterations, a->normalised, a->sigma, a->compared, a->n,
                          a->workspace, a->loss_probability);
}

/* ---- After the detector ---- */

/* Judge every drive by its own command response. Returns 1 if a load answers a new command. */
static int respond_alone(struct adhesion *a)
{
    int answered = 0;
    for (int k = 0; k < a->n; k++) {
        struct drive_load *mine = &a->loads[k];
        mine->p_response = respond(&a->responses[k], &a->response_spread, &a->response_ratios[k],
                                   a->tick_s, &mine->response_valid);
        /* An odd command is no evidence of a loss. */
        if (a->rotors[k].odd_s > 0.0)
            mine->p_response = smaller(UNDECIDED, mine->p_response);
        follow_braked(&a->rotors[k], a->responses[k].braked, a->tick_s);
        answered = answered || a->responses[k].command_age_s < a->tick_s;
    }
    return answered;
}

static int any_compared(const struct adhesion *a)
{
    for (int k = 0; k < a->n; k++)
        if (a->loss_known[k])
            return 1;
    return 0;
}

/* Follow the common load, and whether it is large enough for a comparison. Returns 1 if it is too
 * small to be evidence of a loss of one drive. */
static int follow_common(struct adhesion *a)
{
    if (!any_compared(a)) {
        a->common_smoothed = NAN;
        return 0;
    }
    if (isnan(a->common_smoothed))
        a->common_smoothed = a->common;
    a->common_smoothed += smaller(a->tick_s / LOAD_TAU_S, 1.0) * (a->common - a->common_smoothed);
    const double smoothed = fabs(a->common_smoothed);
    a->comparable = smoothed >= (a->comparable ? LEAST_LOAD : MORE_LOAD);
    return smaller(fabs(a->common), smoothed) < MORE_LOAD;
}

/* A comparison of drives that carry next to nothing is not valid. */
static void limit_comparison(struct adhesion *a, int little)
{
    for (int k = 0; k < a->n; k++) {
        const int accused = little && a->loss_probability[k] > UNDECIDED;
        a->loss_known[k] = a->loss_known[k] && a->comparable && !accused;
    }
}

/* Fuse both criteria into one probability of a loss. */
static void fuse_views(struct adhesion *a, int64_t now_ns)
{
    for (int k = 0; k < a->n; k++) {
        struct rotor *r = &a->rotors[k];
        const struct drive_load *mine = &a->loads[k];
        const double p = fuse_loss(&a->responses[k], a->loss_probability[k], a->loss_known[k],
                                   mine->p_response, mine->response_valid, r->away);
        a->loss_probability[k] = limit_loss(r, &a->rotor_inputs[k], p, now_ns);
        a->loss_known[k] = a->loss_known[k] || is_asked(&a->responses[k]);
    }
}

/* Note since when the loads have been known. */
static void note_known(struct adhesion *a, int64_t now_ns)
{
    for (int k = 0; k < a->n; k++) {
        struct drive_load *mine = &a->loads[k];
        mine->unknown_s = a->known[k] ? 0.0 : mine->unknown_s + a->tick_s;
        if (!a->known[k])
            mine->known_since_ns = NO_TIME;
        else if (mine->known_since_ns == NO_TIME)
            mine->known_since_ns = now_ns;
    }
}

static void find_severe(struct adhesion *a)
{
    for (int k = 0; k < a->n; k++) {
        struct drive_load *mine = &a->loads[k];
        const int severe = is_severe_loss(&a->responses[k], a->common, a->normalised[k],
                                          a->sigma[k], SEVERE_SHARE, SEVERE_SIGMA);
        mine->severe_loss = a->known[k] && severe;
    }
}

/* Evidence of a loss of all drives at once. One drive that adheres rules it out; to confirm it, all
 * loads must be known. Drives that coast are no evidence. */
static int common_mode_evidence(const struct adhesion *a)
{
    int usable = 1, all_known = 1, any_driven = 0;
    double p = 1.0;
    for (int k = 0; k < a->n; k++) {
        if (!a->known[k]) {
            all_known = 0;
            continue;
        }
        any_driven = any_driven || !is_coasting(&a->responses[k]);
        usable = usable && a->responses[k].usable;
        p = smaller(a->loads[k].p_response, p);
    }
    if (!any_driven || !usable || !(all_known || p <= a->rules->clear_probability))
        return FLAG_UNKNOWN;
    return loss_evidence(a->rules, p);
}

/* ---- What is learnt ---- */

/* Drives that may be learnt from: none while any drive is lost or regains its grip. */
static void find_healthy(struct adhesion *a, const struct drive_input *drives,
                         const struct drive_status *status, int64_t now_ns)
{
    for (int k = 0; k < a->n; k++)
        /* A drive that is cut out keeps its flag, but does not stop the others from learning. */
        if (status[k].flag[FLAG_ADHESION].state == FLAG_BAD && drives[k].operating)
            a->flagged_ns = now_ns;
    const int shaken = is_soon_after(a->flagged_ns, now_ns);
    for (int k = 0; k < a->n; k++) {
        const int64_t since = a->loads[k].known_since_ns;
        const int settled = since != NO_TIME && elapsed(since, now_ns) >= SETTLED_NS;
        const int good = status[k].flag[FLAG_ADHESION].state == FLAG_GOOD;
        const int certain = a->loss_known[k] && a->loss_probability[k] < PROBABLY_GOOD;
        a->may_learn[k] = settled && good && certain && !shaken;
    }
}

/* Differences between the drives. */
static void learn_differences(struct adhesion *a)
{
    for (int k = 0; k < a->n; k++)
        a->observed[k] = (struct load_observation){
            .load = a->loads[k].load / a->loads[k].command_ratio, /* RATIO_FLOOR or more */
            .common = a->common,
            .known = a->known[k],
            .healthy = a->may_learn[k],
        };
    update_spread(&a->spread, a->ratios, a->observed, a->n, 1);
    update_ratios(&a->spread, a->ratios, a->observed, a->n, 1);
}

/* Learn responses from every new command (`answered`), and differences every LEARN_PERIOD_S. */
static void learn(struct adhesion *a, int answered, const struct drive_input *drives,
                  const struct drive_status *status, int64_t now_ns)
{
    const int due = now_ns >= a->learn_ns;
    if (!answered && !due)
        return;
    find_healthy(a, drives, status, now_ns);
    if (answered)
        learn_responses(a->responses, &a->response_spread, a->response_ratios, a->may_learn, a->n,
                        a->tick_s, a->observed);
    if (due) {
        a->learn_ns = now_ns + (int64_t)(LEARN_PERIOD_S * SECOND_NS); /* a constant */
        learn_differences(a);
    }
}

/* A wheel whose speed differs from the train's by more than any train can explain is lost. */
static void accuse_sliding(struct adhesion *a)
{
    for (int k = 0; k < a->n; k++) {
        if (!a->rotors[k].sliding)
            continue;
        a->loss_probability[k] = 1.0;
        a->loss_known[k] = a->loads[k].severe_loss = 1;
    }
}

void adhesion_fuse(struct adhesion *a, const struct drive_input *drives,
                   const struct drive_status *status, int64_t now_ns)
{
    const int answered = respond_alone(a);
    const int little = follow_common(a);
    if (a->switching) {
        judge_by_memory(a, status, now_ns);
    } else {
        limit_comparison(a, little);
        fuse_views(a, now_ns);
        find_severe(a);
    }
    accuse_sliding(a);
    note_known(a, now_ns);
    debounce(&a->common_mode, common_mode_evidence(a), &a->rules->timing[FLAG_ADHESION],
             a->rules->tick_ns, now_ns);
    learn(a, answered, drives, status, now_ns);
}

void detect_loss(struct adhesion *a, struct drive_estimate *estimates,
                 const struct input_status *inputs, const struct drive_input *drives,
                 const struct drive_status *status, int64_t now_ns)
{
    adhesion_prepare(a, estimates, inputs, drives, status, now_ns);
    adhesion_detect(a);
    adhesion_fuse(a, drives, status, now_ns);
}
