/* Evidence from one motor's temperatures: of its sensors (temperature.c), and by its thermal model
 * (estimators/thermal/monitor.c) or by comparison with the others (estimators/maisd.c).
 *
 * Nothing here can fail: divisors are counts above 0, kinds of faults are below
 * THERMAL_KINDS, and a comparison with NaN is false, which raises nothing. */
#include "gateway/core/thermal_evidence.h"

#include <math.h>

#include "estimators/thermal/cut_out.h"
#include "estimators/thermal/hypotheses.h"
#include "estimators/thermal/monitor.h"
#include "estimators/thermal/trend.h"
#include "gateway/core/temperature.h"

enum { P = THERMAL_POINTS };

static const double LIKELY = 0.5;  /* probability of a fault from which a motor is not good */
static const double BLIND_S = 5.0; /* s without current, speed or ambient: the motor is unknown */

/* Fault class of each heat fault, in the order of estimators/thermal/hypotheses.py. */
static const uint8_t HEAT_CLASS[IMM_HEATS] = {FAULT_OVERHEATING, FAULT_COOLING_LOSS, FAULT_BEARING,
                                              FAULT_BEARING, FAULT_WINDING_RESISTANCE};

struct thermal_evidence no_evidence(uint8_t reason)
{
    return (struct thermal_evidence){
        .mixed_c = NAN, .maisd_k = NAN, .rate_k_h = NAN, .reason = reason};
}

/* ---- by the thermal model */

/* Count a jump if any sensor of a motor has stepped. */
static void count_jumps(const struct thermal_motor *model, struct motor_temperatures *motor)
{
    int jumped = 0;
    for (int q = 0; q < P; q++) {
        jumped |= motor->step_k[q] != model->step[q].offset_k;
        motor->step_k[q] = model->step[q].offset_k;
    }
    motor->jumps += jumped;
}

/* Mean deviation of a motor's block from the other motors; NaN if there is none. The effect of a
 * fault is not degradation. */
static double block_deviation(const struct thermal_motor *model)
{
    double total = 0.0;
    int count = 0;
    for (int q = 0; q < P; q++) {
        const double beside = model->off_k[q] + model->base_k[q];
        if (isfinite(beside)) {
            total += beside;
            count++;
        }
    }
    return count == 0 || model->held ? NAN : total / count;
}

void add_thermal_second(struct temperature_monitor *all)
{
    struct thermal_monitor *model = all->model;
    for (int j = 0; j < all->drive_count; j++) {
        const double *mean = all->motors[j].mean;
        for (int q = 0; q < P; q++)
            all->reading[j * P + q] = mean[q];
        all->input[j] = (struct thermal_input){.current_square = mean[THERMAL_CURRENT_SQUARE],
                                               .speed = mean[THERMAL_SPEED],
                                               .ambient = mean[THERMAL_AMBIENT]};
    }
    if (!model) {
        find_cut_out(&all->cut_out, all->input, all->drive_count, all->currents);
        return;
    }
    thermal_monitor_add_sample(model, all->reading, all->input);
    const double block_h = model->config->block * model->config->dt_s / 3600.0;
    for (int j = 0; j < all->drive_count; j++) {
        count_jumps(&model->motors[j], &all->motors[j]);
        if (model->position == 0) /* a block is complete */
            trend_add(&all->motors[j].trend, block_deviation(&model->motors[j]), block_h);
    }
}

/* 1 if a block of the motor could be compared with others. */
static int is_compared(const struct thermal_motor *model)
{
    return isfinite(model->off_k[0]) || isfinite(model->off_k[1]) || isfinite(model->off_k[2]);
}

/* 1 if a fault is reported, or a sensor has stepped. */
static int has_finding(const struct thermal_motor *model)
{
    int found = model->held != 0;
    for (int q = 0; q < P; q++)
        found |= model->step[q].offset_k != 0.0;
    return found;
}

/* Kind with the largest probability among kinds `first` to `last` - 1. */
static int likeliest(const double *kind, int first, int last)
{
    int most = first;
    for (int c = first + 1; c < last; c++)
        if (kind[c] > kind[most])
            most = c;
    return most;
}

static void name_heat(const double *kind, struct thermal_evidence *out)
{
    out->thermal = FLAG_BAD;
    out->reason = REASON_NONE;
    out->fault_class = HEAT_CLASS[likeliest(kind, 0, IMM_HEATS)];
}

