/* Window averages of the motors' temperatures, and MAISD of them.
 *
 * Nothing here can fail: sums and differences of doubles, and comparisons with NaN are false. */
#include "gateway/core/temperature_window.h"

#include <math.h>

#include "estimators/maisd.h"
#include "estimators/numbers.h"

enum { P = THERMAL_POINTS };

static const double FAR_K = 40.0; /* K above the others: no motor beside sound ones starts there */

/* Deviation that two ways of centring agree on: the smaller one, 0 if they differ in sign. */
static double smaller_deviation(double a, double b)
{
    if ((a > 0.0) != (b > 0.0))
        return isnan(a) ? a : 0.0;
    return fabs(b) < fabs(a) ? b : a;
}

/* Differences of healthy motors come from their places and their cooling, and take hours to
 * develop. After a hot restart, or a night, motors are equally warm, and their readings are equal.
 * A sound motor is anywhere in between. */
static void compare_motors(struct temperature_window *w, int drives)
{
    maisd_compare(w->mean, w->compared, drives, P, w->ranked, w->spread, w->uniform);
    maisd_compare(w->centred, w->compared, drives, P, w->ranked, w->spread, w->deviation);
    for (int c = 0; c < drives * P; c++)
        w->deviation[c] = smaller_deviation(w->deviation[c], w->uniform[c]);
}

/* Average the window and centre the means. */
static void average(struct temperature_window *w, int cells)
{
    maisd_average(w->ring, w->samples, cells, w->mean, w->number, w->known);
    for (int c = 0; c < cells; c++) {
        const double apart = w->mean[c] - w->offset_k[c];
        w->known[c] = w->known[c] && w->valid[c];
        /* A sensor that did not change while the fleet was learnt has gain 0. */
        w->centred[c] = w->gain[c] != 0.0 ? apart / w->gain[c] : apart * INFINITY;
    }
}

/* Lowest centred mean of point k among the motors that are compared; infinite if there is none. */
static double coolest(const struct temperature_monitor *all, int k)
{
    double found = INFINITY;
    for (int j = 0; j < all->drive_count; j++)
        if (all->window.known[j * P + k] && !all->motors[j].left_out)
            found = smaller(all->window.centred[j * P + k], found);
    return found;
}

/* 1 if a point of motor j is known, and none is below its least value. */
static int is_warm(const struct temperature_window *w, int j, const double *least)
{
    int known = 0, colder = 0;
    for (int k = 0; k < P; k++) {
        known |= w->known[j * P + k];
        colder |= w->known[j * P + k] && w->centred[j * P + k] < least[k];
    }
    return known && !colder;
}

/* A motor that is cut out is colder than the driven ones, which would be hot beside it. Once driven
 * again it is compared when it is as warm as the coolest of them, less the limit. */
static void leave_out(struct temperature_monitor *all)
{
    const struct temperature_window *w = &all->window;
    double least[P];
    for (int k = 0; k < P; k++)
        least[k] = coolest(all, k) - w->apart_k[k];
    for (int j = 0; j < all->drive_count; j++) {
        struct motor_temperatures *motor = &all->motors[j];
        motor->left_out = all->currents[j].cut_out || (motor->left_out && !is_warm(w, j, least));
        for (int k = 0; k < P; k++)
            w->compared[j * P + k] = w->known[j * P + k] && !motor->left_out;
    }
}

void advance_window(struct temperature_monitor *all)
{
    struct temperature_window *w = &all->window;
    const int cells = all->drive_count * P;
    maisd_push(w->ring, w->samples, cells, all->cycles, w->value, w->valid);
    average(w, cells);
    leave_out(all);
    compare_motors(w, all->drive_count);
}

void note_near(struct temperature_monitor *all)
{
    struct temperature_window *w = &all->window;
    int fresh = 0;
    for (int c = 0; c < all->drive_count * P; c++)
        fresh |= w->valid[c] && !all->sensors[c / P].sensor[c % P].near;
    if (!fresh)
        return;
    double spread[P];
    maisd_compare(w->value, w->valid, all->drive_count, P, w->ranked, spread, w->uniform);
    for (int c = 0; c < all->drive_count * P; c++)
        all->sensors[c / P].sensor[c % P].near |= w->uniform[c] < FAR_K;
}
