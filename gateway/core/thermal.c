/* Temperatures of the motors in each tick: readings, seconds, window averages, and evidence.
 *
 * Nothing here can fail: drives, channels and columns come from constant tables, divisors are
 * a count above 0 or the cycle of the readings, which is above 0, and time only advances. */
#include "gateway/core/thermal.h"

#include <math.h>

#include "dbc/rounding.h"
#include "estimators/thermal/monitor.h"
#include "estimators/thermal/trend.h"
#include "gateway/core/inputs.h"
#include "gateway/core/temperature.h"
#include "gateway/core/temperature_window.h"
#include "gateway/core/thermal_evidence.h"

enum { P = THERMAL_POINTS };
enum { AMBIENT_POINT = P }; /* gateway/core/channel.py: the sensors' columns, then this one */

static const double MOST_TENTHS = 1e15; /* a larger value, tenths of a degree, is not converted */

/* ---- readings */

static int is_usable(const struct channel *channel, const double *value)
{
    const int32_t quality = channel->quality;
    return quality < 0 || value[quality] == 1.0 || value[quality] == 2.0; /* Valid, Degraded */
}

/* A value in tenths of a degree, as received; -1 if it is too large. */
static int64_t tenths_of(double value_c)
{
    const double tenths = value_c * 10.0;
    return fabs(tenths) < MOST_TENTHS ? round_half_even(tenths) : -1;
}

double reading_c(const struct receiver *receiver, int64_t row, int point)
{
    const struct channel *channel = &receiver->channels[receiver->channel[row]];
    const int64_t first = row * receiver->codec->width;
    const double *value = receiver->value + first;
    const int32_t column = channel->columns[point];
    const int valid = receiver->validity[first + column] == SIGNAL_VALID;
    return valid && is_usable(channel, value) ? value[column] : NAN;
}

/* Receive one decoded row of temperatures. Each point by itself: a dead sensor stops no other. */
static void receive_reading(struct temperature_monitor *all, const struct receiver *receiver,
                            int64_t row)
{
    const int32_t j = receiver->channels[receiver->channel[row]].drive;
    const int64_t t_ns = receiver->t_ns[row];
    struct temperature_drive *drive = &all->sensors[j];
    temperature_add_reading(drive, t_ns);
    for (int k = 0; k < P; k++) {
        const double value_c = reading_c(receiver, row, k);
        if (!isnan(value_c) && drive->sensor[k].configured)
            temperature_add_value(drive, k, t_ns, value_c, tenths_of(value_c));
    }
    all->motors[j].ambient_c = reading_c(receiver, row, AMBIENT_POINT);
}

int receive_temperatures(struct temperature_monitor *all, const struct receiver *receiver)
{
    for (int64_t k = 0; k < receiver->tick.temperatures; k++)
        receive_reading(all, receiver, receiver->temperature_rows[k]);
    return receiver->tick.temperatures > 0;
}

/* ---- seconds */

static void add_quantity(struct motor_temperatures *motor, int quantity, double value)
{
    motor->total[quantity] += value;
    motor->number[quantity] += 1.0;
}

/* 1 if the newest frame of a channel is fresh, even if its first signal alone has no value. */
static int is_frame_fresh(const struct channel *channel, int64_t now_ns)
{
    const uint8_t reason = channel->reason;
    const int first_missing = (reason == REASON_NOT_AVAILABLE || reason == REASON_RANGE) &&
                              channel->good_ns == channel->accepted_ns;
    const int usable = channel->good_ns >= 0 && (reason == REASON_NONE || first_missing);
    return usable && now_ns - channel->good_ns <= channel->limit_ns;
}

/* Add current and speed of drive j, if they are known and fresh. */
static void add_load(struct motor_temperatures *motor, const struct receiver *receiver, int j,
                     int64_t now_ns)
{
    const struct drive_input *in = &receiver->drives[j];
    if (!isnan(in->irms) && motor->status >= 0 &&
        is_frame_fresh(&receiver->channels[motor->status], now_ns))
        add_quantity(motor, THERMAL_CURRENT_SQUARE, 2.0 * (in->irms * in->irms)); /* amplitude */
    if (!isnan(in->speed) && motor->motion >= 0 &&
        is_channel_fresh(&receiver->channels[motor->motion], now_ns))
        add_quantity(motor, THERMAL_SPEED, fabs(in->speed));
}

/* Form the means of a second that is complete; the next one starts. */
static void close_second(struct motor_temperatures *motor)
{
    for (int k = 0; k < THERMAL_QUANTITIES; k++) {
        const double number = motor->number[k];
        motor->mean[k] = number > 0.0 ? motor->total[k] / number : NAN;
        motor->total[k] = motor->number[k] = 0.0;
    }
}

/* Add one temperature cycle to the second: 1 if it was the last one, and the means are formed. */
static int add_cycle(struct temperature_monitor *all, const struct receiver *receiver,
                     int64_t now_ns)
{
    for (int j = 0; j < all->drive_count; j++) {
        struct motor_temperatures *motor = &all->motors[j];
        int any_valid = 0;
        for (int k = 0; k < P; k++) {
            if (all->window.valid[j * P + k]) {
                any_valid = 1;
                add_quantity(motor, k, all->window.value[j * P + k]);
            }
        }
        if (receiver)
            add_load(motor, receiver, j, now_ns);
        if (any_valid && isfinite(motor->ambient_c))
            add_quantity(motor, THERMAL_AMBIENT, motor->ambient_c);
    }
    all->cycle += 1;
    if (all->cycle < all->cycles_per_second)
        return 0;
    all->cycle = 0;
    for (int j = 0; j < all->drive_count; j++)
        close_second(&all->motors[j]);
    return 1;
}

/* ---- one tick */

