/* Detects currents that are well protected and wrong, by three checks that do not use the load.
 *
 * - Repeats: equal current vectors while the rotor turns; one repeat is a late sample, more are
 *   held currents. On CAN FD also eight samples equal to those of the frame before.
 * - Torque: the torque of the currents at the angle of the rotor, compared with the torque that the
 *   drive sends; if the rotor turns too fast for that, the most that they could make at any angle.
 * - Angle of the current against ElectricalAngle, where that is sent. Their constant difference is
 *   learnt, so no convention is assumed; a step means a late current, or another drive's.
 *
 * Not in paper `adhesion`. Nothing here can fail: a number that is not known is NaN, and each
 * condition is written so that false, the result of every comparison with NaN, is the safe answer.
 * Divisors are the cycle of Motion, at least 1 ns, a count from 1 on, and the length of a current
 * that is above 0. Stamps are between 0 and now; an index in the ring is a count modulo its size;
 * the sample before another one is in a lower row. */
#include "gateway/core/current_plausibility.h"

#include "estimators/numbers.h"
#include "estimators/vectors.h"
#include "gateway/core/misfits.h"

#define HALF_TURN 3.14159265358979323846     /* rad */
static const int64_t LATE_NS = 1000 * MS_NS; /* as HELD_NS, after one late sample */
static const int64_t REPEATS = 2;            /* consecutive repeats: more than one late sample */
/* Noise can make two samples equal: what is a repeat should have changed by NOISE_SIGMAS standard
 * deviations of their difference, as the filter has learnt its noise; at most by NOISE_MOST, per unit
 * of rated current, because what a converter holds is noise to the filter, too. */
#define NOISE_SIGMAS  6.0
#define NOISE_MOST    0.05
#define LEAST_CURRENT 0.15 /* per unit of rated; with less current */
#define LEAST_TORQUE  0.1  /* and less torque, torque and angle are not compared */
/* Largest difference of two torques, per unit of rated torque and of the sent one: magnets may be a
 * fifth off the data sheet. Above the deviation, currents are no evidence of a loss. */
#define TORQUE_OFF                0.15
#define TORQUE_OFF_RELATIVE       0.3
#define TORQUE_DEVIATION          0.06
#define TORQUE_DEVIATION_RELATIVE 0.15
#define UNRELIABLE_NS             (15 * MS_NS)
static const struct misfit_rule OF_CURRENT = {3, UNRELIABLE_NS};
/* Largest deviation of the angle: rad, and in turns of a sample period, which is at least 0.5 ms:
 * stamps jitter. */
#define ANGLE_OFF         0.06
#define ANGLE_OFF_PERIODS 0.3
#define LEAST_PERIOD_S    0.5e-3
#define MOST_TURN 0.63 /* rad between two samples; above it the currents are not used any further */
static const int64_t LEARN = 20; /* readings before the constant part of the angle is known */
#define KEPT 0.98                /* share of `base` that each later reading keeps: half a second */
/* Length of the mean of unit vectors below which angle and current are not related: another
 * reference frame, or another direction. */
#define COHERENT 0.95
/* An angle that has been off for so long is the drive's new one. */
static const int64_t LEARN_ANEW_NS = 60000 * MS_NS;
/* After so long without a reading, the deviation of the angle is that of the next reading. */
static const int64_t ANGLE_GAP_NS = 100 * MS_NS;

/* ---- Repeated currents ---- */

static int equals(const double *one, const double *other)
{
    return one[0] == other[0] && one[1] == other[1];
}

/* Distance that a current of this length moves while the rotor turns by `turned`, rad. */
static double chord(double length, double turned)
{
    return 2.0 * length * fabs(sine(0.5 * turned));
}

/* Least change of a current that its noise does not hide, A. The root is that of a variance. */
static double least_change(const struct plausibility *p, const struct filter *filter)
{
    const double noise = NOISE_SIGMAS * sqrt(2.0 * p->current_var * filter->r_scale);
    return larger(p->least_change_a, smaller(noise, NOISE_MOST * p->rated_a));
}

/* Check one more sample of current, `passed` s after the last; w_e: electrical speed, rad/s; least_a:
 * see least_change. */
