/* Detects well-protected but wrong currents and Motion: held, late, turned, of another scale.
 *
 * A converter that hangs behind a live CAN layer sends good counters and checksums with old values.
 * current_plausibility.c checks the currents; this file has two more checks:
 *
 * - Load: that of the filter compared with that of the observer.
 * - Held Motion: Speed and Torque constant for 100 ms while others change; at a crawl for three
 *   cycles.
 *
 * Not in paper `adhesion`. Nothing here can fail: a number that is not known is NaN, and each
 * condition is written so that false, the result of every comparison with NaN, is the safe answer.
 * The divisor is a number of pole pairs; no variance is negative; stamps are between 0 and now, and
 * a cycle is at most a minute. */
#include "gateway/core/plausibility.h"

#include <math.h>

#include "estimators/filter.h"
#include "estimators/numbers.h"
#include "gateway/core/current_plausibility.h"
#include "gateway/core/misfits.h"
#include "gateway/core/observer.h"

/* The filter starts anew from this time before the end of an implausible input on. */
static const int64_t RESTART_NS = 20 * MS_NS;
static const struct misfit_rule OF_MOTION = {3, 0};
/* Filter and observer follow a loss differently for up to three readings. */
static const struct misfit_rule OF_LOAD = {4, 0};
/* Largest difference of two loads, per unit of rated torque and of the observed one. */
#define LOAD_OFF          0.25
#define LOAD_OFF_RELATIVE 0.3
/* Square of an innovation of the observer, per variance, above which it still follows a change. */
#define FOLLOWS_NIS 9.0
static const int64_t MOTION_HELD_NS = 100 * MS_NS;
/* Least change of others: a speed, as a share and in rad/s, or the torque command, per unit of
 * rated torque. */
#define SPEED_MOVED       0.03
#define SPEED_MOVED_RAD_S 1.0
#define COMMAND_MOVED     0.15
#define SPEED_SIGMAS      4.0 /* the same, in standard deviations of the speed by the currents */
/* Cycles without another value after which a Motion that alone shows the load may be held. */
#define STEADY_CYCLES 2.5
#define MOST_TURN 2.5 /* rad between two samples of current: a filter can track no faster rotor */

/* ---- Held Motion ---- */

/* 1 if a speed has changed; 0 if one of the two is not known. */
static int has_moved(double now, double before)
{
    return fabs(now - before) > larger(SPEED_MOVED * fabs(now), SPEED_MOVED_RAD_S);
}

/* 1 if the filter of a drive tracks its rotor. Near two samples of current per revolution it may
 * track an alias of it instead. */
static int is_tracked(const struct motion_monitor *m, int64_t k)
{
    const double w_e = m->motions[k].pole_pairs * m->inputs[k].speed_rad_s;
    const int may_be_alias = fabs(w_e) * m->period_s > MOST_TURN;
    return m->estimates[k].health == HEALTH_TRACKING && !may_be_alias;
}

/* Rotor speed from the currents, rad/s; NaN: not known. */
static double own_speed(const struct motion_monitor *m, int64_t k)
{
    return is_tracked(m, k) ? m->filters[k].x[2] / m->motions[k].pole_pairs : NAN;
}

/* 1 if the currents show another speed than Motion, by more than the error of the filter. */
static int is_speed_off(const struct motion_monitor *m, int64_t k, double own)
{
    const double measured = m->inputs[k].speed_rad_s;
    const double sigma = sqrt(m->filters[k].P[2][2]) / m->motions[k].pole_pairs;
    return has_moved(own, measured) && fabs(own - measured) > SPEED_SIGMAS * sigma;
}

/* 1 if the measured speeds of all other drives, at least one, have changed. */
static int all_others_moved(const struct motion_monitor *m, int64_t k)
{
    const double *then = m->others + m->noted[k] * m->n;
    int any = 0;
    for (int64_t j = 0; j < m->n; j++) {
        const double now = m->inputs[j].speed_rad_s, before = then[j];
        if (j == k || isnan(now) || isnan(before))
            continue;
        if (!has_moved(now, before))
            return 0;
        any = 1;
    }
    return any;
}

/* 1 if Motion of drive k is held while something that it must follow has changed. */
static int is_motion_held(const struct motion_monitor *m, int64_t k, double own, int64_t now_ns)
{
    const struct plausibility *p = &m->checks[k];
    const struct drive_input *in = &m->receiver->drives[k];
    const double measured = m->inputs[k].speed_rad_s;
    if (now_ns - p->changed_ns <= MOTION_HELD_NS || isnan(measured))
        return 0;
    if (is_speed_off(m, k, own))
        return 1;
    const int commanded = fabs(in->command - p->command) > COMMAND_MOVED * p->rated_nm;
    if (commanded && now_ns - in->command_ns > MOTION_HELD_NS)
        return 1;
    /* While its own speed is known, it turns as steadily as it sends. */
    return isnan(own) && all_others_moved(m, k);
}

