/* Flags of a tick, in this order: evidence from the results of the preceding stations, debounce and
 * latch, and what is published.
 *
 * No function here can fail, whatever a record holds: a number that indexes a table is first
 * compared with the size of the table, and nothing divides. Times are compared by differences of
 * stamps, which wrap instead of overflowing if a record holds nonsense. */
#include "gateway/core/flags.h"

#include <math.h>

#include "gateway/core/times.h"

/* ---- Reasons and summaries ---- */

/* Priority by reason. The worst reason of all drives is the one that is sent. */
static const uint8_t RANKS[] = {
    [REASON_CONFIG] = 0,         [REASON_INTRUDER] = 1,  [REASON_OVERRUN] = 2,
    [REASON_CORRUPTED] = 3,      [REASON_SEQUENCE] = 4,  [REASON_RANGE] = 5,
    [REASON_DIVERGED] = 6,       [REASON_STALE] = 7,     [REASON_NOT_AVAILABLE] = 8,
    [REASON_TOO_FEW_DRIVES] = 9, [REASON_STARTING] = 10, [REASON_NONE] = 11,
};

int reason_rank(int reason)
{
    const int known = reason >= REASON_NONE && reason <= REASON_CONFIG;
    return RANKS[known ? reason : REASON_NONE];
}

uint8_t worse_reason(uint8_t one, uint8_t other)
{
    return reason_rank(one) <= reason_rank(other) ? one : other;
}

/* Of two flags: bad if one is, else unknown if one is, else good. */
static uint8_t worse_flag(uint8_t one, uint8_t other)
{
    if (one == FLAG_BAD || other == FLAG_BAD)
        return FLAG_BAD;
    return one == FLAG_UNKNOWN || other == FLAG_UNKNOWN ? FLAG_UNKNOWN : FLAG_GOOD;
}

/* The older of two ages; NO_TIME if one of them is. */
static int64_t older(int64_t one, int64_t other)
{
    if (one == NO_TIME || other == NO_TIME)
        return NO_TIME;
    return one > other ? one : other;
}

/* ---- Evidence ---- */

int loss_evidence(const struct flag_rules *rules, double probability)
{
    if (!(probability >= 0.0 && probability <= 1.0))
        return FLAG_UNKNOWN;
    if (probability >= rules->raise_probability)
        return FLAG_BAD;
    return probability <= rules->clear_probability ? FLAG_GOOD : FLAG_UNCHANGED;
}

/* 1 if the adhesion of a drive can be judged; if not, `reason` is the first that applies. */
static int can_judge(const struct train_inputs *train, const struct flag_inputs *in,
                     uint8_t *reason)
{
    if (train->integrity_reason != REASON_NONE)
        *reason = train->integrity_reason;
    else if (in->input_implausible)
        *reason = worse_reason(in->input_reason, REASON_RANGE);
    else if (in->input_reason != REASON_NONE)
        *reason = in->input_reason;
    else if (in->health == HEALTH_DIVERGED)
        *reason = REASON_DIVERGED;
    else if (in->health != HEALTH_TRACKING)
        *reason = isnan(in->speed_rad_s) ? in->health_reason : REASON_STARTING;
    else if (!in->loss_known)
        *reason = REASON_TOO_FEW_DRIVES;
    else
        return 1;
    return 0;
}

static void adhesion_evidence(const struct flag_rules *rules, const struct train_inputs *train,
                              const struct flag_inputs *in, struct drive_evidence *out)
{
    out->of[FLAG_ADHESION] = FLAG_UNKNOWN;
    if (in->withdrawn && train->integrity_reason == REASON_NONE) {
        out->adhesion_reason = REASON_NOT_AVAILABLE;
        out->of[FLAG_ADHESION] = FLAG_GOOD;
        return;
    }
    if (!can_judge(train, in, &out->adhesion_reason))
        return;
    const int evidence = loss_evidence(rules, in->loss_probability);
    if (in->may_spin_up && evidence != FLAG_BAD) {
        out->adhesion_reason = REASON_RANGE;
        return;
    }
    out->adhesion_reason = REASON_STARTING;
    out->of[FLAG_ADHESION] = (uint8_t)evidence;
}

