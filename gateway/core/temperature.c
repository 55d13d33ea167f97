/* Validity of temperature sensors: lost, stuck or off, alone or with all others of their drive.
 *
 * No motor temperature jumps: a change of more than a step's limit within a reading that persists
 * is due to the sensor. Nothing here depends on what the temperatures mean.
 *
 * Nothing here can fail: a period is above 0, time only advances, so that differences of stamps
 * fit, and the readings between two values are those of FORGET_NS at most. */
#include "gateway/core/temperature.h"

#include <math.h>

#define MS_NS 1000000LL

static const int64_t LOST_NS = 500 * MS_NS; /* without a valid value; real ones can fail briefly */
/* After a longer time without a valid value the motor may have changed by more than a step. */
static const int64_t FORGET_NS = 10000 * MS_NS;
static const int STEP_READINGS = 3; /* consecutive readings beyond the limit that make a step */
/* Share of a step that has to occur between two readings. A change in smaller portions is
 * heat: a small motor's winding may warm by kelvins within a second. */
static const double SUDDEN = 0.4;
static const double QUICKEST_K = 20.0; /* between two readings: no motor is so quick */
static const double MOST_C = 300.0;    /* degC, the signal's maximum: a motor may be hotter */
static const double LEAST_C = -50.0;   /* degC; no train runs in such cold (EN 50125-1: -40) */
/* Limits of a step; a sensor that was further below the maximum has jumped to it. */
static const double MOST_STEPS = 5.0;
static const double BACK = 0.5;         /* share of a step's limit that suffices for a step back */
static const double FOLLOW = 0.2;       /* weight of a new value in averages */
static const int64_t SAME_READINGS = 2; /* faults within so many readings have a common cause */
static const int64_t STALE_CYCLES = 3;  /* a drive that is silent for longer has no stuck sensor */

void temperature_reset(struct temperature_drive *drive)
{
    drive->received_ns = drive->first_ns = NO_TIME;
    drive->readings = 0;
    for (int k = 0; k < THERMAL_POINTS; k++) {
        const struct temperature_sensor *was = &drive->sensor[k];
        drive->sensor[k] = (struct temperature_sensor){
            .limit_k = was->limit_k,
            .stuck_after_ns = was->stuck_after_ns,
            .configured = was->configured,
            .raw = -1,
            .valid_ns = NO_TIME,
        };
    }
}

void temperature_add_reading(struct temperature_drive *drive, int64_t t_ns)
{
    if (drive->received_ns == NO_TIME)
        drive->first_ns = t_ns;
    drive->received_ns = t_ns;
    drive->readings += 1;
}

/* A new value relative to those before it. */
struct change {
    int again;       /* 1: the first value, or the first after a long time */
    double step_k;   /* K, from the level */
    double change_k; /* K, from the last value */
    double readings; /* number of readings since that value, at least 1 */
    double sudden_k; /* K, of the change, relative to the slope as well */
};

static struct change change_of(const struct temperature_drive *drive,
                               const struct temperature_sensor *s, int64_t t_ns, double value_c)
{
    struct change out = {.readings = 1.0};
    out.again = s->valid_ns == NO_TIME || t_ns - s->valid_ns > FORGET_NS;
    /* An offset that was found stays: silence does not clear it. */
    const double level = out.again && s->bias_k == 0.0 ? value_c : s->level_c;
    out.step_k = value_c - level - s->bias_k;
    if (!out.again) {
        const double passed = rint((double)(t_ns - s->valid_ns) / (double)drive->period_ns);
        out.readings = passed > 1.0 ? passed : 1.0;
        out.change_k = value_c - s->value_c;
    }
    const double change = fabs(out.change_k);
    const double beside = fabs(out.change_k - s->slope_k * out.readings);
    out.sudden_k = change < beside ? change : beside;
    return out;
}

/* STEP_READINGS in a row were beyond the limit: a step of the sensor; heat if it is not sudden. */
static void end_step(const struct temperature_drive *drive, struct temperature_sensor *s,
                     double step_k)
{
    if (s->step_k > SUDDEN * fabs(step_k) || s->step_k > QUICKEST_K) {
        s->bias_k += step_k;
        s->step_index = drive->readings;
        if (fabs(s->bias_k) < s->limit_k)
            s->bias_k = 0.0;
    } else {
        s->level_c += step_k;
    }
    s->step_count = 0;
    s->step_k = 0.0;
}

/* No motor is so cold, and one hotter than the signal's maximum would have been seen to warm up: an
 * open or a shorted sensor, from the start. */
static void note_impossible(const struct temperature_drive *drive, struct temperature_sensor *s,
                            int again, double value_c)
{
    const int was = s->impossible;
    s->impossible = value_c < LEAST_C || (value_c >= MOST_C && (again || was));
    if (s->impossible && !was)
        s->step_index = drive->readings;
}

/* 1 if a stuck sensor moves again: what it held is no level from which it steps. */
static int is_released(const struct temperature_sensor *s, int64_t t_ns, int64_t raw)
{
    return s->seen && raw != s->raw && !s->saturated && t_ns - s->changed_ns > s->stuck_after_ns;
}

/* Size beyond which a change counts as a step. A sensor that was just beyond the limit may come
 * back from just within it. */
static double step_limit(const struct temperature_sensor *s, double step_k)
{
    return s->bias_k * step_k < 0.0 ? BACK * s->limit_k : s->limit_k;
}