/* 1 if all sensors that have readings, two at least, have stepped: by something they share. */
static int all_stepped(const struct thermal_motor *model)
{
    int seen = 0, stepped = 0;
    for (int q = 0; q < P; q++) {
        seen += isfinite(model->step[q].level_k) != 0;
        stepped += model->step[q].offset_k != 0.0;
    }
    return seen > 1 && stepped >= seen;
}

/* A loose connector is a sensor that is sometimes off. */
static void name_sensor(const struct thermal_motor *model, const double *kind,
                        struct thermal_evidence *out)
{
    const int c = likeliest(kind, IMM_HEATS, THERMAL_KINDS);
    out->sensor = FLAG_BAD;
    out->reason = REASON_NOT_AVAILABLE;
    out->fault_class = FAULT_SENSOR_BIAS;
    if (!all_stepped(model))
        out->fault_sensor = (uint8_t)(FAULT_ON_STATOR + (c - IMM_HEATS) % P);
}

/* 1 if a motor is hot, whichever of its sensors have stepped: a step is certain, and the filters get
 * the readings without it. So it is no alternative to heat, as another sensor's fault is. */
static int is_hot_beside_steps(const struct thermal_motor *model, double named)
{
    double kind[THERMAL_KINDS], heat = 0.0;
    for (int c = 0; c < THERMAL_KINDS; c++) {
        const int stepped = c >= IMM_HEATS && model->step[(c - IMM_HEATS) % P].offset_k != 0.0;
        kind[c] = stepped ? 0.0 : model->kind[c];
        heat += c < IMM_HEATS ? kind[c] : 0.0;
    }
    return model->held && heat > LIKELY && thermal_side(kind, named) > 0;
}

/* 1 if a sensor of the motor may have stepped just now: what is undecided soon is not. */
static int is_step_tested(const struct thermal_motor *model)
{
    return model->step[0].since >= 0 || model->step[1].since >= 0 || model->step[2].since >= 0;
}

/* Name the fault of a motor that has one, or a hot motor and its sensor that has stepped. */
static void name_finding(const struct thermal_motor *model, double named,
                         struct thermal_evidence *out)
{
    double kind[THERMAL_KINDS];
    thermal_kinds(model, 1, kind);
    const int side = thermal_side(kind, named), hot = is_hot_beside_steps(model, named);
    if (side < 0 || (hot && side == 0))
        name_sensor(model, kind, out);
    if (side > 0 || hot)
        name_heat(kind, out);
    if (side == 0 && !hot) { /* it may be hot, or a sensor off: a fault without a class */
        out->thermal = is_step_tested(model) ? FLAG_UNKNOWN : FLAG_BAD;
        out->sensor = FLAG_UNKNOWN;
        out->reason = REASON_DIVERGED;
    }
}

static void judge_by_model(const struct temperature_monitor *all, int j,
                           struct thermal_evidence *out)
{
    const struct thermal_motor *model = &all->model->motors[j];
    if (model->unknown_s > BLIND_S) {
        out->reason = REASON_STALE;
    } else if (all->model->known[j].unexplained || all->currents[j].cut_out) {
        out->reason = REASON_CONFIG;
    } else if (model->judged == 0) {
        out->reason = REASON_STARTING;
    } else if (!is_compared(model)) {
        out->reason = REASON_TOO_FEW_DRIVES;
    } else if (has_finding(model)) {
        name_finding(model, all->named, out);
    } else if (model->fault_probability > LIKELY) {
        /* A motor that no longer follows its model is not good, even if no cause is certain yet. */
        out->reason = REASON_DIVERGED;
    } else {
        out->thermal = FLAG_GOOD;
        out->reason = REASON_NONE;
        out->fault_class = FAULT_NONE;
    }
}

/* Heat of a motor that has a faulty sensor: its other sensors show it as well. Only a fault counts.
 * With fewer sensors the motor is not known to be good. */
static void judge_beside_fault(const struct temperature_monitor *all, int j,
                               struct thermal_evidence *out)
{
    struct thermal_evidence found = no_evidence(REASON_NONE);
    judge_by_model(all, j, &found);
    if (found.thermal != FLAG_BAD || found.fault_class == FAULT_UNKNOWN)
        return;
    out->thermal = FLAG_BAD;
    out->reason = REASON_NONE;
    out->fault_class = found.fault_class;
}

/* ---- by comparison of the motors */

/* Hot points, one bit each: MAISD shows that the fleet differs, the deviation which motor. */
static unsigned hot_points(const struct temperature_window *window, int j)
{
    unsigned hot = 0;
    for (int k = 0; k < P; k++)
        if (window->deviation[j * P + k] > window->apart_k[k] &&
            window->spread[k] > window->limit_k[k])
            hot |= 1u << k;
    return hot;
}