void collect_evidence(const struct flag_rules *rules, const struct train_inputs *train,
                      const struct flag_inputs *inputs, int n, struct drive_evidence *evidence)
{
    /* Temperatures change slowly: of all reasons only an intruder makes their flags unknown. */
    const int intruder = train->integrity_reason == REASON_INTRUDER;
    for (int k = 0; k < n; k++) {
        const struct flag_inputs *in = &inputs[k];
        struct drive_evidence *out = &evidence[k];
        adhesion_evidence(rules, train, in, out);
        out->severe_loss = in->severe_loss;
        out->of[FLAG_THERMAL] = intruder ? FLAG_UNKNOWN : in->thermal;
        out->of[FLAG_COMM] = in->comm;
        out->of[FLAG_ESTIMATOR] = FLAG_UNKNOWN;
        if (in->health == HEALTH_TRACKING)
            out->of[FLAG_ESTIMATOR] = FLAG_GOOD;
        if (in->health == HEALTH_DIVERGED)
            out->of[FLAG_ESTIMATOR] = FLAG_BAD;
        out->of[FLAG_SENSOR] = in->current_sum_fault ? FLAG_BAD : in->sensor;
    }
}

/* ---- Debounce and latch ---- */

/* Next state of a flag, by its state and the evidence, and how long that evidence must have held.
 * Unknown never clears bad. Good needs good evidence that has held; a single unknown revokes it. */
enum hold { AT_ONCE, GOOD_NS, RAISE_NS, CLEAR_NS };
static const struct transition {
    uint8_t next; /* enum flag_state */
    uint8_t hold; /* enum hold */
} TRANSITIONS[][3] = {
    [FLAG_UNKNOWN] = {[FLAG_UNKNOWN] = {FLAG_UNKNOWN, AT_ONCE},
                      [FLAG_GOOD] = {FLAG_GOOD, GOOD_NS},
                      [FLAG_BAD] = {FLAG_BAD, RAISE_NS}},
    [FLAG_GOOD] = {[FLAG_UNKNOWN] = {FLAG_UNKNOWN, AT_ONCE},
                   [FLAG_GOOD] = {FLAG_GOOD, AT_ONCE},
                   [FLAG_BAD] = {FLAG_BAD, RAISE_NS}},
    [FLAG_BAD] = {[FLAG_UNKNOWN] = {FLAG_BAD, AT_ONCE},
                  [FLAG_GOOD] = {FLAG_GOOD, CLEAR_NS},
                  [FLAG_BAD] = {FLAG_BAD, AT_ONCE}},
};

static int64_t hold_ns(uint8_t hold, const struct flag_timing *timing)
{
    switch (hold) {
    case GOOD_NS:
        return timing->good_ns;
    case RAISE_NS:
        return timing->raise_ns;
    case CLEAR_NS:
        return timing->clear_ns;
    default:
        return 0;
    }
}

int debounce(struct flag *flag, int evidence, const struct flag_timing *timing, int64_t tick_ns,
             int64_t now_ns)
{
    if (flag->state > FLAG_BAD)
        flag->state = FLAG_UNKNOWN;
    if (evidence == FLAG_UNCHANGED) {
        /* This tick does not count towards a change. */
        if (flag->evidence != flag->state)
            flag->since_ns = (int64_t)((uint64_t)flag->since_ns + (uint64_t)tick_ns);
        return 0;
    }
    const uint8_t seen =
        evidence == FLAG_GOOD || evidence == FLAG_BAD ? (uint8_t)evidence : FLAG_UNKNOWN;
    if (seen != flag->evidence) {
        flag->evidence = seen;
        flag->since_ns = now_ns;
    }
    const struct transition *to = &TRANSITIONS[flag->state][seen]; /* both in range: see above */
    if (to->next == flag->state || elapsed(flag->since_ns, now_ns) < hold_ns(to->hold, timing))
        return 0;
    flag->state = to->next;
    return 1;
}

int debounce_flags(const struct flag_rules *rules, const struct drive_evidence *evidence, int n,
                   int64_t now_ns, struct drive_status *status)
{
    int changed = 0;
    for (int k = 0; k < n; k++) {
        for (int f = 0; f < FLAG_KINDS; f++) {
            const int severe = f == FLAG_ADHESION && evidence[k].severe_loss;
            const struct flag_timing *timing = severe ? &rules->severe : &rules->timing[f];
            changed |=
                debounce(&status[k].flag[f], evidence[k].of[f], timing, rules->tick_ns, now_ns);
        }
    }
    return changed;
}

/* ---- What is published ---- */

/* Publish the numbers of the filter, but only while it tracks or predicts. */
static void publish_motion(const struct flag_inputs *in, struct drive_status *out)
{
    const int followed = in->health == HEALTH_TRACKING || in->health == HEALTH_PREDICTING;
    const int known = followed && !isnan(in->speed_rad_s);
    out->health = in->health;
    out->speed_rad_s = known ? in->speed_rad_s : NAN;
    out->load_nm = known ? in->load_nm : NAN;
    out->load_sigma_nm = known ? in->load_sigma_nm : NAN;
    out->nis = known ? in->nis : NAN;
    out->loss_probability = in->loss_known ? in->loss_probability : NAN;
}

