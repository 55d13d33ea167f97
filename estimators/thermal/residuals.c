/* Residuals of every motor's readings, sample by sample: its model (model.c) runs open loop beside
 * it, with the currents, the speed and the ambient temperature on the bus. Steps of sensors
 * (step_detector.c) are removed; what all motors' sensors show together is none.
 *
 * Nothing here can fail: rates that divide are above 0 (`identify` finds their logarithms), and
 * windows and blocks have at most THERMAL_BLOCK_MAX samples (`struct thermal_config`). */
#include "estimators/thermal/residuals.h"

#include <math.h>

#include "estimators/numbers.h"
#include "estimators/order_statistics.h"
#include "estimators/thermal/imm.h"
#include "estimators/thermal/model.h"
#include "estimators/thermal/step_detector.h"

enum { P = THERMAL_POINTS, L = THERMAL_LUMPS };

static const double NO_EXTRA[L] = {0.0};
/* s, longest time for which a motor that is driven again warms up before its model starts. It comes
 * back colder than the others, and what is wrong in every model grows with the motor's own heat. */
static const double WARM_UP_S = 2700.0;
static const double SHARED = 0.8; /* share of a step that every point of a common one shows */

void thermal_motor_reset(const struct thermal_config *config, struct thermal_motor *motor)
{
    const struct thermal_motor was = *motor;
    *motor = (struct thermal_motor){
        .unknown_s = was.unknown_s, .cold_s = was.cold_s, .trusted = was.trusted, .lost = was.lost};
    imm_start(&config->imm, &motor->imm);
    for (int g = 0; g < IMM_MODES; g++)
        motor->driven_mode[g] = motor->imm.mode[g];
    for (int q = 0; q < P; q++) {
        motor->compared_k[q] = was.compared_k[q];
        motor->absent_s[q] = was.absent_s[q];
        motor->peers_k[q] = was.peers_k[q];
        step_reset(&motor->step[q]);
        motor->burst[q].level_k = NAN;
        motor->middle_k[q] = motor->off_k[q] = NAN;
        for (int k = 0; k < THERMAL_BLOCK_MAX; k++)
            motor->window[q][k] = motor->block[q][k] = motor->raw[q][k] = NAN;
    }
}

/* Constants of an end of the motor: rates to frame and air, friction. */
struct end {
    double k, f, b;
};

static struct end end_of(const struct thermal_parameters *p, int q)
{
    if (q == 1)
        return (struct end){p->k_d, p->f_d, p->b_d};
    return (struct end){p->k_n, p->f_n, p->b_n};
}

/* The frame is as warm as the measured ends indicate, without their friction, or half way from the
 * winding to the air. The core is half way from the winding to the frame. */
int thermal_motor_start(const struct thermal_parameters *p, const struct thermal_input *u,
                        const double *reading, double *x)
{
    const double T_a = u->ambient, W = u->speed;
    const double winding = reading[0] - p->offset_k[0];
    double total = 0.0;
    int count = 0;
    for (int q = 1; q < P; q++) {
        if (!isfinite(reading[q]))
            continue;
        const struct end end = end_of(p, q);
        const double own = reading[q] - p->offset_k[q];
        const double frame = T_a + ((own - T_a) * (end.k + end.b) - end.f * W) / end.k;
        total += larger(frame, smaller(T_a, own));
        count++;
    }
    if (count == 0 && !isfinite(winding))
        return 0;
    const double frame = count > 0 ? total / count : 0.5 * (winding + T_a);
    x[THERMAL_WINDING] = isfinite(winding) ? winding : frame;
    x[THERMAL_CORE] = 0.5 * (x[THERMAL_WINDING] + frame);
    x[THERMAL_FRAME] = frame;
    for (int q = 1; q < P; q++) {
        const struct end end = end_of(p, q);
        const double settled = T_a + (end.k * (frame - T_a) + end.f * W) / (end.k + end.b);
        x[THERMAL_SEEN[q]] = isfinite(reading[q]) ? reading[q] - p->offset_k[q] : settled;
    }
    return 1;
}

static void add_inputs(const struct thermal_parameters *p, const struct thermal_input *u,
                       const double *x, struct thermal_sums *sums)
{
    const double rise = larger(x[THERMAL_FRAME] - u->ambient, THERMAL_LEAST_RISE_K);
    sums->current_square += u->current_square;
    sums->speed += u->speed;
    sums->cooling += (p->h_0 + p->h_1 * u->speed) * rise;
    sums->copper += p->a * u->current_square * thermal_model_resistance(x[THERMAL_WINDING]);
    sums->rise += rise;
    sums->count += 1.0;
}

/* Add the residual of one sensor; NaN without a reading. */
static void add_residual(const struct thermal_config *config, struct thermal_motor *motor, int q,
                         int k, double residual)
{
    motor->raw[q][k] = residual;
    if (config->steps.step_k > 0.0) {
        double *window = motor->window[q];
        const int size = step_window(&config->steps);
        for (int i = 1; i < size; i++)
            window[i - 1] = window[i];
        window[size - 1] = residual;
    }
}

static int is_known(const struct thermal_input *u)
{
    return isfinite(u->current_square) && isfinite(u->speed) && isfinite(u->ambient);
}

/* The core of a motor that has just started is not measured: it may be as warm as the winding, or
 * as the frame. */
static void widen_core(struct thermal_motor *motor)
{
    const double span = motor->lumps[THERMAL_WINDING] - motor->lumps[THERMAL_FRAME];
    for (int g = 0; g < IMM_MODES; g++)
        motor->imm.cov[g][THERMAL_CORE][THERMAL_CORE] += 0.25 * span * span;
}

