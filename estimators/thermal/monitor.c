/* Detection of thermal faults in operation: compares blocks of residuals and judges each motor.
 *
 * The residuals of a motor's readings from its model (residuals.c) are combined in blocks of
 * seconds (medians, to suppress noise and bursts), less those of the other motors (peers.c), and
 * passed to the filters (imm.c). Bursts of loose connectors are separated before.
 *
 * Longer than other files: all steps of a block, in their order. Nothing can fail: counts that divide
 * are at least 1, probabilities lie between 0 and SUREST, windows within THERMAL_BLOCK_MAX. */
#include "estimators/thermal/monitor.h"

#include <math.h>

#include "estimators/elementary.h"
#include "estimators/numbers.h"
#include "estimators/order_statistics.h"
#include "estimators/thermal/cut_out.h"
#include "estimators/thermal/imm.h"
#include "estimators/thermal/imm_predict.h"
#include "estimators/thermal/model.h"
#include "estimators/thermal/peers.h"
#include "estimators/thermal/residuals.h"

enum { P = THERMAL_POINTS, SENSOR_KINDS = IMM_MODES - 1 };
enum { MOST_AWAY = 1 << 20 }; /* readings, as far as is counted */

static const double MOST_LEARNT_K = 0.9; /* K, largest deviation in a block that is learnt */
static const double RETURNED_K = 2.0; /* K, largest offset of a sensor that crept and came back */
static const double SUREST =
    0.95; /* largest probability of a loose connector, so that a mended one is recognised */
static const double SURE = 1.0 - 1e-6; /* probability that a sensor that has stepped is off */
static const double LEAST = 1e-300;    /* least sum of probabilities that divides */
/* A reported fault ends below the first probability; a reported probability is above one half. */
static const double CLEAR = 0.3, HALF = 0.5;
static const double PARKED_S = 600.0;     /* s without speed and current, longer than a stop */
static const double DRIVEN_RAD_S = 1.0;   /* rad/s, a slower motor does not turn */
static const double MOST_TESTED_S = 60.0; /* s for which others are compared with a last value */
/* Bursts in a row that may be one departure; a sensor that is away for longer has a new level. */
static const double MOST_BURSTS = 4.0;
/* Share of a change of the others' residuals by which a healthy motor may differ from them: what is
 * wrong in all models is not equally wrong in each. */
static const double UNEQUAL = 0.1;

/* Copy the available readings of a block, in order; returns their number. */
static int readings_of(const double *values, int block, double *out)
{
    int n = 0;
    for (int k = 0; k < block; k++)
        if (isfinite(values[k]))
            out[n++] = values[k];
    return n;
}

/* Median of the n readings of a block in values, which are not changed; NaN if there are fewer than
 * half. */
static double block_median(const double *values, int n, int block)
{
    double sorted[THERMAL_BLOCK_MAX];
    if (2 * n < block)
        return NAN;
    for (int k = 0; k < n; k++)
        sorted[k] = values[k];
    return median_in_place(sorted, n);
}

/* Level from which bursts depart, for n readings x of a block: the median of those near the last
 * level, because bursts can fill a short block. A sensor that stays away has a new level. */
static double level_of(const struct thermal_config *config, const double *x, int n, double far,
                       const struct thermal_burst *burst)
{
    double near[THERMAL_BLOCK_MAX];
    int count = 0;
    if (isnan(burst->level_k) || burst->away > MOST_BURSTS * config->burst_length)
        return block_median(x, n, config->block);
    for (int k = 0; k < n; k++)
        if (fabs(x[k] - burst->level_k) <= far)
            near[count++] = x[k];
    return count > 0 ? median_in_place(near, count) : burst->level_k;
}

/* Log odds of a loose connector, from the n readings x of a block.
 *
 * Far readings belong to a burst only once the sensor is back within half of `far`. Those at the
 * end of a block count with the block in which it returns. */
