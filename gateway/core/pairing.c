/* Halves of samples combined to samples, SI units, stationary frame.
 *
 * Currents and voltages with the same counter, received within half a turn of it, belong together.
 * The time between two samples is the counter difference times the period; stamps determine the
 * turn of the counter, and whether the sender has left samples out (gateway/core/sample_clock.c).
 *
 * No function here can fail: counters are masked or compared with their number of values, a period
 * is at least 1 ns (gateway/core/channel.py), and every quotient is bounded before it is converted. */
#include "gateway/core/pairing.h"

#include "dbc/rounding.h"
#include "gateway/core/sample_clock.h"

enum { BLOCK_SAMPLES = 8, BLOCK_COUNTERS = 8192 };
#define SUM_SMOOTHING 0.05
#define SQRT3         1.7320508075688772

/* Results of `missing_cycles` that are not a number of cycles. */
enum { TOO_LATE = -1, START_ANEW = -2 };

/* Number of cycles missing before a sample with this counter; values: of the counter. */
static int64_t missing_cycles(const struct receiver *receiver, const struct drive_input *drive,
                              int64_t counter, int64_t values, int64_t t_ns, int64_t period_ns)
{
    const int64_t passed = t_ns - drive->sample_ns;
    if (drive->sample_ns < 0 || passed > receiver->max_gap_ns)
        return START_ANEW;
    const int64_t delta = (counter - drive->sample_counter + values) % values;
    const double turns = ((double)passed / (double)period_ns - (double)delta) / (double)values;
    if (turns < -1.0) /* a whole turn of the counter too late; this also bounds the product */
        return TOO_LATE;
    const int64_t cycles = delta + values * round_half_even(turns);
    return cycles > 0 ? cycles - 1 : TOO_LATE;
}

/* Note stamp, counter and voltage of a new sample. Returns missing cycles before it, or TOO_LATE. */
static int64_t next_sample(struct receiver *receiver, const struct channel *channel,
                           int64_t counter, int64_t values, int64_t t_ns, const double *u)
{
    struct drive_input *drive = &receiver->drives[channel->drive];
    const int64_t period_ns = channel->period_ns, passed_ns = t_ns - drive->sample_ns;
    int64_t missing = missing_cycles(receiver, drive, counter, values, t_ns, period_ns);
    if (missing == TOO_LATE) {
        receiver->late++;
        return TOO_LATE;
    }
    if (missing == START_ANEW) {
        drive->restart = 1;
        receiver->tick.restarts++;
        start_sample_clock(&drive->clock, u, period_ns);
        missing = 0;
    } else {
        const int64_t left_out = step_sample_clock(&drive->clock, u, passed_ns, missing + 1,
                                                   period_ns, receiver->max_gap_ns);
        receiver->left_out += left_out;
        missing += left_out;
    }
    drive->sample_counter = counter;
    drive->sample_ns = t_ns;
    return missing;
}

static void append_sample(struct receiver *receiver, int32_t drive, const double *u,
                          const double *y, int64_t steps, int64_t gap)
{
    const int64_t m = receiver->tick.samples++;
    receiver->sample_drive[m] = drive;
    receiver->sample_steps[m] = steps;
    receiver->sample_gap[m] = gap;
    receiver->sample_before[m] = receiver->drives[drive].newest_sample;
    receiver->drives[drive].newest_sample = m;
    for (int k = 0; k < 2; k++) {
        receiver->sample_u[2 * m + k] = u[k];
        receiver->sample_y[2 * m + k] = y[k];
    }
}

