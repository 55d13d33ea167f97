/* Measured speed and torque of the drives: load by an observer, and a check of the estimates.
 *
 * The filters need about ten samples of current per electrical revolution. With fewer, the load
 * comes from the observer; without a fresh Motion it is then unknown. It also comes from there at a speed so low that the flux is not seen, if there is a Motion. With enough
 * samples, the measured speed shows what currents alone cannot: swapped phases, an aliased speed, a
 * wrong sign, and a rotor that turns although the filter does not find it.
 *
 * Not in paper `adhesion`. Nothing here can fail: a number that is not known is NaN, every
 * comparison with NaN is false, and each condition is written so that false is the safe answer. The
 * divisors are the cycle of Motion, at least 1 ns, and a time above SMOOTH_NS. Stamps are between 0
 * and now, so that their difference and the quotient fit. The root is that of a variance. */
#include "gateway/core/motion.h"

#include <math.h>

#include "dbc/rounding.h"
#include "estimators/current_calibration.h"
#include "estimators/load_observer.h"
#include "estimators/numbers.h"
#include "gateway/core/observer.h"
#include "gateway/core/plausibility.h"

#define SECOND_NS  1000000000LL
#define HYSTERESIS 0.05 /* share of `max_w_e` */
/* Measured and estimated speed disagree beyond this share and this speed: the flux may be off by a
 * tenth, and Motion is up to 10 ms old during a slip. */
#define SPEED_TOLERANCE       0.15
#define SPEED_TOLERANCE_RAD_S 5.0
static const int64_t DISAGREE_TICKS = 5; /* consecutive, before the input is implausible */
static const int64_t MAX_MISSING = 5; /* cycles without a reading before the observer starts anew */
static const int64_t SMOOTH_NS = SECOND_NS / 10; /* time constant of `smooth_speed` */
/* A filter finds a rotor that turns within this time. If not, the currents and voltages are not
 * what they seem: an open phase, another motor. */
static const int64_t LOCK_NS = SECOND_NS;

/* `x`, or `other` if `x` is not known. */
static double known_or(double x, double other)
{
    return isnan(x) ? other : x;
}

/* ---- Observers ---- */

/* The drive computes the torque that it sends with the flux of the data sheet. */
static void follow_reading(const struct motion_monitor *m, int64_t r)
{
    const int64_t k = m->receiver->motion_drive[r], t_ns = m->receiver->motion_t_ns[r];
    struct motion *own = &m->motions[k];
    const double w = m->receiver->motion_speed[r];
    const double torque = m->receiver->motion_torque[r] * known_or(m->estimates[k].flux_ratio, 1.0);
    /* The cycle is exact; the stamps jitter. */
    const double passed = (double)(t_ns - own->reading_ns) / (double)m->motion_cycle_ns;
    const int64_t cycles = round_half_even(passed);
    own->reading_ns = t_ns;
    if (!own->started || cycles > MAX_MISSING) {
        load_observer_init(&own->observer, w, torque, &own->mechanics);
        own->started = 1;
        own->readings = 0;
    } else if (cycles > 0) {
        const double dt = (double)(cycles * m->motion_cycle_ns) / (double)SECOND_NS;
        load_observer_update(&own->observer, w, torque, dt, &own->mechanics);
        own->readings++;
    }
}

void follow_readings(const struct motion_monitor *m)
{
    for (int64_t r = 0; r < m->receiver->tick.motions; r++)
        follow_reading(m, r);
}

/* ---- Implausible input ---- */

/* 1 if the filter has failed for too long to find a rotor that turns. */
static int is_not_found(const struct motion_monitor *m, struct motion *own, double measured,
                        const struct drive_estimate *estimate)
{
    const int turns = fabs(own->pole_pairs * measured) > m->turning_w_e;
    const int lost = turns && estimate->health == HEALTH_CONVERGING; /* with fresh currents */
    own->unlocked_ns = lost ? own->unlocked_ns + m->tick_ns : 0;
    return own->unlocked_ns > LOCK_NS;
}

/* 1 if measured and estimated speed have disagreed for too long. The result stands until a filter
 * that tracks agrees again. */
static int disagrees(struct motion *own, double measured, const struct drive_estimate *estimate)
{
    if (!isnan(measured) && estimate->health == HEALTH_TRACKING) {
        const double limit = larger(SPEED_TOLERANCE_RAD_S, SPEED_TOLERANCE * fabs(measured));
        const double difference = fabs(known_or(estimate->speed_rad_s, 0.0) - measured);
        own->disagree_ticks = difference > limit ? own->disagree_ticks + 1 : 0;
    }
    return own->disagree_ticks >= DISAGREE_TICKS;
}

/* 1 if the measured speed contradicts the filter. */
static int contradicts(const struct motion_monitor *m, struct motion *own, double measured,
                       const struct drive_estimate *estimate)
{
    return is_not_found(m, own, measured, estimate) || disagrees(own, measured, estimate);
}

/* ---- Selection of the source ---- */

static void set_unknown(struct drive_estimate *estimate, uint8_t health, uint8_t reason)
{
    estimate->health = health;
    estimate->health_reason = reason;
    estimate->speed_rad_s = NAN;
    estimate->load_nm = NAN;
    estimate->load_sigma_nm = NAN;
    estimate->nis = NAN;
}