static double loose_log_odds(const struct thermal_config *config, const double *x, int n,
                             double far, struct thermal_burst *burst)
{
    int odd = 0, near = 0;
    if (isnan(burst->level_k)) /* it may have started within a burst */
        burst->away = MOST_AWAY;
    burst->level_k = level_of(config, x, n, far, burst);
    if (n == 0 || isnan(burst->level_k))
        return NAN;
    for (int k = 0; k < n; k++) {
        const double distance = fabs(x[k] - burst->level_k);
        if (distance > (burst->away > 0 ? 0.5 * far : far)) {
            burst->away += burst->away < MOST_AWAY;
            continue;
        }
        odd += burst->away <= MOST_BURSTS * config->burst_length ? burst->away : 0;
        burst->away = 0;
        near++;
    }
    const double by_odd = elementary_log(config->loose_share / config->good_share);
    const double by_near = elementary_log((1.0 - config->loose_share) / (1.0 - config->good_share));
    return (odd * by_odd + near * by_near) / config->burst_length;
}

/* Find medians and bursts of one motor's sensors. */
static void summarise(const struct thermal_config *config, const struct thermal_motor_config *known,
                      struct thermal_motor *motor)
{
    double x[THERMAL_BLOCK_MAX];
    for (int q = 0; q < P; q++) {
        int n = readings_of(motor->block[q], config->block, x);
        motor->middle_k[q] = block_median(x, n, config->block);
        n = readings_of(motor->raw[q], config->block, x);
        const double far = larger(config->far_sigma * known->noise_k[q], config->far_k);
        motor->bursts[q] = loose_log_odds(config, x, n, far, &motor->burst[q]);
    }
}

/* A motor may differ from those that it is compared with by shift K more than before. */
static void widen_seen(struct thermal_motor *motor, int q, double shift)
{
    if (!isfinite(shift))
        return;
    for (int g = 0; g < IMM_MODES; g++)
        motor->imm.cov[g][THERMAL_SEEN[q]][THERMAL_SEEN[q]] += shift * shift;
}

int thermal_sensor_returns(const struct thermal_motor *motor, int q, double step_k)
{
    const int g = 1 + IMM_HEATS + q;
    const double crept_k = motor->imm.mean[g][IMM_STATES - 2];
    return motor->imm.mode[g] > HALF && fabs(step_k + crept_k) < RETURNED_K;
}

/* A sensor that had crept away and steps back has no offset. */
static void forget_return(struct thermal_motor *motor, int q)
{
    if (thermal_sensor_returns(motor, q, motor->step[q].offset_k))
        motor->step[q].offset_k = 0.0;
}

/* Inputs from the middle of the last block to the middle of this one. */
static void read_inputs(struct thermal_motor *motor)
{
    const struct thermal_sums *first = &motor->half[0], *late = &motor->late;
    motor->inputs = (struct thermal_sums){
        .current_square = late->current_square + first->current_square,
        .speed = late->speed + first->speed,
        .cooling = late->cooling + first->cooling,
        .copper = late->copper + first->copper,
        .rise = late->rise + first->rise,
        .count = late->count + first->count,
    };
    motor->late = motor->half[1];
    motor->half[0] = motor->half[1] = (struct thermal_sums){0};
}

/* What the others were compared with in the last block, in the values of this one: a motor that has
 * no reading now, or has started anew, keeps its last value. */
static void compared_before(const struct thermal_motor *motor, double *out)
{
    for (int q = 0; q < P; q++) {
        const double now = motor->middle_k[q] - motor->base_k[q];
        const int goes_on = isfinite(motor->compared_k[q]) && isfinite(now) && motor->judged > 0;
        out[q] = goes_on ? now : motor->compared_k[q];
    }
}

/* What the others are compared with from now on. While a sensor is tested for a step that is its
 * last value: without it the others would seem to change together. */