/* 1 if point k of motor j, and of another motor, have shown two values: a point that has not
 * changed since the start may be no sensor at all, and is reported as stuck later. */
static int has_moved(const struct temperature_monitor *all, int j, int k)
{
    int others = 0;
    for (int i = 0; i < all->drive_count; i++)
        others += i != j && all->window.compared[i * P + k] && all->sensors[i].sensor[k].moved;
    return all->sensors[j].sensor[k].moved && others > 0;
}

/* 1 if a point of motor j started far above the others', and no other point of the motor is hot:
 * heat spreads within a motor, an offset of a sensor does not. */
static int may_be_a_sensor(const struct temperature_monitor *all, int j, unsigned hot)
{
    for (int k = 0; k < P; k++)
        if (hot == 1u << k)
            return !all->sensors[j].sensor[k].near;
    return 0;
}

/* enum reason why motor j cannot be compared with others; REASON_NONE if it can. */
static uint8_t compare_reason(const struct temperature_monitor *all, int j)
{
    uint8_t reason = REASON_NONE;
    if (all->motors[j].left_out)
        return all->currents[j].cut_out ? REASON_CONFIG : REASON_STARTING;
    for (int k = 0; k < P; k++) {
        if (!all->sensors[j].sensor[k].configured)
            continue;
        if (!all->window.known[j * P + k])
            return REASON_STARTING;
        if (!isfinite(all->window.deviation[j * P + k]))
            reason = REASON_TOO_FEW_DRIVES;
    }
    return reason;
}

static void judge_by_maisd(const struct temperature_monitor *all, int j,
                           struct thermal_evidence *out)
{
    out->reason = compare_reason(all, j);
    if (out->reason != REASON_NONE)
        return;
    const unsigned hotter = hot_points(&all->window, j);
    unsigned hot = hotter;
    for (int k = 0; k < P; k++)
        if (!has_moved(all, j, k))
            hot &= ~(1u << k);
    if (hotter && !hot) {
        out->reason = REASON_STARTING;
        return;
    }
    if (may_be_a_sensor(all, j, hot)) {
        out->sensor = FLAG_UNKNOWN;
        out->reason = REASON_DIVERGED;
        return;
    }
    out->thermal = hot ? FLAG_BAD : FLAG_GOOD;
    out->fault_class = FAULT_NONE;
    if (hot)
        out->fault_class = FAULT_BEARING;
    if (hot & 1u) /* the winding, alone or with the ends */
        out->fault_class = hot > 1u ? FAULT_COOLING_LOSS : FAULT_OVERHEATING;
}

/* ---- all together */

/* Mean of the known window averages of motor j, degC. */
static double mixed_temperature(const struct temperature_window *window, int j)
{
    double total = 0.0;
    int count = 0;
    for (int k = j * P; k < (j + 1) * P; k++) {
        if (window->known[k]) {
            total += window->mean[k];
            count++;
        }
    }
    return count > 0 ? total / count : NAN;
}

/* The largest MAISD, K; NaN where there is none. */
static double largest_spread(const double *spread)
{
    double found = NAN;
    for (int k = 0; k < P; k++)
        if (isfinite(spread[k]) && !(found >= spread[k]))
            found = spread[k];
    return found;
}

void judge_temperatures(const struct temperature_monitor *all, int j, int64_t now_ns,
                        struct thermal_evidence *out)
{
    const struct temperature_drive *sensors = &all->sensors[j];
    const struct motor_temperatures *motor = &all->motors[j];
    *out = no_evidence(REASON_STARTING);
    out->mixed_c = mixed_temperature(&all->window, j);
    out->maisd_k = largest_spread(all->window.spread);
    out->rate_k_h = trend_rate_k_h(&motor->trend);
    out->jumps = motor->jumps;
    const int fault = temperature_fault(sensors, now_ns);
    if (fault != FAULT_NONE) {
        out->sensor = FLAG_BAD;
        out->reason = REASON_NOT_AVAILABLE;
        out->fault_class = (uint8_t)fault;
        out->fault_sensor = (uint8_t)temperature_fault_sensor(sensors, now_ns);
        if (all->method == THERMAL_MODEL)
            judge_beside_fault(all, j, out);
        return;
    }
    out->sensor = temperature_not_yet_valid(sensors) ? FLAG_UNKNOWN : FLAG_GOOD;
    if (all->method == THERMAL_MODEL)
        judge_by_model(all, j, out);
    else if (all->method == THERMAL_MAISD)
        judge_by_maisd(all, j, out);
    else
        out->reason = REASON_CONFIG;
}
