/* Loss of all drives at once, which no comparison of drives detects: by loads and commands.
 *
 * The drives are those that adhere relative to the others. Two criteria, of which the more probable
 * one counts:
 *
 * - Each: every drive stays behind its own command. The noise of one drive is enough to hide this.
 * - Mean: what n drives are missing of the load that they must carry, on average. Its noise is
 *   smaller by the root of n; an error that all loads share is not. A drive that is missing far more
 *   than the median is limited: one wrong command is no loss of all. As for one drive
 *   (command_response.c), loads may follow commands that have not been received yet: the deficit
 *   counts once every drive has sent a later command.
 *
 * Nothing here can fail: means are those of at least two drives, their variance is above 0 because
 * that of each drive is, the workspace has room for all drives. Comparisons with NaN are false, the
 * safe answer. */
#include "gateway/core/common_loss.h"

#include <math.h>

#include "estimators/elementary.h"
#include "estimators/numbers.h"
#include "estimators/order_statistics.h"

#define COUNTS 0.5 /* least probability of adhering of a drive that counts, and of a loss of them */
#define SHARED_ERROR 0.03 /* of all loads, as a share of the command: data sheet, inertia */
#define MOST_MISSING 2.0  /* standard deviations by which a drive is missing more than the median */
#define STANDS       0.9  /* probability of a deficit that is real: less may be noise */
#define LAG_S        0.01 /* a command sent so long after a deficit is later than its cause */
#define SQRT_HALF    (1.0 / 1.4142135623730951)

/* Sums over the drives that count, per unit of rated torque. */
struct sums {
    struct ranking missing; /* what each is missing; their number is that of the drives */
    double command;
    double variance; /* of what is missing */
    double oldest_s; /* age of the oldest command, s */
    double each;     /* least probability of a loss; infinite if there are no drives */
};

static void add_drive(const struct adhesion *a, int k, struct sums *sums)
{
    const struct command_response *r = &a->responses[k];
    sums->each = smaller(a->loads[k].p_response, sums->each);
    if (a->rotors[k].odd_s > 0.0)
        return; /* an odd command is no evidence */
    ranking_add(&sums->missing, r->missing);
    sums->command += fabs(r->command);
    sums->variance += square(r->missing_sigma);
    sums->oldest_s = larger(sums->oldest_s, r->command_age_s);
}

/* Sums over the drives that count; of none if one of them, or any load, cannot be judged. */
static struct sums sum_up(const struct adhesion *a)
{
    const struct sums none = {.missing.numbers = a->workspace, .each = HUGE_VAL};
    struct sums sums = none;
    for (int k = 0; k < a->n; k++) {
        if (!a->known[k])
            continue;
        if (!a->responses[k].usable)
            return none;
        if (!(a->switching->adhering[k] > COUNTS))
            continue;
        if (!a->loads[k].response_valid)
            return none;
        add_drive(a, k, &sums);
    }
    return sums;
}

/* What a drive is missing on average. */
static double mean_missing(const struct sums *sums)
{
    const struct ranking *all = &sums->missing;
    sort_ascending(all->numbers, all->count);
    const double sigma = sqrt(sums->variance / all->count);
    const double most = median_of_others(all, NAN, 0) + MOST_MISSING * sigma;
    double total = 0.0;
    for (int i = 0; i < all->count; i++)
        total += smaller(all->numbers[i], most);
    return total / all->count;
}

/* Probability that the mean load is too small; 0 for a drive alone. */
static double mean_deficit(const struct sums *sums)
{
    const double n = sums->missing.count;
    if (n < 2.0)
        return 0.0;
    const double shared = SHARED_ERROR * sums->command / n;
    const double sigma = sqrt(sums->variance / (n * n) + square(shared));
    return 0.5 * elementary_erfc(-mean_missing(sums) / sigma * SQRT_HALF);
}

double follow_common_loss(struct adhesion *a)
{
    const struct sums sums = sum_up(a);
    const double each = sums.each >= COUNTS && sums.each <= 1.0 ? sums.each : 0.0;
    const double mean = mean_deficit(&sums);
    a->common_missing_s = mean > STANDS ? a->common_missing_s + a->tick_s : 0.0;
    /* First seen in this tick, it may be a tick old, and the lag of the filters adds to that. */
    const int confirmed = sums.oldest_s + LAG_S + a->tick_s <= a->common_missing_s;
    return confirmed ? larger(mean, each) : each;
}