static void compare_with(double block_s, struct thermal_motor *motor, double *out)
{
    for (int q = 0; q < P; q++) {
        const double now = motor->middle_k[q] - motor->base_k[q];
        motor->absent_s[q] = isfinite(now) ? 0.0 : motor->absent_s[q] + block_s;
        const int tested = motor->step[q].since >= 0 && motor->absent_s[q] <= MOST_TESTED_S;
        if (isfinite(now) || !tested)
            motor->compared_k[q] = now;
        out[q] = motor->compared_k[q];
    }
}

void thermal_close_block(const struct thermal_config *config,
                         const struct thermal_motor_config *known, struct thermal_motor *motor,
                         int motors, double *workspace)
{
    double *before = workspace, *now = before + (int64_t)motors * P;
    double *others = now + (int64_t)motors * P, *sorted = others + (int64_t)motors * P;
    uint8_t *trusted = (uint8_t *)(sorted + motors);
    for (int m = 0; m < motors; m++) {
        summarise(config, &known[m], &motor[m]);
        compared_before(&motor[m], before + (int64_t)m * P);
        compare_with(config->imm.block_s, &motor[m], now + (int64_t)m * P);
        trusted[m] = motor[m].trusted;
    }
    peers_median(before, trusted, motors, sorted, others);
    for (int m = 0; m < motors; m++)
        for (int q = 0; q < P; q++)
            motor[m].off_k[q] = others[m * P + q];
    for (int m = 0; m < motors; m++)
        trusted[m] = motor[m].trusted = !motor[m].held && !known[m].unexplained;
    peers_median(now, trusted, motors, sorted, others);
    for (int m = 0; m < motors; m++) {
        for (int q = 0; q < P; q++) {
            widen_seen(&motor[m], q, others[m * P + q] - motor[m].off_k[q]);
            widen_seen(&motor[m], q, UNEQUAL * (motor[m].off_k[q] - motor[m].peers_k[q]));
            motor[m].peers_k[q] = others[m * P + q];
            motor[m].off_k[q] = motor[m].middle_k[q] - motor[m].base_k[q] - motor[m].peers_k[q];
            forget_return(&motor[m], q);
        }
        read_inputs(&motor[m]);
    }
}

/* ---- Judging ---- */

void thermal_surroundings(const struct thermal_config *config, const struct thermal_parameters *p,
                          const struct thermal_sums *inputs, struct imm_surroundings *out)
{
    const double n = larger(inputs->count, 1.0); /* a block in a short gap has no inputs */
    const double current_square = inputs->current_square / n, speed = inputs->speed / n;
    const double cooling = inputs->cooling / n, copper = inputs->copper / n;
    const double *settles = config->settles_k;
    *out = (struct imm_surroundings){.rise_k = larger(inputs->rise / n, THERMAL_LEAST_RISE_K)};
    thermal_model_system_matrix(p, current_square, speed, &out->rates[0][0]);
    /* Copper, local air, fan, friction of both ends. */
    out->pushes[THERMAL_WINDING][0] = copper;
    out->pushes[THERMAL_FRAME][1] = p->h_0 + p->h_1 * speed;
    out->pushes[THERMAL_DRIVE_END][1] = p->b_d;
    out->pushes[THERMAL_OTHER_END][1] = p->b_n;
    out->pushes[THERMAL_FRAME][2] = cooling;
    out->pushes[THERMAL_DRIVE_END][3] = p->f_d * speed;
    out->pushes[THERMAL_OTHER_END][4] = p->f_n * speed;
    /* Overheating, lost cooling, bearings, winding resistance: 1 K at the mean duty when settled. */
    out->heats[0][THERMAL_WINDING] = 1.0 / settles[THERMAL_WINDING];
    out->heats[1][THERMAL_FRAME] = cooling / config->duty_cooling / settles[THERMAL_FRAME];
    out->heats[2][THERMAL_DRIVE_END] = speed / config->duty_speed / settles[THERMAL_DRIVE_END];
    out->heats[3][THERMAL_OTHER_END] = speed / config->duty_speed / settles[THERMAL_OTHER_END];
    out->heats[4][THERMAL_WINDING] = copper / config->duty_copper / settles[THERMAL_WINDING];
}