static void add_current(struct plausibility *p, const double *current, double passed, double w_e,
                        double least_a, int64_t now_ns)
{
    const double length = sqrt(square(current[0]) + square(current[1]));
    const double *newest = p->current[(p->samples - 1) % CURRENT_HISTORY];
    double *oldest = p->current[p->samples % CURRENT_HISTORY];
    if (p->samples > 0 && equals(current, newest)) {
        p->repeats++;
        p->repeated_s += passed;
        const double turned = smaller(fabs(w_e) * p->repeated_s, HALF_TURN);
        if (chord(length, turned) > least_a)
            set_implausible(p, now_ns + (p->repeats >= REPEATS ? HELD_NS : LATE_NS));
    } else {
        p->repeats = 0;
        p->repeated_s = 0.0;
    }
    if (p->samples >= CURRENT_HISTORY && equals(current, oldest)) {
        p->block_repeats++;
        const double turned = fabs(w_e) * passed * CURRENT_HISTORY;
        if (p->block_repeats >= CURRENT_HISTORY && chord(length, turned) > p->least_change_a)
            set_implausible(p, now_ns + LATE_NS);
    } else {
        p->block_repeats = 0;
    }
    oldest[0] = current[0];
    oldest[1] = current[1];
    p->samples++;
}

/* Electrical speed by Motion, else by the flux chords, rad/s; 0 if neither is known. */
static double electrical_speed(const struct motion_monitor *m, int64_t k)
{
    const double measured = m->inputs[k].speed_rad_s;
    if (!isnan(measured))
        return m->motions[k].pole_pairs * measured;
    return m->chords[k].ready ? m->chords[k].w : 0.0;
}

/* Time from the sample before to sample i of this tick, s. */
static double time_before(const struct motion_monitor *m, int64_t i)
{
    return (double)(m->receiver->sample_steps[i] + m->receiver->sample_gap[i]) * m->dt;
}

void check_samples(struct motion_monitor *m, int64_t now_ns)
{
    for (int64_t i = 0; i < m->receiver->tick.samples; i++) {
        const int64_t k = m->receiver->sample_drive[i];
        add_current(&m->checks[k], &m->receiver->sample_y[2 * i], time_before(m, i),
                    electrical_speed(m, k), least_change(&m->checks[k], &m->filters[k]), now_ns);
    }
}

/* ---- Torque and angle of the current ---- */

/* A reading of Motion together with the current at the same instant. */
struct reading {
    int64_t k;               /* drive */
    int64_t t_ns;            /* stamp of the reading */
    double torque;           /* Nm, as sent */
    double angle;            /* electrical angle, rad; NaN: not sent */
    double w_e;              /* electrical speed, rad/s */
    double torque_per_a;     /* Nm per A along q */
    double _Complex current; /* of the nearest sample, A */
    double later_s;          /* time by which that sample is later, s */
};

/* Time at which the newest sample of drive k was taken: its stamp less its delay. */
static int64_t newest_ns(const struct motion_monitor *m, int64_t k)
{
    const struct drive_input *in = &m->receiver->drives[k];
    return in->sample_ns - in->clock.late_ns;
}

/* Row of the last sample of drive k in this tick, from which `sample_before` leads on; -1: none. */
static int64_t newest_sample(const struct motion_monitor *m, int64_t k)
{
    return m->receiver->drives[k].newest_sample;
}

/* Fill in the sample of this tick that is nearest to the reading. Returns 0 if there is none. */
static int find_current(const struct motion_monitor *m, struct reading *reading)
{
    double later = (double)(newest_ns(m, reading->k) - reading->t_ns) * 1e-9;
    reading->later_s = INFINITY;
    for (int64_t i = newest_sample(m, reading->k); i >= 0; i = m->receiver->sample_before[i]) {
        const double *y = &m->receiver->sample_y[2 * i];
        if (fabs(later) < fabs(reading->later_s)) {
            reading->later_s = later;
            reading->current = y[0] + y[1] * I;
        }
        later -= time_before(m, i);
    }
    return fabs(reading->later_s) <= 1.5 * m->period_s;
}