/* 1 if a temperature cycle is due; then sets the time of the next one. */
static int cycle_due(struct temperature_monitor *all, int64_t now_ns)
{
    const int64_t due = all->next_ns;
    if (due == NO_TIME || now_ns < due)
        return 0;
    all->next_ns = due + all->period_ns * (1 + (now_ns - due) / all->period_ns);
    return 1;
}

/* A step may come from the sensor or from heat: until that is known, after STEP_READINGS
 * (temperature.c), the averages omit it. One reading of -100 K would make all others hot. */
static void hold_back_steps(struct temperature_monitor *all)
{
    for (int j = 0; j < all->drive_count; j++)
        for (int k = 0; k < P; k++)
            if (all->sensors[j].sensor[k].step_count > 0)
                all->window.value[j * P + k] = NAN;
}

/* A sensor that had crept away and steps back has no offset. The model itself never sees that step:
 * a sensor with an offset has no valid value. */
static void forget_returns(struct temperature_monitor *all)
{
    for (int j = 0; j < all->drive_count; j++) {
        for (int k = 0; k < P; k++) {
            const double step_k = all->sensors[j].sensor[k].bias_k;
            if (step_k != 0.0 && thermal_sensor_returns(&all->model->motors[j], k, step_k))
                temperature_forget_offset(&all->sensors[j], k);
        }
    }
}

static void advance_cycle(struct temperature_monitor *all, const struct receiver *receiver,
                          int64_t now_ns)
{
    for (int j = 0; j < all->drive_count; j++)
        all->motors[j].valid_until_ns = NO_TIME;
    if (all->model)
        forget_returns(all);
    temperature_values(all->sensors, all->drive_count, now_ns, all->window.value,
                       all->window.valid);
    all->second_complete = (uint8_t)add_cycle(all, receiver, now_ns);
    if (all->second_complete)
        add_thermal_second(all);
    note_near(all);
    hold_back_steps(all);
    advance_window(all);
    all->cycles += 1;
}

void advance_temperatures(struct temperature_monitor *all, const struct receiver *receiver,
                          int received, int64_t now_ns)
{
    if (received) {
        all->dirty = 1;
        if (all->next_ns == NO_TIME)
            all->next_ns = now_ns;
    }
    if (cycle_due(all, now_ns)) {
        all->dirty = 1;
        advance_cycle(all, receiver, now_ns);
    }
    if (all->model)
        thermal_monitor_judge(all->model, 1);
}

/* ---- evidence */

static void fill_evidence(const struct thermal_evidence *evidence, struct flag_inputs *out)
{
    out->thermal = evidence->thermal;
    out->sensor = evidence->sensor;
    out->thermal_reason = evidence->reason;
    out->fault_class = evidence->fault_class;
    out->fault_sensor = evidence->fault_sensor;
    out->mixed_c = evidence->mixed_c;
    out->maisd_k = evidence->maisd_k;
    out->rate_k_h = evidence->rate_k_h;
    out->jumps = evidence->jumps;
}

int64_t report_motor(struct temperature_monitor *all, int j, int64_t now_ns,
                     struct flag_inputs *out)
{
    struct motor_temperatures *motor = &all->motors[j];
    const int64_t received_ns = all->sensors[j].received_ns;
    out->temperature_ns = received_ns;
    motor->fresh = received_ns != NO_TIME && now_ns - received_ns <= motor->age_limit_ns;
    if (!motor->fresh) {
        const struct thermal_evidence none =
            no_evidence(received_ns == NO_TIME ? REASON_STARTING : REASON_STALE);
        fill_evidence(&none, out);
        return INT64_MAX;
    }
    if (now_ns >= motor->valid_until_ns) {
        judge_temperatures(all, j, now_ns, &motor->evidence);
        /* Nothing here changes faster than the temperatures are received. */
        motor->valid_until_ns = now_ns + all->period_ns;
    }
    fill_evidence(&motor->evidence, out);
    const int64_t stale_ns = received_ns + motor->age_limit_ns + 1;
    return motor->valid_until_ns < stale_ns ? motor->valid_until_ns : stale_ns;
}

void report_temperatures(struct temperature_monitor *all, int64_t now_ns, struct flag_inputs *out)
{
    if (!all->dirty && now_ns < all->next_report_ns)
        return;
    all->dirty = 0;
    all->next_report_ns = INT64_MAX;
    for (int j = 0; j < all->drive_count; j++) {
        const int64_t until_ns = report_motor(all, j, now_ns, &out[j]);
        if (until_ns < all->next_report_ns)
            all->next_report_ns = until_ns;
    }
}

void monitor_temperatures(struct temperature_monitor *all, const struct receiver *receiver,
                          int64_t now_ns, struct flag_inputs *out)
{
    const int received = receive_temperatures(all, receiver);
    advance_temperatures(all, receiver, received, now_ns);
    report_temperatures(all, now_ns, out);
}

void temperatures_reset(struct temperature_monitor *all)
{
    all->next_ns = NO_TIME;
    all->next_report_ns = all->cycles = 0;
    all->cycle = 0;
    all->second_complete = 0;
    all->dirty = 1;
    for (int j = 0; j < all->drive_count; j++) {
        struct motor_temperatures *motor = &all->motors[j];
        all->currents[j] = (struct motor_current){0};
        *motor = (struct motor_temperatures){
            .age_limit_ns = motor->age_limit_ns,
            .status = motor->status,
            .motion = motor->motion,
            .ambient_c = NAN,
            .evidence = no_evidence(REASON_STARTING),
            .valid_until_ns = NO_TIME,
        };
        for (int k = 0; k < THERMAL_QUANTITIES; k++)
            motor->mean[k] = NAN;
        trend_reset(&motor->trend);
    }
}