/* Update the probability that each connector is loose, by the last block's log odds. */
static void judge_connectors(const struct thermal_config *config, struct thermal_motor *motor)
{
    const double dt = config->imm.block_s;
    for (int q = 0; q < P; q++) {
        if (!isnan(motor->bursts[q])) { /* without readings the probability stays */
            const double p = motor->loose[q];
            const double now = p * (1.0 - config->loose_end_per_s * dt) +
                               (1.0 - p) * config->loose_begin_per_s * dt;
            const double odds =
                now / (1.0 - now) * elementary_exp(clamp(motor->bursts[q], -50.0, 50.0));
            motor->loose[q] = smaller(odds / (1.0 + odds), SUREST);
        }
        motor->kind[SENSOR_KINDS + q] = motor->loose[q];
    }
}

/* Hysteresis: the sum over kinds is above one half if a fault is reported, and below if not. */
static void hold(const struct thermal_config *config, struct thermal_motor *motor)
{
    double total = 0.0;
    for (int c = 0; c < THERMAL_KINDS; c++)
        total += motor->kind[c];
    const double most = larger(total, 1.0);
    const double p = total / most;
    motor->held = p > (motor->held ? CLEAR : config->raise_probability);
    motor->fault_probability = p;
    const double shown = motor->held ? larger(p, HALF + 0.01) : smaller(p, HALF - 0.01);
    for (int c = 0; c < THERMAL_KINDS; c++)
        motor->kind[c] *= shown / larger(total, LEAST);
}

/* Settings of the filters of a motor that its model explains less well than they assume. */
static struct imm_config inflated(const struct thermal_config *config,
                                  const struct thermal_motor_config *known)
{
    struct imm_config out = config->imm;
    out.own_k *= known->inflation;
    for (int i = 0; i < IMM_DISTURBANCES; i++)
        out.sigma[i] *= known->inflation;
    return out;
}

/* 1 if a motor turned or had current in the last block. */
static int was_driven(const struct thermal_config *config, const struct thermal_sums *sums)
{
    return sums->speed >= sums->count * DRIVEN_RAD_S ||
           sums->current_square >= sums->count * config->cut_out.driven_square;
}

/* A motor that is parked has no losses and no fan, so that heat in it cannot be told from uneven
 * cooling, which no model knows. The filters follow it, but what was likely when it stopped stays. */
static void keep_parked(const struct thermal_config *config, struct thermal_motor *motor)
{
    const struct thermal_sums *sums = &motor->inputs;
    if (sums->count > 0.0)
        motor->parked_s = was_driven(config, sums) ? 0.0 : motor->parked_s + config->imm.block_s;
    for (int g = 0; g < IMM_MODES; g++) {
        if (motor->parked_s == 0.0)
            motor->driven_mode[g] = motor->imm.mode[g];
        else if (motor->parked_s > PARKED_S)
            motor->imm.mode[g] = motor->driven_mode[g];
    }
}

void thermal_judge_block(const struct thermal_config *config,
                         const struct thermal_motor_config *known, struct thermal_motor *motor)
{
    struct imm_surroundings around;
    const struct imm_config filters = inflated(config, known);
    const double noise_k = known->block_noise_k * known->inflation;
    thermal_surroundings(config, &known->model, &motor->inputs, &around);
    motor->log_likelihood =
        imm_advance(&filters, &around, motor->off_k, noise_k, motor->held, &motor->imm);
    keep_parked(config, motor);
    motor->size_k = imm_kinds(&config->imm, &motor->imm, motor->kind);
    judge_connectors(config, motor);
    hold(config, motor);
    const double share =
        config->learn_per_s * config->imm.block_s * (1.0 - motor->fault_probability);
    for (int q = 0; q < P; q++)
        if (isfinite(motor->off_k[q]))
            motor->base_k[q] += share * clamp(motor->off_k[q], -MOST_LEARNT_K, MOST_LEARNT_K);
    motor->judged += 1;
}