/* Start the model of a motor. Weather, and what no model knows, are in the residuals of all motors:
 * from its readings alone, it would differ from the others until its model has settled. */
static void start_model(const struct thermal_motor_config *known, const struct thermal_input *u,
                        const double *reading, struct thermal_motor *motor)
{
    double centred[P];
    for (int q = 0; q < P; q++) {
        const double shared = isfinite(motor->peers_k[q]) ? motor->peers_k[q] : 0.0;
        centred[q] = reading[q] - known->centre_k[q] - shared;
    }
    motor->started = (uint8_t)thermal_motor_start(&known->model, u, centred, motor->lumps);
    if (motor->started)
        widen_core(motor);
}

/* 1 if a motor is cut out, or has been driven again for a shorter time than it was cut out. */
static int is_left_out(double dt_s, int cut_out, struct thermal_motor *motor)
{
    const double cold_s = cut_out ? motor->cold_s + dt_s : motor->cold_s - dt_s;
    motor->cold_s = clamp(cold_s, 0.0, WARM_UP_S);
    return cut_out || motor->cold_s > 0.0;
}

static void add_sample(const struct thermal_config *config,
                       const struct thermal_motor_config *known, int cut_out,
                       struct thermal_motor *motor, int k, const double *reading,
                       const struct thermal_input *u)
{
    const struct thermal_parameters *p = &known->model;
    double since = config->dt_s + motor->unknown_s; /* in a gap the motor has continued to run */
    motor->unknown_s = is_known(u) ? 0.0 : since;
    const int left_out = is_left_out(config->dt_s, cut_out, motor);
    motor->lost = left_out || (motor->started && motor->unknown_s > config->gap_s);
    for (int q = 0; q < P; q++)
        motor->block[q][k] = motor->raw[q][k] = NAN;
    if (left_out)
        return;
    if (is_known(u) && !motor->started) {
        start_model(known, u, reading, motor);
        since = config->dt_s;
    }
    if (!is_known(u) || !motor->started)
        return;
    thermal_model_step(p, u, NO_EXTRA, since, motor->lumps);
    add_inputs(p, u, motor->lumps, &motor->half[2 * k / config->block]);
    for (int q = 0; q < P; q++) {
        const double expected = motor->lumps[THERMAL_SEEN[q]] + p->offset_k[q] + known->centre_k[q];
        add_residual(config, motor, q, k, reading[q] - expected);
    }
}

/* ---- Steps */

/* 1 if the motor's model ran in this sample, so that there are residuals. */
static int is_running(const struct thermal_motor *motor)
{
    return motor->started && motor->unknown_s == 0.0;
}

/* Jumps of point q of all motors, sorted; returns their number. */
static int find_jumps(const struct thermal_monitor *all, int q, double *jump, double *sorted)
{
    int n = 0;
    for (int m = 0; m < all->motor_count; m++) {
        jump[m] = step_jump(&all->config->steps, all->motors[m].window[q]);
        if (isfinite(jump[m]))
            sorted[n++] = jump[m];
    }
    sort_ascending(sorted, n);
    return n;
}

/* Median jump of the other n - 1 motors. */
static double others_jump(const double *sorted, int n, double own)
{
    const int others = n - (isfinite(own) != 0);
    if (others < 1)
        return 0.0;
    const struct middle_pair middle = middle_of_others(sorted, others, own);
    return 0.5 * (middle.below + middle.above);
}

/* 1 if the readings of all points jump together, in the middle motor. No train warms within seconds:
 * what all acquisition channels share has stepped. */
static int is_shared_jump(const struct thermal_monitor *all, double *jump, double *sorted)
{
    const double least = SHARED * all->config->steps.step_k;
    int points = 0, up = 0, down = 0;
    for (int q = 0; q < P; q++) {
        const int n = find_jumps(all, q, jump, sorted);
        if (n == 0)
            continue;
        const double middle = median_in_place(sorted, n);
        points++;
        up += middle > least;
        down += -middle > least;
    }
    return points > 1 && (up == points || down == points);
}

/* Find the steps of the sensors at point q. What the others' sensors show at the same time is no
 * step of this one: the model does not know their lag. */
static void find_steps(struct thermal_monitor *all, int q)
{
    const struct step_config *config = &all->config->steps;
    double *jump = all->workspace, *sorted = jump + all->motor_count;
    int due = 0, n = 0;
    for (int m = 0; m < all->motor_count; m++)
        due |= is_running(&all->motors[m]) && step_is_due(config, &all->motors[m].step[q]);
    if (due && !is_shared_jump(all, jump, sorted))
        n = find_jumps(all, q, jump, sorted);
    for (int m = 0; m < all->motor_count; m++) {
        struct thermal_motor *motor = &all->motors[m];
        if (is_running(motor))
            step_add_sample(config, &motor->step[q], motor->window[q],
                            n > 0 ? others_jump(sorted, n, jump[m]) : 0.0);
    }
}

void thermal_add_sample(struct thermal_monitor *all, const double *reading,
                        const struct thermal_input *input)
{
    const int k = all->position;
    for (int m = 0; m < all->motor_count; m++) {
        struct thermal_motor *motor = &all->motors[m];
        add_sample(all->config, &all->known[m], all->currents[m].cut_out, motor, k,
                   reading + (int64_t)m * P, &input[m]);
        if (motor->lost)
            thermal_motor_reset(all->config, motor);
    }
    for (int q = 0; q < P; q++) {
        if (all->config->steps.step_k > 0.0)
            find_steps(all, q);
        for (int m = 0; m < all->motor_count; m++) {
            struct thermal_motor *motor = &all->motors[m];
            if (is_running(motor) && motor->step[q].since < 0)
                motor->block[q][k] = motor->raw[q][k] - motor->step[q].offset_k;
        }
    }
}
