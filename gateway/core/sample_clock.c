/* When samples were taken: how late each one came, and whether the sender has left some out.
 *
 * The counter says how many periods lie between two samples; the earliest ones show when they were
 * due. What comes later was delayed by the sender, its bus or a machine - or the sender has left
 * samples out without counting them: then the filter would turn the rotor too little. The voltage
 * decides: it turns with the rotor, for each period as far as for those before.
 *
 * Not in paper `adhesion`. No function here can fail: lateness stays between 0 and `max_gap_ns`, a
 * period is at least 1 ns, `cycles` at least 1, and a voltage that is not finite makes every
 * comparison false. */
#include "gateway/core/sample_clock.h"

#include "estimators/vectors.h"

enum { WARM = 16 };      /* samples before a lateness is unusual */
enum { FOLLOW = 256 };   /* the clock follows the sender's by this part of the lateness, */
enum { FORGET = 64 };    /* and the usual lateness shrinks by this part of itself, per sample */
enum { MEAN = 64 };      /* samples over which the period is averaged */
enum { OFF = 8 };        /* off by this part the mean period is another than the DBC says */
enum { MOST = 8 };       /* periods between two samples whose turn still says something */
#define TURN_FORGET 0.25 /* of the mean turn of a period, per sample */
#define LEAST_TURN  0.05 /* rad per period; with less nothing is thrown */
#define TURN_FITS   0.35 /* of the turn of a period: it fits */

void start_sample_clock(struct sample_clock *clock, const double *u, int64_t period_ns)
{
    *clock = (struct sample_clock){.mean_ns = period_ns, .u = {u[0], u[1]}};
}

/* Lateness of a sample that comes so long and so many periods after the one before. */
static int64_t lateness(const struct sample_clock *clock, int64_t passed_ns, int64_t due_ns,
                        int64_t max_gap_ns)
{
    const int64_t late_ns = clock->late_ns + passed_ns - due_ns;
    if (late_ns < 0)
        return 0;
    return late_ns < max_gap_ns ? late_ns : max_gap_ns;
}

/* Whole periods by which a sample is later than usual; 0: not even one. */
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

/* Periods left out before a sample that is so many of its counter after the one before and late. */
static int64_t left_out(const struct sample_clock *clock, double _Complex turn, int64_t cycles,
                        int64_t late)
{
    if (late == 0 || cycles + late > MOST || fits(clock, turn, cycles))
        return 0;
    return fits(clock, turn, cycles + late) ? late : 0;
}

/* Note a lateness. Of a sender that does not keep the period nobody knows when samples were due. */
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

/* Note the voltage and, of two samples that follow one another, how far it turned. */
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
