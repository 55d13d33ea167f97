/* Acquisition: speed and angle from flux chords. It uses no filter, so it can check one.
 *
 * In the stationary frame (complex alpha + j beta), over any interval with known volt-seconds,
 *     c_k = integral(u - R_s i) dt - L_s (i_k - i_(k-1)) = psi_f (e^(j theta_k) - e^(j theta_(k-1))),
 * the chord along which the magnet flux has moved (paper `adhesion`, eq. (11), integrated). Hence
 *     |c_k| = 2 psi_f |sin(w dt / 2)|,  arg c_k = theta_mid + sign(w) pi / 2,
 *     arg(c_k conj(c_(k-1))) = w dt,
 * so speed, its sign and the angle follow from two chords, from any start, without convergence
 * and without a stable wrong solution. A filter started at a wrong angle can stay wrong (speed and
 * load of the wrong sign), with a NIS that depends on the speed: no threshold on the NIS works.
 *
 * Pairs of consecutive chords feed exponentially forgotten means: S1 = <c_k conj(c_(k-1))>,
 * S0 = <|c|^2>, S2 = <S1>. During an acceleration arg S1 lags by the memory, and arg(S1 conj S2)
 * measures that lag (double smoothing), so w follows a ramp without error.
 *
 * Chords last 2 ms, or as long as the speed allows if samples come faster: they begin with one
 * sample, are doubled while their length, which no alias can shorten there, leaves room, and are
 * halved above TURN_LONG. Speeds of 5000 rad/s are then measured as well as 50 rad/s.
 *
 * Limits. Below `w_off` errors of R_s and voltage exceed the chord (R_s 20 % off at 25 A looks like
 * 7 rad/s on the bench motor): the speed is not observable, so not ready. With fewer than ten
 * sub-steps per revolution the filter's Euler step is too coarse. Turns above pi per sample alias:
 * with 2 ms, 1571 rad/s and more read as a speed of the other sign; |sin| does not show it. The
 * caller must ensure |w| dt < pi, as for any bus slower than two samples per revolution.
 *
 * No function here can fail: numbers beyond any motor are discarded before a sum, a mean that is
 * not finite is restarted, and each divisor is a duration, a constant of the motor, or checked. */
#include "estimators/acquisition.h"

#include <math.h>
#include <stddef.h>

#include "estimators/elementary.h"
#include "estimators/vectors.h"

/* Most sub-steps per chord: 2 ms; a longer sample is a chord by itself. */
static const int64_t CHORD_STEPS = 16;
static const int64_t SETTLE_PAIRS = 4; /* pairs of a new length before the length is judged */
static const double PI = 0x1.921fb54442d18p+1;
static const double TURN_LONG = 1.5;    /* rad; a chord that turns by more is halved */
static const double TURN_SHORT = 0.9;   /* rad; a chord whose length allows no more is doubled */
static const double FORGET = 0.92;      /* of S1, S2 and S0, per chord: memory of about 12 chords */
static const double FORGET_ANGLE = 0.5; /* of the rotated mean of chords, per chord */
static const double COHERENCE = 0.9;    /* least |S1| / S0; 0.99 at 20 rad/s with 1e-2 A^2 of noise,
                                         * about 0.5 for noise alone */
static const double LENGTH_TOL = 0.35;  /* of |c|; R_s 20 % off at 20 rad/s makes 0.28 */
static const double TURN_MAX = 2.5;     /* rad per chord: margin below the alias at pi */
/* Largest turn per sub-step, rad: ten per revolution, 5000 rad/s at 125 us. The load of the Euler
 * model then reads 7 % high, 1 % at 3000 rad/s. */
static const double STEP_TURN_MAX = 0.63;
/* Chord durations without a new pair after which `ready` ends; shorter gaps only break a pair. */
static const double HOLD = 10.0;