/* Use the observer in place of the filter. Without fresh currents nothing shows that Motion is
 * still plausible: the estimate is a prediction. */
static void estimate_by_observer(const struct motion *own, const struct input_status *in,
                                 struct drive_estimate *estimate)
{
    if (!own->started || isnan(in->speed_rad_s)) {
        set_unknown(estimate, HEALTH_UNKNOWN, REASON_NOT_AVAILABLE);
    } else if (!is_observer_settled(own)) {
        set_unknown(estimate, HEALTH_CONVERGING, REASON_STARTING);
    } else {
        estimate->health = in->sample_fresh ? HEALTH_TRACKING : HEALTH_PREDICTING;
        estimate->speed_rad_s = own->observer.w;
        estimate->load_nm = own->observer.T_L;
        estimate->load_sigma_nm = load_observer_sigma(&own->observer);
        estimate->nis = own->observer.nis;
    }
}

/* Select the estimate to use for a drive; that of a drive with invalid input is not changed.
 *
 * Drives are compared, and filter and observer follow a load step at different speeds: if one
 * drive needs the observer, all drives that can use it do. */
static void select_source(const struct motion_monitor *m, int64_t k, int needed)
{
    const struct motion *own = &m->motions[k];
    const struct input_status *in = &m->inputs[k];
    struct drive_estimate *estimate = &m->estimates[k];
    const int invalid = estimate->health == HEALTH_INPUT_INVALID;
    const int can = !isnan(in->speed_rad_s) && is_observer_settled(own);
    const int by_observer = own->aliasing || (needed && can);
    estimate->by_observer = by_observer && !invalid;
    estimate->crawls = by_observer && own->crawls && !invalid;
    if (by_observer && !invalid)
        estimate_by_observer(own, in, estimate);
}

/* 1 if drive k bears witness that its train does not crawl: a wheel that has run away or locked, and
 * implausible input, do not. */
static int is_faster(const struct motion_monitor *m, int64_t k)
{
    const struct motion *own = &m->motions[k];
    const int measured = !isnan(m->inputs[k].speed_rad_s);
    return measured && !own->crawls && !own->implausible && !m->rotors[k].away;
}

/* Speed of the filter without its noise, which can be larger than HYSTERESIS near the limit; 0: not
 * known, or from implausible currents. */
static double smooth_speed(const struct motion_monitor *m, int64_t k)
{
    struct motion *own = &m->motions[k];
    const double w = own->implausible ? NAN : m->estimates[k].speed_rad_s;
    const int smooth = m->estimates[k].health == HEALTH_TRACKING && !isnan(own->smooth_speed);
    const double weight = (double)m->tick_ns / (double)(m->tick_ns + SMOOTH_NS);
    own->smooth_speed = smooth ? own->smooth_speed + weight * (w - own->smooth_speed) : w;
    return known_or(own->smooth_speed, 0.0);
}

/* Note which drives turn too fast, or too slowly, for their filters; 1 if the observers are needed: one
 * of the former can be compared, or the train crawls. A filter's speed from implausible currents is
 * ignored, and changes no other drive's source. */
static int note_ranges(const struct motion_monitor *m)
{
    int fast = 0, slow = 0, faster = 0;
    for (int64_t k = 0; k < m->n; k++) {
        struct motion *own = &m->motions[k];
        const double w = known_or(m->inputs[k].speed_rad_s, smooth_speed(m, k));
        const double limit = m->max_w_e * (own->aliasing ? 1.0 - HYSTERESIS : 1.0);
        const double least = m->crawl_w_e * (own->crawls ? 1.0 + HYSTERESIS : 1.0);
        own->aliasing = fabs(own->pole_pairs * w) > limit;
        own->crawls = fabs(own->pole_pairs * m->inputs[k].speed_rad_s) < least;
        fast = fast || (own->aliasing && !own->implausible);
        slow = slow || (own->crawls && !own->implausible);
        faster = faster || is_faster(m, k);
    }
    return fast || (slow && !faster);
}

void select_sources(struct motion_monitor *m, int64_t now_ns)
{
    const int needed = note_ranges(m);
    for (int64_t k = 0; k < m->n; k++) {
        struct motion *own = &m->motions[k];
        struct drive_estimate *estimate = &m->estimates[k];
        const double measured = m->inputs[k].speed_rad_s;
        const double w_e = own->pole_pairs * measured;
        const int open_phase = !isnan(measured) && is_single_axis_current(&m->sensors[k], w_e);
        const int contrary = !own->aliasing && contradicts(m, own, measured, estimate);
        const int implausible = now_ns < m->checks[k].implausible_until_ns;
        estimate->health_reason = REASON_STARTING;
        if (open_phase || implausible)
            set_unknown(estimate, HEALTH_INPUT_INVALID, REASON_STARTING);
        select_source(m, k, needed);
        if (contrary)
            set_unknown(estimate, HEALTH_INPUT_INVALID, REASON_STARTING);
        own->implausible = open_phase || contrary || implausible;
    }
}

void observe_load(struct motion_monitor *m, int64_t now_ns)
{
    follow_readings(m);
    check_plausibility(m, now_ns);
    select_sources(m, now_ns);
}