/* ---- All motors, sample by sample */

void thermal_monitor_judge(struct thermal_monitor *all, int count)
{
    for (int k = 0; k < count && all->waiting > 0; k++) {
        const int m = all->motor_count - all->waiting;
        all->waiting -= 1;
        if (all->motors[m].started)
            thermal_judge_block(all->config, &all->known[m], &all->motors[m]);
    }
}

void thermal_monitor_add_sample(struct thermal_monitor *all, const double *reading,
                                const struct thermal_input *input)
{
    find_cut_out(&all->config->cut_out, input, all->motor_count, all->currents);
    thermal_add_sample(all, reading, input);
    all->position += 1;
    if (all->position >= all->config->block)
        thermal_monitor_close_block(all);
}

void thermal_monitor_close_block(struct thermal_monitor *all)
{
    thermal_monitor_judge(all, all->waiting);
    thermal_close_block(all->config, all->known, all->motors, all->motor_count, all->workspace);
    all->position = 0;
    all->waiting = all->motor_count;
}

/* ---- Results for the motors */

static void kinds_of(const struct thermal_motor *motor, double *kind)
{
    double total = 0.0;
    int stepped = 0;
    for (int q = 0; q < P; q++)
        stepped |= motor->step[q].offset_k != 0.0;
    for (int c = 0; c < THERMAL_KINDS; c++) /* beside a step, what is not reported is no doubt */
        kind[c] = stepped && !motor->held ? 0.0 : motor->kind[c];
    for (int q = 0; q < P; q++)
        if (motor->step[q].offset_k != 0.0)
            kind[IMM_HEATS + q] = SURE;
    for (int c = 0; c < THERMAL_KINDS; c++)
        total += kind[c];
    const double most = larger(total / SURE, 1.0);
    for (int c = 0; c < THERMAL_KINDS; c++)
        kind[c] /= most;
}

void thermal_kinds(const struct thermal_motor *motor, int motors, double *kind)
{
    for (int m = 0; m < motors; m++)
        kinds_of(&motor[m], kind + (int64_t)m * THERMAL_KINDS);
}

double thermal_likelihood(const struct thermal_config *config,
                          const struct thermal_motor_config *known, const double *off,
                          const struct thermal_sums *inputs, int blocks)
{
    struct imm_state state;
    struct imm_surroundings around;
    double total = 0.0;
    imm_start(&config->imm, &state);
    for (int k = 0; k < blocks; k++) {
        thermal_surroundings(config, &known->model, &inputs[k], &around);
        const double says = imm_advance(&config->imm, &around, off + (int64_t)k * P,
                                        known->block_noise_k, 0, &state);
        total += k > 0 ? says : 0.0; /* the first block only sets the start */
    }
    return total;
}

/* Readings that a filter predicts, and their covariance, without noise. */
static void read_expected(const struct imm_state *state, double *mean, double *cov)
{
    for (int q = 0; q < P; q++) {
        mean[q] = state->mean[0][THERMAL_SEEN[q]];
        for (int r = 0; r < P; r++)
            cov[q * P + r] = state->cov[0][THERMAL_SEEN[q]][THERMAL_SEEN[r]];
    }
}

void thermal_expected(const struct thermal_config *config, const struct thermal_motor_config *known,
                      const double *off, const struct thermal_sums *inputs, int blocks,
                      double *mean, double *cov)
{
    struct imm_state state, next = {0};
    struct imm_surroundings around;
    struct imm_prediction by;
    imm_start(&config->imm, &state);
    for (int k = 0; k < blocks; k++) {
        thermal_surroundings(config, &known->model, &inputs[k], &around);
        imm_prepare(&config->imm, &around, &by);
        imm_predict(&config->imm, &around, &by, 0, &state, &next);
        read_expected(&next, mean + (int64_t)k * P, cov + (int64_t)k * P * P);
        imm_advance(&config->imm, &around, off + (int64_t)k * P, known->block_noise_k, 0, &state);
    }
}