void temperature_add_value(struct temperature_drive *drive, int k, int64_t t_ns, double value_c,
                           int64_t raw)
{
    struct temperature_sensor *s = &drive->sensor[k];
    if (is_released(s, t_ns, raw))
        s->valid_ns = NO_TIME;
    const struct change now = change_of(drive, s, t_ns, value_c);
    s->moved |= s->seen && raw != s->raw;
    if (raw != s->raw || now.again) {
        s->raw = raw;
        s->changed_ns = t_ns;
    }
    if (now.again && s->bias_k == 0.0) {
        s->level_c = value_c;
        s->near = 0;
    }
    note_impossible(drive, s, now.again, value_c);
    s->saturated = value_c >= MOST_C && !now.again && fabs(now.step_k) < MOST_STEPS * s->limit_k;
    if (fabs(now.step_k) > step_limit(s, now.step_k) && !s->saturated) {
        s->step_count += 1;
        s->step_k = now.sudden_k > s->step_k ? now.sudden_k : s->step_k;
    } else {
        s->step_count = 0;
        s->step_k = 0.0;
        s->level_c += FOLLOW * now.step_k;
    }
    if (s->step_count >= STEP_READINGS)
        end_step(drive, s, now.step_k);
    s->value_c = value_c;
    s->slope_k += FOLLOW * (now.change_k / now.readings - s->slope_k);
    s->seen = 1;
    s->valid_ns = t_ns;
    s->valid_at = drive->readings;
}

void temperature_forget_offset(struct temperature_drive *drive, int k)
{
    struct temperature_sensor *s = &drive->sensor[k];
    s->level_c += s->bias_k;
    s->bias_k = 0.0;
}

int temperature_sensor_fault(const struct temperature_drive *drive, int k, int64_t now_ns)
{
    const struct temperature_sensor *s = &drive->sensor[k];
    if (!s->configured)
        return FAULT_NONE;
    if (drive->received_ns == NO_TIME)
        return FAULT_UNKNOWN;
    const int64_t since = s->valid_ns == NO_TIME ? drive->first_ns : s->valid_ns;
    if (drive->received_ns - since > LOST_NS)
        return FAULT_SENSOR_LOST;
    if (s->valid_ns == NO_TIME)
        return FAULT_UNKNOWN;
    const int stale = now_ns - drive->received_ns > STALE_CYCLES * drive->period_ns;
    if (now_ns - s->changed_ns > s->stuck_after_ns && !s->saturated && !stale)
        return FAULT_SENSOR_STUCK;
    return s->bias_k != 0.0 || s->impossible ? FAULT_SENSOR_BIAS : FAULT_NONE;
}

/* FAULT_SENSOR_BIAS or FAULT_SENSOR_LOST if all sensors of the drive, at least two, have it since
 * the same moment; else FAULT_NONE. */
static int common_fault(const struct temperature_drive *drive, int64_t now_ns)
{
    int count = 0, fault = FAULT_NONE;
    int64_t first = 0, last = 0;
    for (int k = 0; k < THERMAL_POINTS; k++) {
        const struct temperature_sensor *s = &drive->sensor[k];
        if (!s->configured)
            continue;
        const int here = temperature_sensor_fault(drive, k, now_ns);
        const int64_t at = here == FAULT_SENSOR_BIAS ? s->step_index : s->valid_at;
        if (count > 0 && here != fault)
            return FAULT_NONE;
        first = count == 0 || at < first ? at : first;
        last = count == 0 || at > last ? at : last;
        fault = here;
        count += 1;
    }
    const int shared = fault == FAULT_SENSOR_BIAS || fault == FAULT_SENSOR_LOST;
    return count > 1 && shared && last - first <= SAME_READINGS ? fault : FAULT_NONE;
}

/* Index of the first sensor with a fault; THERMAL_POINTS: none has one. */
static int first_faulty(const struct temperature_drive *drive, int64_t now_ns)
{
    int k = 0;
    while (k < THERMAL_POINTS && temperature_sensor_fault(drive, k, now_ns) < FAULT_SENSOR_BIAS)
        k++;
    return k;
}

int temperature_fault(const struct temperature_drive *drive, int64_t now_ns)
{
    const int k = first_faulty(drive, now_ns);
    return k < THERMAL_POINTS ? temperature_sensor_fault(drive, k, now_ns) : FAULT_NONE;
}

int temperature_fault_sensor(const struct temperature_drive *drive, int64_t now_ns)
{
    const int k = first_faulty(drive, now_ns);
    const int alone = k < THERMAL_POINTS && common_fault(drive, now_ns) == FAULT_NONE;
    return alone ? FAULT_ON_STATOR + k : FAULT_ON_NONE;
}

int temperature_not_yet_valid(const struct temperature_drive *drive)
{
    for (int k = 0; k < THERMAL_POINTS; k++)
        if (drive->sensor[k].configured && drive->sensor[k].valid_ns == NO_TIME)
            return 1;
    return 0;
}

void temperature_values(const struct temperature_drive *drive, int drives, int64_t now_ns,
                        double *values_c, uint8_t *valid)
{
    for (int j = 0; j < drives; j++) {
        for (int k = 0; k < THERMAL_POINTS; k++) {
            const struct temperature_sensor *s = &drive[j].sensor[k];
            const int fault = temperature_sensor_fault(&drive[j], k, now_ns);
            values_c[j * THERMAL_POINTS + k] = s->value_c;
            valid[j * THERMAL_POINTS + k] = s->seen && fault == FAULT_NONE;
        }
    }
}

int64_t temperature_received_ns(const struct temperature_drive *drive)
{
    return drive->received_ns;
}