static void publish_thermal(const struct flag_inputs *in, struct drive_status *out)
{
    out->mixed_c = in->mixed_c;
    out->maisd_k = in->maisd_k;
    out->rate_k_h = in->rate_k_h;
    out->jumps = in->jumps;
}

/* A fault is published with its flag: none is while the thermal flag is still good. */
static void publish_faults(const struct flag_inputs *in, const struct drive_evidence *evidence,
                           struct drive_status *out)
{
    const int of_current = in->current_sum_fault && in->sensor != FLAG_BAD;
    const int thermal = out->flag[FLAG_THERMAL].state;
    out->fault_sensor = of_current ? FAULT_ON_CURRENT : in->fault_sensor;
    if (thermal != FLAG_GOOD || evidence->of[FLAG_THERMAL] == FLAG_GOOD)
        out->fault_class = of_current ? FAULT_SENSOR_BIAS : in->fault_class;
}

static void publish_reasons(const struct train_inputs *train, const struct flag_inputs *in,
                            const struct drive_evidence *evidence, struct drive_status *out)
{
    uint8_t thermal = in->thermal_reason;
    if (train->integrity_reason == REASON_INTRUDER)
        thermal = REASON_INTRUDER;
    if (thermal == REASON_NONE)
        thermal = REASON_STARTING;
    const int adhesion_unknown = out->flag[FLAG_ADHESION].state == FLAG_UNKNOWN;
    const int thermal_unknown = out->flag[FLAG_THERMAL].state == FLAG_UNKNOWN;
    out->adhesion_reason = adhesion_unknown ? evidence->adhesion_reason : REASON_NONE;
    out->thermal_reason = thermal_unknown ? thermal : REASON_NONE;
}

static void publish_ages(const struct flag_inputs *in, int64_t now_ns, struct drive_status *out)
{
    out->age_ns = in->sample_ns < 0 ? NO_TIME : elapsed(in->sample_ns, now_ns);
    const int none = in->temperature_ns == NO_TIME;
    out->temperature_age_ns = none ? NO_TIME : elapsed(in->temperature_ns, now_ns);
}

static uint8_t gateway_state(const struct train_inputs *train, const struct drive_status *status,
                             int n)
{
    if (train->silent)
        return GATEWAY_SILENT;
    int idle = 1, known = 1;
    for (int k = 0; k < n; k++) {
        idle = idle && status[k].health <= HEALTH_CONVERGING;
        known = known && status[k].flag[FLAG_ADHESION].state != FLAG_UNKNOWN;
    }
    if (known && !train->overrun)
        return GATEWAY_RUNNING;
    return idle ? GATEWAY_STARTING : GATEWAY_DEGRADED;
}

/* The worst flag and reason, or the largest age, of all drives. */
static void summarise(const struct drive_status *status, int n, struct train_status *whole)
{
    whole->adhesion_reason = whole->faults_reason = REASON_NONE;
    whole->sensor = whole->comm = whole->estimator = FLAG_GOOD;
    whole->age_ns = whole->temperature_age_ns = INT64_MIN + 1; /* less than any age */
    for (int k = 0; k < n; k++) {
        const struct drive_status *one = &status[k];
        whole->adhesion_reason = worse_reason(whole->adhesion_reason, one->adhesion_reason);
        whole->faults_reason = worse_reason(whole->faults_reason, one->thermal_reason);
        whole->sensor = worse_flag(whole->sensor, one->flag[FLAG_SENSOR].state);
        whole->comm = worse_flag(whole->comm, one->flag[FLAG_COMM].state);
        whole->estimator = worse_flag(whole->estimator, one->flag[FLAG_ESTIMATOR].state);
        whole->age_ns = older(whole->age_ns, one->age_ns);
        whole->temperature_age_ns = older(whole->temperature_age_ns, one->temperature_age_ns);
    }
}

void publish(const struct train_inputs *train, const struct flag_inputs *inputs,
             const struct drive_evidence *evidence, int n, int64_t now_ns,
             struct drive_status *status, struct train_status *whole)
{
    for (int k = 0; k < n; k++) {
        publish_motion(&inputs[k], &status[k]);
        publish_thermal(&inputs[k], &status[k]);
        publish_faults(&inputs[k], &evidence[k], &status[k]);
        publish_reasons(train, &inputs[k], &evidence[k], &status[k]);
        publish_ages(&inputs[k], now_ns, &status[k]);
    }
    summarise(status, n, whole);
    whole->overrun = train->overrun ? FLAG_BAD : FLAG_GOOD;
    whole->state = gateway_state(train, status, n);
    whole->common_mode = train->common_mode;
    if (train->common_mode == FLAG_GOOD && train->integrity_reason != REASON_NONE)
        whole->common_mode = FLAG_UNKNOWN;
}