/* Least difference between the torques of this tick's currents and the sent torque, which may
 * be as old as any of them. theta: angle of the rotor at the newest sample, rad. */
static double torque_difference(const struct motion_monitor *m, const struct reading *reading,
                                double theta)
{
    double least = INFINITY, t = 0.0;
    for (int64_t i = newest_sample(m, reading->k); i >= 0; i = m->receiver->sample_before[i]) {
        const double *y = &m->receiver->sample_y[2 * i];
        double sin, cos;
        sine_and_cosine(theta - reading->w_e * t, &sin, &cos);
        const double i_q = y[1] * cos - y[0] * sin;
        least = smaller(fabs(reading->torque_per_a * i_q - reading->torque), least);
        t += time_before(m, i);
    }
    return least;
}

/* 1 if no current of this tick can make the torque that the drive sends, at any angle. Of currents
 * sampled too rarely only the length is known: it shows a drive that has lost its grip and sends
 * its command as its torque. */
static int is_torque_beyond_current(const struct motion_monitor *m, const struct reading *reading)
{
    double most = 0.0;
    for (int64_t i = newest_sample(m, reading->k); i >= 0; i = m->receiver->sample_before[i]) {
        const double *y = &m->receiver->sample_y[2 * i];
        most = larger(length_of(y[0] + y[1] * I), most);
    }
    const double rated = m->checks[reading->k].rated_nm, sent = fabs(reading->torque);
    const double beyond = sent - fabs(reading->torque_per_a) * most;
    return beyond > TORQUE_OFF * rated + TORQUE_OFF_RELATIVE * sent;
}

/* 1 if the currents make another torque than the drive sends, by more than motor data explain;
 * marks the currents as unreliable on a smaller difference. */
static int is_torque_off(struct motion_monitor *m, const struct reading *reading, double theta,
                         int64_t now_ns)
{
    const double off = torque_difference(m, reading, theta);
    const double rated = m->checks[reading->k].rated_nm, sent = fabs(reading->torque);
    if (off > TORQUE_DEVIATION * rated + TORQUE_DEVIATION_RELATIVE * sent)
        mark_unreliable(&m->rotors[reading->k], now_ns + UNRELIABLE_NS);
    return off > TORQUE_OFF * rated + TORQUE_OFF_RELATIVE * sent;
}

static void forget_angle(struct plausibility *p)
{
    p->learnt = 0;
    p->base = 0.0;
}

/* Angle by which a reading may be off because it waited for the bus, rad: its stamp is that of its
 * reception, off the grid of its cycle; and it may be delayed as samples usually are.
 * passed_ns: since the reading before. */
static double turned_meanwhile(const struct motion_monitor *m, const struct reading *reading,
                               int64_t passed_ns)
{
    const int64_t cycle = m->motion_cycle_ns;
    const int64_t off_ns = passed_ns - (passed_ns + cycle / 2) / cycle * cycle;
    const int64_t usual_ns = m->receiver->drives[reading->k].clock.usual_ns;
    return fabs(reading->w_e) * (fabs((double)off_ns) + (double)usual_ns) * 1e-9;
}

/* Update the deviation of the current's angle; 1 if it is too large. unit: see is_angle_off. */
static int deviates(const struct motion_monitor *m, struct plausibility *p,
                    const struct reading *reading, double _Complex unit)
{
    const int64_t passed_ns = reading->t_ns - p->angle_ns;
    const double turned = turned_meanwhile(m, reading, passed_ns);
    const double angle = angle_of(unit * conj(p->base));
    const double off = angle - clamp(angle, -turned, turned);
    if (passed_ns <= ANGLE_GAP_NS)
        p->deviation += 0.5 * (off - p->deviation);
    else
        p->deviation = off;
    p->angle_ns = reading->t_ns;
    const double period_s = larger(m->period_s, LEAST_PERIOD_S);
    const double limit = ANGLE_OFF + ANGLE_OFF_PERIODS * fabs(reading->w_e) * period_s;
    return !(fabs(p->deviation) <= limit);
}

