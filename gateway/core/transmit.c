/* Status to frames: frames that are due, encoded, counted and protected.
 *
 * Nothing here can fail: a cycle time that is a divisor is at least 1 ns, indices of drives,
 * columns and messages come from constant tables, and a number that is not known is NaN, which the
 * encoder sends as the signal's not-available code. Times wrap if a record holds nonsense. */
#include "gateway/core/transmit.h"

#include <math.h>

#include "dbc/e2e.h"
#include "dbc/encode.h"
#include "gateway/core/busload.h"

#define RPM   (60.0 / (2.0 * 3.141592653589793)) /* revolutions per minute in 1 rad/s */
#define MS_NS 1000000

/* Largest numbers that are sent: one step below the signal's not-available code. */
#define MOST_NIS            25.4
#define MOST_JUMPS          14
#define MOST_AGE_MS         254
#define MOST_TEMPERATURE_MS 2540

enum { NOT_SENT = 255 }; /* not an enum flag_state */

/* ---- values of signals */

static double at_most(double x, double most)
{
    return x > most ? most : x;
}

/* Quality of creep and utilisation: initialising while the filter converges; valid if both are
 * known from fresh samples; NaN if neither is known. */
static double quality_of(const struct drive_status *drive)
{
    const int known = !isnan(drive->creep) + !isnan(drive->utilisation);
    if (known == 2 && drive->health == HEALTH_TRACKING)
        return QUALITY_VALID;
    if (known > 0)
        return QUALITY_DEGRADED;
    return drive->health == HEALTH_CONVERGING ? (double)QUALITY_INITIALISING : NAN;
}

/* Value of a signal of a drive. */
static double drive_value(uint8_t source, const struct drive_status *drive)
{
    switch (source) {
    case TX_ADHESION:
        return drive->flag[FLAG_ADHESION].state;
    case TX_THERMAL:
        return drive->flag[FLAG_THERMAL].state;
    case TX_HEALTH:
        return drive->health;
    case TX_SPEED:
        return drive->speed_rad_s * RPM;
    case TX_LOAD:
        return drive->load_nm;
    case TX_LOSS_PROBABILITY:
        return 100.0 * drive->loss_probability;
    case TX_NIS:
        return at_most(drive->nis, MOST_NIS);
    case TX_FAULT_CLASS:
        return drive->fault_class;
    case TX_FAULT_SENSOR:
        return drive->fault_sensor;
    case TX_MIXED:
        return drive->mixed_c;
    case TX_MAISD:
        return drive->maisd_k;
    case TX_RATE:
        return drive->rate_k_h;
    case TX_JUMPS: /* known if the rate is known */
        return isnan(drive->rate_k_h) ? NAN : at_most((double)drive->jumps, MOST_JUMPS);
    case TX_QUALITY:
        return quality_of(drive);
    case TX_CREEP:
        return 100.0 * drive->creep;
    case TX_CREEP_SIGMA:
        return 100.0 * drive->creep_sigma;
    case TX_UTILISATION:
        return 100.0 * drive->utilisation;
    case TX_UTILISATION_SIGMA:
        return 100.0 * drive->utilisation_sigma;
    default:
        return NAN;
    }
}

/* An age in ms, in whole steps. */
static double age_ms(int64_t age_ns, int64_t step_ms, int64_t most_ms)
{
    if (age_ns == NO_TIME)
        return NAN;
    const int64_t step_ns = step_ms * MS_NS;
    int64_t steps = age_ns / step_ns;
    if (age_ns % step_ns < 0) /* a stamp from the future: round down as well */
        steps--;
    const int64_t age = step_ms * steps;
    return (double)(age < most_ms ? age : most_ms);
}

/* Value of a signal of the train. */
static double train_value(uint8_t source, const struct train_status *train)
{
    switch (source) {
    case TX_ADHESION_REASON:
        return train->adhesion_reason;
    case TX_FAULTS_REASON:
        return train->faults_reason;
    case TX_SENSOR:
        return train->sensor;
    case TX_COMM:
        return train->comm;
    case TX_ESTIMATOR:
        return train->estimator;
    case TX_OVERRUN:
        return train->overrun;
    case TX_STATE:
        return train->state;
    case TX_DETECTOR:
        return train->detector;
    case TX_COMMON_MODE:
        return train->common_mode;
    case TX_AGE:
        return age_ms(train->age_ns, 1, MOST_AGE_MS);
    default: /* TX_TEMPERATURE_AGE */
        return age_ms(train->temperature_age_ns, 10, MOST_TEMPERATURE_MS);
    }
}

