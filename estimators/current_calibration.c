/* Offsets and gain mismatch of the current sensors, learnt while the rotor turns.
 *
 * In healthy steady state the currents are one rotating vector, i = I e^(j theta) in the stationary
 * frame (complex alpha + j beta). To first order in their errors, the sensors measure
 *     z = i + n conj(i) + o        o: offset; n: image, from gains that differ between the phases
 * (a gain error common to all phases shows only in the load, whose ratio is learnt). Over full
 * revolutions i, i^2 and conj(i) have the mean zero, so
 *     o = <z>,   n = (<z^2> - o^2) / (2 (<|z|^2> - |o|^2)).
 * The means are weighted by a triangle over two revolutions, so that a current that grows or fades
 * linearly has no effect. Two revolutions count if their mean squares agree: a step of the load
 * would look like an offset. Errors larger than those of sensors are not learnt: an open phase is
 * a fault, no gain error. With two sensors (CAN FD), gains d apart make |n| = d / sqrt(3);
 * uncorrected, the load ripples with twice the electrical frequency. Not in paper `adhesion`.
 *
 * With an open phase the current oscillates on one line: |<z^2 / |z|^2>| is 1, not 0. This needs no
 * model and few samples per revolution, so it is also checked at speeds that filters do not reach.
 *
 * No function here can fail: sums take no number beyond any motor, and each divisor is a constant
 * or has a comment that shows why it is above 0. */
#include "estimators/current_calibration.h"

#include <math.h>

#include "estimators/vectors.h"

enum { REVOLUTIONS = 16 }; /* memory in the long run; until then a plain mean */
static const double TWO_PI = 0x1.921fb54442d18p+2;
static const double STEP_MAX = 0.63;   /* rad between two samples: ten a revolution */
static const double STEADY = 0.1;      /* relative change of the mean square in a revolution */
static const double LEAST = 0.2;       /* of rated current; with less, noise hides the image */
static const double OFFSET_MAX = 0.05; /* of rated current; more is a fault */
static const double IMAGE_MAX = 0.08;  /* larger is a fault, too */
static const double VARIANCE_MIN =
    0.5;                            /* of the mean square; the rest is an offset, whose square is
                                         * less than a tenth where it may be learnt */
static const double APPLY_S = 0.05; /* what is applied follows what is learnt: a step would look
                                         * like one of the load */

static const double LINE_S = 0.012;   /* time constant of the mean by which a line shows */
static const double LINE_TURN = 3.0;  /* least angle, rad, that the rotor turns in that time */
static const double LINE_STEP = 2.5;  /* rad between two samples; at pi all lie on a line */
static const double LINE_LEAST = 0.1; /* of rated current; with less, offsets form a line */
static const double ON_LINE = 0.5;  /* mean of e^(2j angle): 1 on a line, at most 1/6 if it turns */
static const double OFF_LINE = 0.3; /* below this the current turns again */
static const double ENOUGH = 0.75;  /* share of samples with enough current for a decision */

/* The current corrected by the known errors. */
static double _Complex corrected(struct current_calibration *c, double _Complex z, double passed)
{
    const double near = fmin(passed / APPLY_S, 1.0);
    c->offset_applied += near * (c->offset - c->offset_applied);
    c->image_applied += near * (c->image - c->image_applied);
    const double _Complex n = c->image_applied;
    const double _Complex centred = z - c->offset_applied;
    return (centred - n * conj(centred)) / (1.0 - square_of(n)); /* |n| <= IMAGE_MAX */
}

/* Update the measure of whether the current turns or stays on a line. Small currents count less. */
static void update_ellipticity(struct current_calibration *c, double _Complex z, double passed,
                               double least)
{
    const double near = fmin(passed / LINE_S, 1.0);
    const double square = square_of(z);
    const double whole = fmax(square, least * least); /* above 0, as rated current is */
    c->line += near * (z * z / whole - c->line);
    c->seen += near * (square / whole - c->seen);
    c->step_s = passed;
}

static void start_revolution(struct current_calibration *c)
{
    c->turned = 0.0;
    c->sum_uniform = (struct revolution_sums){0};
    c->sum_ramp = (struct revolution_sums){0};
}