/* 1 if the current has left its angle. unit: unit vector of the current in the frame of the measured
 * angle, in the direction of the torque; may_learn: 1 if no check contradicts it. */
static int is_angle_off(const struct motion_monitor *m, struct plausibility *p,
                        const struct reading *reading, double _Complex unit, int may_learn)
{
    if (p->learnt < LEARN) {
        if (may_learn) {
            p->learnt++;
            p->base += (unit - p->base) / (double)p->learnt;
        }
        return 0;
    }
    if (length_of(p->base) < COHERENT) {
        forget_angle(p);
        return 0;
    }
    if (deviates(m, p, reading, unit)) {
        if (reading->t_ns - p->angle_fitted_ns > LEARN_ANEW_NS)
            forget_angle(p);
        return 1;
    }
    p->angle_fitted_ns = reading->t_ns;
    if (may_learn)
        p->base += (1.0 - KEPT) * (unit - p->base);
    return 0;
}

/* Compare the measured angle with the current; 1 if the torque at it is off. torque_off: result at
 * the angle of the filter, if it tracks. Implausible readings are not learnt; a small current may
 * have turned over since the torque was measured. */
static int check_angle(struct motion_monitor *m, const struct reading *reading, int tracking,
                       int torque_off, int64_t now_ns)
{
    struct plausibility *p = &m->checks[reading->k];
    const double length = length_of(reading->current);
    int off = torque_off;
    if (p->learnt >= LEARN) {
        const double later = (double)(newest_ns(m, reading->k) - reading->t_ns) * 1e-9;
        const double theta = reading->angle + reading->w_e * later + angle_of(p->base);
        off = is_torque_off(m, reading, theta, now_ns) || off;
    }
    if (length >= LEAST_CURRENT * p->rated_a && length < IMPLAUSIBLE) {
        /* The unit vector along q, in the direction of the torque, is 1. */
        const double theta = reading->angle + reading->w_e * reading->later_s;
        const double _Complex turned = reading->current * conj(unit_vector(theta));
        const double sign = reading->torque >= 0.0 ? 1.0 : -1.0;
        const double _Complex unit = sign * (cimag(turned) - creal(turned) * I) / length;
        const int may_learn = tracking && !off && now_ns >= p->implausible_until_ns;
        const int angle_off = is_angle_off(m, p, reading, unit, may_learn);
        count_misfit(m, reading->k, &p->angle_misfits, angle_off, &OF_CURRENT, now_ns);
    }
    return off;
}

/* Compare currents with torque and angle as measured at the same instant. */
void check_current(struct motion_monitor *m, int64_t r, int64_t now_ns)
{
    const struct receiver *from = m->receiver;
    const int64_t k = from->motion_drive[r];
    struct plausibility *p = &m->checks[k];
    const double flux = m->estimates[k].flux_ratio;
    struct reading reading = {
        .k = k,
        .t_ns = from->motion_t_ns[r],
        .torque = from->motion_torque[r],
        .angle = from->motion_angle[r],
        .w_e = m->motions[k].pole_pairs * from->motion_speed[r],
        .torque_per_a = p->torque_per_a * (isnan(flux) ? 1.0 : flux),
    };
    if (!find_current(m, &reading))
        return;
    if (fabs(reading.w_e) * m->period_s > MOST_TURN) {
        const int beyond = is_torque_beyond_current(m, &reading);
        count_misfit(m, k, &p->excess_misfits, beyond, &OF_CURRENT, now_ns);
        return;
    }
    const double length = length_of(reading.current);
    const int strong_current = length >= LEAST_CURRENT * p->rated_a;
    const int strong_torque = fabs(reading.torque) >= LEAST_TORQUE * p->rated_nm;
    if (!strong_current && !strong_torque)
        return;
    const int tracking = m->estimates[k].health == HEALTH_TRACKING;
    const double theta_e = m->filters[k].x[3];
    int off = tracking && is_torque_off(m, &reading, theta_e, now_ns);
    if (!isnan(reading.angle) && length > 0.0 && strong_torque)
        off = check_angle(m, &reading, tracking, off, now_ns);
    count_misfit(m, k, &p->torque_misfits, off, &OF_CURRENT, now_ns);
}