/* Value of a signal that is counted or measured. */
static double counted_value(uint8_t source, const struct gateway_counts *counts)
{
    switch (source) {
    case TX_DEADLINE_MISSES:
        return counts->deadline_misses;
    case TX_REJECTED:
        return counts->rejected;
    case TX_LOST:
        return counts->lost;
    case TX_BUS_LOAD:
        return counts->bus_load_percent;
    case TX_LATENCY:
        return counts->latency_p99_us;
    case TX_LATENESS:
        return counts->lateness_p99_us;
    case TX_CONFIG_HASH:
        return counts->config_hash;
    default:
        return NAN;
    }
}

/* Fill value and given of every signal of a message. */
static void fill_values(const struct transmitter *tx, const struct tx_message *message,
                        const struct drive_status *status, const struct train_status *train)
{
    for (int c = 0; c < message->signal_count; c++) {
        const uint8_t source = message->signals[c].source;
        double value;
        if (source < TX_ADHESION_REASON)
            value = drive_value(source, &status[message->signals[c].drive]);
        else if (source < TX_DEADLINE_MISSES)
            value = train_value(source, train);
        else
            value = counted_value(source, &tx->counts);
        tx->value[c] = value;
        tx->given[c] = source != TX_START_VALUE;
    }
}

/* ---- schedule */

/* Note a state in `sent`; 1 if it has changed. */
static int note_state(uint8_t *sent, uint8_t state)
{
    const int changed = *sent != state;
    *sent = state;
    return changed;
}

/* 1 if a flag that reports faults has changed since the last tick. */
static int faults_changed(struct transmitter *tx, const struct drive_status *status,
                          const struct train_status *train)
{
    int changed = 0;
    for (int k = 0; k < tx->drive_count; k++)
        changed |= note_state(&tx->thermal_sent[k], status[k].flag[FLAG_THERMAL].state);
    changed |= note_state(&tx->summary_sent[0], train->sensor);
    changed |= note_state(&tx->summary_sent[1], train->comm);
    changed |= note_state(&tx->summary_sent[2], train->estimator);
    changed |= note_state(&tx->summary_sent[3], train->overrun);
    return changed;
}

/* 1 if a message is due; then sets the time at which it is due next. */
static int is_due(const struct transmitter *tx, struct tx_message *message, int64_t now_ns)
{
    const uint64_t start = (uint64_t)message->next_ns, cycle = (uint64_t)message->cycle_ns;
    const int64_t late = (int64_t)((uint64_t)now_ns - start);
    /* A message with the cycle of the tick is sent in each tick, however late the first one was. */
    if (late < -tx->slack_ns && message->cycle_ns > tx->tick_ns)
        return 0;
    /* The grid stays, however late a tick is; missed frames are not sent later. */
    const uint64_t behind = late > 0 ? (uint64_t)late / cycle : 0;
    message->next_ns = (int64_t)(start + cycle * (1 + behind));
    return 1;
}

void transmit_restart(struct transmitter *tx, int64_t now_ns)
{
    for (int m = 0; m < tx->message_count; m++)
        tx->messages[m].next_ns = now_ns;
    for (int k = 0; k < tx->drive_count; k++)
        tx->thermal_sent[k] = NOT_SENT;
    for (int k = 0; k < 4; k++)
        tx->summary_sent[k] = NOT_SENT;
}

/* ---- one tick */

void update_counts(struct transmitter *tx, const struct receiver *receiver,
                   const struct integrity *integrity, const struct bus_load *load, int64_t now_ns)
{
    static const uint8_t REJECTED[] = {RX_ERROR,        RX_REPEATED,      RX_WRONG_SEQUENCE,
                                       RX_WRONG_LENGTH, RX_NOT_YET_VALID, RX_NOT_AVAILABLE,
                                       RX_RANGE,        RX_TIME_BACK};
    struct gateway_counts *counts = &tx->counts;
    int64_t rejected = counts->rejected_before;
    for (unsigned k = 0; k < sizeof REJECTED; k++)
        rejected += receiver->counters[REJECTED[k]];
    counts->deadline_misses = (double)integrity->deadline_misses;
    counts->rejected = (double)rejected;
    counts->lost = (double)receiver->counters[RX_LOST];
    counts->bus_load_percent = bus_load_percent(load, now_ns);
}

int transmit(struct transmitter *tx, const struct drive_status *status,
             const struct train_status *train, int64_t now_ns, struct tx_frame *frame)
{
    const int changed = faults_changed(tx, status, train);
    int frames = 0;
    for (int m = 0; m < tx->message_count; m++) {
        struct tx_message *message = &tx->messages[m];
        if (changed && message->on_change)
            message->next_ns = now_ns;
        if (!is_due(tx, message, now_ns))
            continue;
        struct tx_frame *out = &frame[frames++];
        out->t_ns = now_ns;
        out->message = m;
        fill_values(tx, message, status, train);
        encode_frame(tx->codec, m, tx->value, tx->given, out->data);
        e2e_protect(&message->e2e_config, out->data, message->counter++);
    }
    return frames;
}