/* Write the speeds of this tick into a row of `others`, in place of that of drive k. The other
 * drives have n - 1 rows at most, so that one is free. */
static int64_t note_others(struct motion_monitor *m, int64_t k)
{
    for (int64_t j = 0; j < m->n; j++)
        m->taken[j] = 0;
    for (int64_t j = 0; j < m->n; j++)
        if (j != k)
            m->taken[m->noted[j]] = 1;
    int64_t row = 0;
    while (m->taken[row])
        row++;
    for (int64_t j = 0; j < m->n; j++)
        m->others[row * m->n + j] = m->inputs[j].speed_rad_s;
    return row;
}

/* If Motion has changed, note the circumstances. row: of `others` in this tick; -1: none yet. */
static void note_motion(struct motion_monitor *m, int64_t r, int64_t *row)
{
    const struct receiver *from = m->receiver;
    const int64_t k = from->motion_drive[r];
    struct plausibility *p = &m->checks[k];
    if (from->motion_speed[r] == p->speed && from->motion_torque[r] == p->torque)
        return;
    p->speed = from->motion_speed[r];
    p->torque = from->motion_torque[r];
    p->changed_ns = from->motion_t_ns[r];
    p->command = from->drives[k].command;
    if (*row < 0)
        *row = note_others(m, k);
    m->noted[k] = *row;
}

/* At a crawl Motion alone shows the load. While it does not change it may be held, and is no evidence
 * of a loss: a wheel that starts to slide changes it. */
static void check_crawl(struct motion_monitor *m, int64_t r, int64_t now_ns)
{
    const int64_t k = m->receiver->motion_drive[r];
    const double steady = (double)(m->receiver->motion_t_ns[r] - m->checks[k].changed_ns);
    if (m->motions[k].crawls && steady > STEADY_CYCLES * (double)m->motion_cycle_ns)
        mark_unreliable(&m->rotors[k], now_ns + m->motion_cycle_ns + m->motion_cycle_ns / 2);
}

/* ---- A tick ---- */

/* 1 if the load of the filter differs from that of an observer that explains the measured speed: a
 * wheel that grips again changes its load by more than the observer follows. */
static int is_load_off(const struct motion_monitor *m, int64_t k)
{
    const struct load_observer *observer = &m->motions[k].observer;
    if (!is_tracked(m, k) || !is_observer_settled(&m->motions[k]) || observer->nis > FOLLOWS_NIS)
        return 0;
    const double observed = observer->T_L;
    const double limit = LOAD_OFF * m->checks[k].rated_nm + LOAD_OFF_RELATIVE * fabs(observed);
    return fabs(m->estimates[k].load_nm - observed) > limit;
}

static void check_reading(struct motion_monitor *m, int64_t r, int64_t *row, int64_t now_ns)
{
    const int64_t k = m->receiver->motion_drive[r];
    struct plausibility *p = &m->checks[k];
    check_current(m, r, now_ns);
    const double own = own_speed(m, k);
    note_motion(m, r, row);
    check_crawl(m, r, now_ns);
    const int held = is_motion_held(m, k, own, now_ns);
    count_misfit(m, k, &p->motion_misfits, held, &OF_MOTION, now_ns);
    const int load_off = is_load_off(m, k);
    count_misfit(m, k, &p->load_misfits, load_off, &OF_LOAD, now_ns);
}

/* A filter that was given implausible input starts anew: what it has learnt meanwhile is wrong. */
static void restart_filter(struct motion_monitor *m, int64_t k, int64_t now_ns)
{
    struct plausibility *p = &m->checks[k];
    if (!p->restart || now_ns + RESTART_NS < p->implausible_until_ns)
        return;
    filter_reset(&m->filters[k]);
    m->filters[k].v_q_bias = 0.0;
    m->estimates[k].flux_ratio = NAN;
    p->restart = now_ns < p->implausible_until_ns;
}

void check_plausibility(struct motion_monitor *m, int64_t now_ns)
{
    check_samples(m, now_ns);
    int64_t row = -1; /* row of `others` */
    for (int64_t r = 0; r < m->receiver->tick.motions; r++)
        check_reading(m, r, &row, now_ns);
    for (int64_t k = 0; k < m->n; k++) {
        if (m->checks[k].motion_misfits >= OF_MOTION.limit)
            m->inputs[k].speed_rad_s = NAN;
        restart_filter(m, k, now_ns);
    }
}
