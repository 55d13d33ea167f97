/* Residual of one motor's peers, the other motors of a train: their median. The fault itself would
 * pull a mean; weather and duty that the model does not include are the same for all.
 *
 * Nothing here can fail: ranks are below the count of the numbers that they index, as at least one
 * other motor is left wherever a middle is looked up. */
#include "estimators/thermal/peers.h"

#include <math.h>

#include "estimators/order_statistics.h"
#include "gateway/core/records.h"

static const double TWO_APART_K = 3.0; /* K, twice the usual effect of dirt and wear of a sensor */

/* Motors that are compared with, at one point. */
struct comparison {
    int motors;    /* number of motors of the train */
    int everybody; /* 1: motors that are not trusted are included */
    int needed;    /* least number of others that a motor needs */
    int count;     /* number of motors that are compared with */
};

static struct comparison whom(const double *u, const uint8_t *trusted, int motors)
{
    const int least = motors - 1 < 2 ? motors - 1 : 2;
    int seen = 0, good = 0;
    for (int m = 0; m < motors; m++) {
        const int here = isfinite(u[(int64_t)m * THERMAL_POINTS]) != 0;
        seen += here;
        good += here && trusted[m];
    }
    /* Of three motors two are left beside a suspect: each is compared with the other. */
    const int three = good == least && seen == least + 1;
    struct comparison out = {.motors = motors, .needed = three ? 1 : least};
    out.everybody = (good <= least && least < seen && !three) || good < least;
    out.count = out.everybody ? seen : good;
    return out;
}

/* Reference of a motor that reads `own`, which is among the `count` sorted numbers if inside. */
static double reference(const struct comparison *with, const double *sorted, double own, int inside)
{
    const int others = with->count - inside;
    if (with->motors == 1)
        return 0.0;
    if (others < with->needed)
        return NAN;
    const struct middle_pair middle = middle_of_others(sorted, others, inside ? own : NAN);
    /* Three motors, all trusted, two of them far apart: one is faulty. The mean of the two would
     * make a healthy third seem faulty the other way round. The one nearer to the model counts. */
    if (with->motors == 3 && others == 2 && middle.above - middle.below > TWO_APART_K)
        return fabs(middle.above) < fabs(middle.below) ? middle.above : middle.below;
    return 0.5 * (middle.below + middle.above);
}

void peers_median(const double *u, const uint8_t *trusted, int motors, double *workspace,
                  double *out)
{
    for (int q = 0; q < THERMAL_POINTS; q++) {
        const struct comparison with = whom(u + q, trusted, motors);
        int n = 0;
        for (int m = 0; m < motors; m++) {
            const double here = u[m * THERMAL_POINTS + q];
            if (isfinite(here) && (with.everybody || trusted[m]))
                workspace[n++] = here;
        }
        sort_ascending(workspace, n);
        for (int m = 0; m < motors; m++) {
            const double own = u[m * THERMAL_POINTS + q];
            const int inside = isfinite(own) && (with.everybody || trusted[m]);
            out[m * THERMAL_POINTS + q] = reference(&with, workspace, own, inside);
        }
    }
}