/* Store one half under its counter: of three phase currents, their alpha and beta. */
static void keep_half(struct drive_input *drive, const struct channel *channel, const double *value,
                      int64_t t_ns, int64_t counter)
{
    struct half_sample *half = &drive->pending[channel->kind][counter];
    const int32_t *columns = channel->columns;
    const double a = value[columns[0]], b = value[columns[1]];
    half->t_ns = t_ns;
    half->value[0] = a;
    half->value[1] = b;
    if (channel->kind == KIND_CURRENTS) {
        const double c = value[columns[2]];
        /* The phase currents of a real motor sum to zero; a slow average tolerates noise. */
        drive->current_sum += SUM_SMOOTHING * (fabs(a + b + c) - drive->current_sum);
        half->value[0] = (2.0 * a - b - c) / 3.0;
        half->value[1] = (b - c) / SQRT3;
    }
}

/* Store a row of currents or voltages, and append the sample that it completes. */
static void pair_halves(struct receiver *receiver, const struct channel *channel,
                        const double *value, int64_t t_ns, int64_t counter)
{
    struct drive_input *drive = &receiver->drives[channel->drive];
    keep_half(drive, channel, value, t_ns, counter);
    struct half_sample *mine = &drive->pending[channel->kind][counter];
    struct half_sample *other = &drive->pending[1 - channel->kind][counter];
    if (other->t_ns < 0)
        return;
    const int64_t apart = other->t_ns > t_ns ? other->t_ns - t_ns : t_ns - other->t_ns;
    if (apart > PAIR_COUNTERS / 2 * channel->period_ns) {
        /* The older half belongs to an earlier turn of the counter. */
        struct half_sample *older = other->t_ns < t_ns ? other : mine;
        older->t_ns = -1;
        receiver->unpaired++;
        return;
    }
    const int64_t newer_ns = other->t_ns > t_ns ? other->t_ns : t_ns;
    mine->t_ns = -1;
    other->t_ns = -1;
    const double *u = drive->pending[KIND_VOLTAGES][counter].value;
    const double *y = drive->pending[KIND_CURRENTS][counter].value;
    const int64_t missing = next_sample(receiver, channel, counter, PAIR_COUNTERS, newer_ns, u);
    if (missing != TOO_LATE)
        append_sample(receiver, channel->drive, u, y, channel->steps, missing * channel->steps);
}

/* Append a row of eight samples: index, then Ia, Ib, Ualpha, Ubeta of each. */
static int append_block(struct receiver *receiver, const struct channel *channel,
                        const double *value, int64_t t_ns)
{
    const int32_t *columns = channel->columns;
    const double index = value[columns[0]];
    if (!(index >= 0.0 && index < BLOCK_SAMPLES * BLOCK_COUNTERS)) /* NaN as well */
        return 0;
    const int64_t first = (int64_t)index;
    if (first % BLOCK_SAMPLES != 0)
        return 0;
    const int32_t *last = &columns[1 + 4 * (BLOCK_SAMPLES - 1)];
    const double newest_u[2] = {value[last[2]], value[last[3]]};
    const int64_t missing =
        next_sample(receiver, channel, first / BLOCK_SAMPLES, BLOCK_COUNTERS, t_ns, newest_u);
    if (missing == TOO_LATE)
        return 1;
    for (int k = 0; k < BLOCK_SAMPLES; k++) {
        const int32_t *mine = &columns[1 + 4 * k];
        const double a = value[mine[0]], b = value[mine[1]];
        const double u[2] = {value[mine[2]], value[mine[3]]};
        const double y[2] = {a, (a + 2.0 * b) / SQRT3};
        append_sample(receiver, channel->drive, u, y, 1, k == 0 ? BLOCK_SAMPLES * missing : 0);
    }
    return 1;
}

int pair_samples(struct receiver *receiver, int64_t row)
{
    const struct channel *channel = &receiver->channels[receiver->channel[row]];
    const double *value = receiver->value + row * receiver->codec->width;
    const int64_t t_ns = receiver->t_ns[row];
    if (channel->kind == KIND_BLOCK)
        return append_block(receiver, channel, value, t_ns);
    const uint8_t *payload = receiver->payload + row * PAYLOAD_BYTES;
    pair_halves(receiver, channel, value, t_ns, payload[1] & (PAIR_COUNTERS - 1));
    return 1;
}
