/* Delay of each sample, and samples that the sender has left out.
 *
 * The counter gives the number of periods between two samples; the earliest samples show when they
 * were due. A later sample was delayed by the sender, its bus or a machine - or the sender has left
 * samples out without counting them: then the filter would turn the rotor too little. The voltage
 * decides: it turns with the rotor, in each period by as much as in those before.
 *
 * Not in paper `adhesion`. No function here can fail: the delay stays between 0 and `max_gap_ns`, a
 * period is at least 1 ns, `cycles` at least 1, and a voltage that is not finite makes every
 * comparison false. */
#include "gateway/core/sample_clock.h"

#include "estimators/vectors.h"

enum { WARM = 16 };      /* samples before a delay can be unusual */
enum { FOLLOW = 256 };   /* the clock follows the sender's by this part of the delay, */
enum { FORGET = 64 };    /* and the usual delay shrinks by this part of itself, per sample */
enum { MEAN = 64 };      /* samples over which the period is averaged */
enum { OFF = 8 };        /* if the mean period is off by this part, it is not that of the DBC */
enum { MOST = 8 };       /* most periods between two samples for their turn to have a meaning */
#define TURN_FORGET 0.25 /* share of the mean turn of a period that a sample replaces */
#define LEAST_TURN  0.05 /* rad per period; with less no sample is found left out */
#define TURN_FITS   0.35 /* share of a period's turn within which a turn fits */

void start_sample_clock(struct sample_clock *clock, const double *u, int64_t period_ns)
{
    *clock = (struct sample_clock){.mean_ns = period_ns, .u = {u[0], u[1]}};
}

/* Delay of a sample that comes so long and so many periods after the one before. */
static int64_t lateness(const struct sample_clock *clock, int64_t passed_ns, int64_t due_ns,
                        int64_t max_gap_ns)
{
    const int64_t late_ns = clock->late_ns + passed_ns - due_ns;
    if (late_ns < 0)
        return 0;
    return late_ns < max_gap_ns ? late_ns : max_gap_ns;
}

/* Whole periods by which a sample is later than usual; 0: less than one. */
static int64_t periods_late(const struct sample_clock *clock, int64_t late_ns, int64_t period_ns)
{
    if (clock->samples < WARM || late_ns - clock->usual_ns <= 3 * period_ns / 4)
        return 0;
    return (late_ns + period_ns / 4) / period_ns;
}

/* 1 if the voltage has turned as in so many periods; `turn`: its product with the one before. */
static int fits(const struct sample_clock *clock, double _Complex turn, int64_t periods)
{
    const double each = angle_of(vector_of(clock->turn[0], clock->turn[1]));
    const double off = angle_of(turn * unit_vector(-each * (double)periods));
    return fabs(each) > LEAST_TURN && fabs(off) < TURN_FITS * fabs(each);
}

/* Periods left out before a late sample that is `cycles` of its counter after the one before. */
static int64_t left_out(const struct sample_clock *clock, double _Complex turn, int64_t cycles,
                        int64_t late)
{
    if (late == 0 || cycles + late > MOST || fits(clock, turn, cycles))
        return 0;
    return fits(clock, turn, cycles + late) ? late : 0;
}

/* Note a delay. If the sender does not keep the period, it is not known when samples were due. */
static void note_lateness(struct sample_clock *clock, int64_t late_ns, int64_t period_ns)
{
    const int64_t off_ns = clock->mean_ns - period_ns;
    const int steady = off_ns < period_ns / OFF && off_ns > -period_ns / OFF;
    clock->late_ns = steady ? late_ns - late_ns / FOLLOW : 0;
    clock->usual_ns -= clock->usual_ns / FORGET;
    if (clock->usual_ns < clock->late_ns)
        clock->usual_ns = clock->late_ns;
    clock->samples += clock->samples < WARM;
}

/* Note the voltage and, if two samples are consecutive, how far it has turned. */
static void note_voltage(struct sample_clock *clock, const double *u, double _Complex turn,
                         int follows)
{
    clock->u[0] = u[0];
    clock->u[1] = u[1];
    if (!follows)
        return;
    clock->turn[0] += TURN_FORGET * (creal(turn) - clock->turn[0]);
    clock->turn[1] += TURN_FORGET * (cimag(turn) - clock->turn[1]);
}

int64_t step_sample_clock(struct sample_clock *clock, const double *u, int64_t passed_ns,
                          int64_t cycles, int64_t period_ns, int64_t max_gap_ns)
{
    const int64_t due_ns = cycles * period_ns;
    const int64_t late_ns = lateness(clock, passed_ns, due_ns, max_gap_ns);
    const int64_t late = periods_late(clock, late_ns, period_ns);
    const double _Complex turn = vector_of(u[0], u[1]) * conj(vector_of(clock->u[0], clock->u[1]));
    const int64_t periods = left_out(clock, turn, cycles, late);
    const int64_t without_ns = passed_ns - periods * period_ns;
    clock->mean_ns += (without_ns / cycles - clock->mean_ns) / MEAN;
    note_lateness(clock, lateness(clock, without_ns, due_ns, max_gap_ns), period_ns);
    note_voltage(clock, u, turn, cycles == 1 && periods == 0);
    return periods;
}