/* Tolerances of a filter. With noise of 1e-2 A^2 the speed by the chords is up to 17 rad/s off
 * around 30 rad/s; the wrong sign differs by 40 or more wherever chords are ready. When an
 * acceleration starts suddenly, the means are late for some 20 ms, 30 rad/s at 2500 rad/s^2. The
 * angle is the sharp test: it comes from the last two chords, and no wrong speed keeps it right. A
 * filter 0.8 rad off shows 30 % too little torque; a wrong one is 2.45 rad off, and parameter
 * errors of 20 % make less than half of the tolerance. */
static const double W_TOL = 20.0;          /* rad/s */
static const double W_TOL_RELATIVE = 0.5;  /* of the chords' |w| */
static const double THETA_TOL = 0.8;       /* rad */
static const double STANDSTILL_TOL = 40.0; /* rad/s above what the length of the chords allows */

void acquisition_restart(struct acquisition *drive)
{
    *drive = (struct acquisition){
        .steps = -1,
        .stride = 1,
        .spread = HUGE_VAL,
        .w_max = HUGE_VAL,
        .psi = (double)NAN,
    };
}

/* Break the chord at a gap; the next one starts at the end of this sample, if it is plausible. */
static void break_chord(struct acquisition *a, int plausible, double _Complex i, double dt)
{
    a->paired_steps = 0;
    a->flux = 0.0;
    a->steps = -1;
    if (plausible) {
        a->steps = 0;
        a->i_start = i;
        a->i_last = i;
    }
    if (a->age > HOLD * fmax(a->span, (double)CHORD_STEPS * dt)) {
        a->good = 0;
        a->pairs = 0;
        a->ready = 0;
        a->stride = 1; /* the speed is now unknown: start from the shortest chord again */
    }
}

/* Convert the means to those of chords of `ratio` (2 or 1/2) times the duration:
 * |c| = 2 psi |sin(turn / 2)|. */
static void resize(struct acquisition *a, double ratio)
{
    const double turn = angle_of(a->S1), slow = angle_of(a->S2);
    const int doubled = ratio > 1.0;
    const double cos = cosine(doubled ? 0.5 * turn : 0.25 * turn);
    /* |turn| <= pi, so that the cosine of its quarter is above 0.7. */
    const double growth = doubled ? 4.0 * cos * cos : 0.25 / (cos * cos);
    a->S0 *= growth;
    a->S1 = length_of(a->S1) * growth * unit_vector(ratio * turn);
    a->S2 = length_of(a->S2) * growth * unit_vector(ratio * slow);
    a->span *= ratio;
}

/* Add one more pair to the means; 0 if they are no longer finite. */
static int update_means(struct acquisition *a, double _Complex pair, double energy, double span)
{
    if (a->ready && span != a->span) {
        const double ratio = span / a->span; /* ready, so that span is above 0 */
        if (ratio == 0.5 || ratio == 2.0)
            resize(a, ratio);
    }
    if (a->pairs == 0 || a->span != span) {
        a->S1 = pair;
        a->S2 = pair;
        a->S0 = energy;
        a->turned_sum = 0.0;
        a->pairs = 0;
        a->good = 0;
        a->ready = 0;
        a->span = span;
    }
    a->pairs += 1;
    /* A plain mean at first, so that the first pair does not outweigh the others. */
    const double keep = fmin(FORGET, 1.0 - 1.0 / (double)a->pairs);
    a->S1 = keep * a->S1 + (1.0 - keep) * pair;
    a->S2 = keep * a->S2 + (1.0 - keep) * a->S1;
    a->S0 = keep * a->S0 + (1.0 - keep) * energy;
    return isfinite(a->S0 + size_of(a->S1) + size_of(a->S2));
}

/* Result of a pair of chords. */
struct verdict {
    double lagging, turn;            /* rad per chord, by the means; the same without their lag */
    double lagging_chord, new_chord; /* chords of a circle of radius 1 for these two turns */
    double coherence;                /* |S1| / S0 */
};

