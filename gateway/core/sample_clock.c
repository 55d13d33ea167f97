/* When samples were due, by their stamps: a delayed sample, or one before it that was left out?
 *
 * The counter says how many periods lie between two samples. A sender that leaves samples out
 * without counting them breaks that: the filter would turn the rotor too little. Stamps show it: all
 * samples from there on come a period later. After a delay the next ones are in time again, so that
 * a sample that comes a period later than is usual waits for the next one.
 *
 * No function here can fail: lateness stays between 0 and `max_gap_ns`, a period is at least 1 ns. */
#include "gateway/core/sample_clock.h"

enum { WARM = 16 };    /* samples before a lateness is unusual */
enum { FOLLOW = 256 }; /* the clock follows the sender's by this part of the lateness, */
enum { FORGET = 64 };  /* and the usual lateness shrinks by this part of itself, per sample */
enum { QUARTERS = 3 }; /* quarters of a period beyond the usual lateness: out of time */

static int64_t larger(int64_t a, int64_t b)
{
    return a > b ? a : b;
}

static int64_t smaller(int64_t a, int64_t b)
{
    return a < b ? a : b;
}

void start_sample_clock(struct sample_clock *clock)
{
    clock->late_ns = 0;
    clock->usual_ns = 0;
    clock->samples = 0;
    clock->waits = 0;
}

int is_out_of_time(const struct sample_clock *clock, int64_t period_ns)
{
    return clock->samples >= WARM && clock->late_ns - clock->usual_ns > QUARTERS * period_ns / 4;
}

/* Periods left out before the waiting sample, now that this late the next one came. */
static int64_t left_out(const struct sample_clock *clock, int64_t late_ns, int64_t period_ns)
{
    if (!clock->waits)
        return 0;
    const int64_t steady = larger(period_ns / 4, clock->usual_ns);
    if (late_ns < clock->late_ns - steady)
        return 0;
    return (smaller(late_ns, clock->late_ns) + period_ns / 4) / period_ns;
}

int64_t step_sample_clock(struct sample_clock *clock, int64_t passed_ns, int64_t cycles,
                          int64_t period_ns, int64_t max_gap_ns)
{
    int64_t late_ns = larger(clock->late_ns + passed_ns - cycles * period_ns, 0);
    late_ns = smaller(late_ns, max_gap_ns);
    const int64_t periods = left_out(clock, late_ns, period_ns);
    late_ns = larger(late_ns - periods * period_ns, 0);
    clock->late_ns = late_ns - late_ns / FOLLOW;
    clock->samples += clock->samples < WARM;
    if (!is_out_of_time(clock, period_ns))
        clock->usual_ns = larger(clock->usual_ns - clock->usual_ns / FORGET, clock->late_ns);
    return periods;
}