static void add_to(struct revolution_sums *sums, double _Complex z, double weight)
{
    sums->z += weight * z;
    sums->z2 += weight * z * z;
    sums->abs2 += weight * square_of(z);
}

static void add_angle(struct current_calibration *c, double _Complex z, double angle)
{
    const double ramp = angle * (c->turned + 0.5 * angle) / TWO_PI;
    c->turned += angle;
    add_to(&c->sum_uniform, z, angle);
    add_to(&c->sum_ramp, z, ramp);
}

/* Learn from this revolution and the one before, if both are complete and alike. */
static void finish_revolution(struct current_calibration *c, double I_rated)
{
    const struct revolution_sums *up = &c->ramp_before, *all = &c->sum_uniform,
                                 *down = &c->sum_ramp;
    const double now = all->abs2 / TWO_PI;
    const double last = c->mean_square;
    c->mean_square = now;
    if (!(now >= LEAST * I_rated * (LEAST * I_rated) && fabs(now - last) <= STEADY * last))
        return;
    /* Up over the revolution before, down over this one: a triangle of area 2 pi. */
    const double _Complex o = (up->z + all->z - down->z) / TWO_PI;
    const double _Complex z2 = (up->z2 + all->z2 - down->z2) / TWO_PI;
    const double abs2 = (up->abs2 + all->abs2 - down->abs2) / TWO_PI;
    const double variance = abs2 - square_of(o);
    /* A current that has not turned has none, except for rounding of the sums: held samples. */
    if (!(variance > VARIANCE_MIN * abs2))
        return;
    const double _Complex n = 0.5 * (z2 - o * o) / variance; /* above half of a mean square */
    if (!(length_of(o) <= OFFSET_MAX * I_rated && length_of(n) <= IMAGE_MAX))
        return;
    c->turns = c->turns < REVOLUTIONS ? c->turns + 1 : REVOLUTIONS;
    c->offset += (o - c->offset) / (double)c->turns; /* 1 or more */
    c->image += (n - c->image) / (double)c->turns;
}

/* Learn from a sample in which the rotor turned by `step` rad; 0: not known, or not complete. */
static void learn(struct current_calibration *c, double _Complex z, double step, double I_rated)
{
    if (!(0.0 < step && step <= STEP_MAX)) {
        start_revolution(c);
        c->mean_square = 0.0;
        return;
    }
    const double left = TWO_PI - c->turned;
    add_angle(c, z, fmin(step, left));
    if (step >= left) {
        finish_revolution(c, I_rated);
        c->ramp_before = c->sum_ramp;
        start_revolution(c);
        add_angle(c, z, step - left);
    }
}

void calibrate_currents(struct filter_sample *samples, int m, struct current_calibration *drives,
                        const struct acquisition *chords, const double *I_rated, double dt)
{
    for (int k = 0; k < m; k++) {
        struct filter_sample *sample = &samples[k];
        const int64_t d = sample->drive;
        const double _Complex z = sample->i;
        const double tau = (double)sample->steps * dt;
        const int plausible = size_of(z) < IMPLAUSIBLE; /* false for NaN */
        sample->i = corrected(&drives[d], z, tau);
        if (plausible) {
            const double passed = (double)(sample->steps + sample->gap) * dt;
            update_ellipticity(&drives[d], z, passed, LINE_LEAST * I_rated[d]);
        }
        const int whole = plausible && sample->gap == 0 && chords[d].ready;
        learn(&drives[d], z, whole ? fabs(chords[d].w) * tau : 0.0, I_rated[d]);
    }
}

int is_single_axis_current(struct current_calibration *drive, double w_e)
{
    const double slow = LINE_TURN / LINE_S, fast = LINE_STEP / fmax(drive->step_s, 1e-9);
    if (slow <= fabs(w_e) && fabs(w_e) <= fast && drive->seen >= ENOUGH) {
        const double limit = drive->single_axis ? OFF_LINE : ON_LINE;
        drive->single_axis = length_of(drive->line) > limit * drive->seen;
    }
    return drive->single_axis;
}