/* 1 if length and turn of the chord, and of the means, are those of a rotor that turns. */
static int is_plausible(const struct acquisition *a, const struct verdict *found, double psi_f,
                        double dt, double w_off)
{
    const double length = sqrt(a->S0), last = length_of(a->chord);
    const double expected = psi_f * found->lagging_chord;
    const double sudden = psi_f * found->new_chord;
    const double slowest = psi_f * w_off * a->span;
    /* The means have a memory, the last chord has none: it must be long enough for a rotor that
     * turns, and fit the speed, otherwise a hard brake or a reversal is not detected. */
    return found->coherence >= COHERENCE && fabs(length - expected) <= LENGTH_TOL * expected &&
           fabs(found->turn) <= TURN_MAX && fabs(a->w) * dt <= STEP_TURN_MAX &&
           fabs(found->lagging) >= w_off * a->span && last >= (1.0 - LENGTH_TOL) * slowest &&
           fabs(last - sudden) <= LENGTH_TOL * sudden + slowest;
}

/* Evaluate the length of the chords: spread, flux, largest speed. */
static void judge_length(struct acquisition *a, const struct verdict *found, double psi_f)
{
    /* The logarithm is of 1e-12 to 1, so that the root is of a number from 0 to 56. */
    a->spread = sqrt(-2.0 * elementary_log(fmin(fmax(found->coherence, 1e-12), 1.0)));
    const double length = sqrt(a->S0); /* a mean of squares */
    a->psi = found->lagging_chord > 0.0 ? length / found->lagging_chord : (double)NAN;
    const double s = length / (2.0 * psi_f * (1.0 - LENGTH_TOL)); /* psi_f is above 0 */
    const double arc_sine = arc_tangent(s, sqrt(fmax((1.0 - s) * (1.0 + s), 0.0)));
    a->w_max = s < 1.0 ? 2.0 / a->span * arc_sine : HUGE_VAL;
}

/* Update angle and speed at the end of the last chord. */
static void follow_angle(struct acquisition *a, struct verdict *found, double _Complex before)
{
    const double turn = found->turn;
    const double _Complex half = unit_vector(0.5 * turn);
    found->new_chord = 2.0 * fabs(cimag(half));
    /* After a gap the mean is older than one chord: start from the chord before this one. */
    const double _Complex older = a->age < 1.5 * a->span ? a->turned_sum : before;
    a->turned_sum = FORGET_ANGLE * (older * half * half) + a->chord;
    const double quarter = turn >= 0.0 ? 0.5 * PI : -0.5 * PI;
    a->theta = wrap_angle(angle_of(a->turned_sum) - quarter + 0.5 * turn);
    a->w = turn / a->span;
    a->age = 0.0;
}

/* Process a pair of consecutive chords of equal duration: means, speed, angle, ready. */
static void add_pair(const struct pmsm *motor, struct acquisition *a, double _Complex before,
                     const struct acquisition_limits *limits, double dt)
{
    const double span = (double)a->paired_steps * dt; /* a chord has at least one step */
    const double _Complex pair = a->chord * conj(before);
    const double energy = 0.5 * (square_of(a->chord) + square_of(before));
    if (!update_means(a, pair, energy, span)) {
        a->pairs = 0;
        a->ready = 0;
        return;
    }
    struct verdict found = {.lagging = angle_of(a->S1)};
    found.turn = found.lagging + angle_of(a->S1 * conj(a->S2)) / FORGET;
    found.coherence = a->S0 > 0.0 ? length_of(a->S1) / a->S0 : 0.0;
    found.lagging_chord = 2.0 * fabs(sine(0.5 * found.lagging));
    follow_angle(a, &found, before);
    judge_length(a, &found, motor->psi_f);
    if (!is_plausible(a, &found, motor->psi_f, dt, limits->w_off)) {
        a->good = 0;
        a->ready = 0;
        return;
    }
    a->good += 1;
    if (a->good >= ACQUISITION_PAIRS && fabs(found.lagging) >= limits->w_on * span)
        a->ready = 1;
}

/* Choose the duration of the next chord by the turn of the last one; the last sample is one part of
 * it, of `steps` sub-steps. */
static void choose_stride(struct acquisition *a, int64_t steps)
{
    if (a->pairs < SETTLE_PAIRS)
        return;
    const int64_t now = a->paired_steps;
    if (fabs(a->w) * a->span > TURN_LONG && now > steps)
        a->stride = now / 2;
    else if (2 * now <= CHORD_STEPS)
        a->stride = a->w_max * a->span <= TURN_SHORT ? 2 * now : now;
}

static void add_sample(const struct filter_sample *sample, const struct pmsm *motor,
                       struct acquisition *a, const struct acquisition_limits *limits, double dt)
{
    const double tau = (double)sample->steps * dt, gap = (double)sample->gap * dt;
    const int plausible = size_of(sample->i) + size_of(sample->u) < IMPLAUSIBLE; /* false for NaN */
    a->age += gap + tau;
    if (!plausible || a->steps < 0 || gap > 0.0) {
        break_chord(a, plausible, sample->i, dt);
        return;
    }
    a->flux += (sample->u - 0.5 * motor->R_s * (a->i_last + sample->i)) * tau;
    a->i_last = sample->i;
    a->steps += sample->steps;
    if (a->steps < a->stride)
        return;
    const double _Complex before = a->chord;
    const int is_pair = a->paired_steps == a->steps;
    a->chord = a->flux - motor->L_s * (sample->i - a->i_start);
    a->paired_steps = a->steps;
    a->i_start = sample->i;
    a->flux = 0.0;
    a->steps = 0;
    if (is_pair) {
        add_pair(motor, a, before, limits, dt);
        choose_stride(a, sample->steps);
    }
}

void acquisition_add(const struct filter_sample *samples, int m, const struct pmsm *motors,
                     struct acquisition *drives, const struct acquisition_limits *limits, double dt)
{
    for (int k = 0; k < m; k++) {
        const int64_t d = samples[k].drive;
        add_sample(&samples[k], &motors[d], &drives[d], limits, dt);
    }
}

double acquisition_theta(const struct acquisition *drive)
{
    return wrap_angle(drive->theta + drive->w * drive->age);
}

void acquisition_start_filter(const struct acquisition *drive, const struct pmsm *motor,
                              const double *R, double T_rated, struct filter *filter)
{
    const double theta = acquisition_theta(drive);
    const double _Complex i = drive->i_last;
    /* Three standard deviations of the chords, a tenth of the value, and a floor. */
    const double spread = drive->ready ? drive->spread : 1.0;
    const double span = drive->ready ? drive->span : 1.0; /* above 0 where ready */
    const double deviation_w = 5.0 + 0.1 * fabs(drive->w) + 0.3 * spread / span;
    const double deviation_theta = 0.1 + spread;
    /* Paper `adhesion`, eq. (11): T_e = k_p p psi_f i_q. */
    const double i_q = cimag(i * unit_vector(-theta));
    const double T_e = motor->k_p * motor->p * motor->psi_f * i_q;
    const double x[5] = {creal(i), cimag(i), drive->w, theta, T_e};
    const double variance[5] = {R[0], R[1], deviation_w * deviation_w,
                                deviation_theta * deviation_theta, T_rated * T_rated};
    for (size_t j = 0; j < 5; j++) {
        filter->x[j] = x[j];
        for (size_t k = 0; k < 5; k++)
            filter->P[j][k] = j == k ? variance[j] : 0.0;
    }
}

int acquisition_check(const struct acquisition *drive, const struct filter *filter)
{
    const double *x = filter->x;
    const double w = x[2], theta = x[3];
    if (!isfinite(x[0] + x[1] + w + theta + x[4]))
        return INCONSISTENT;
    if (drive->ready) {
        const double turn = wrap_angle(theta - acquisition_theta(drive));
        const int same_w = fabs(w - drive->w) <= W_TOL + W_TOL_RELATIVE * fabs(drive->w);
        return same_w && fabs(turn) <= THETA_TOL ? CONSISTENT : INCONSISTENT;
    }
    const int runaway =
        drive->pairs >= ACQUISITION_PAIRS && fabs(w) > drive->w_max + STANDSTILL_TOL;
    return runaway ? INCONSISTENT : CONSISTENCY_UNKNOWN;
}
