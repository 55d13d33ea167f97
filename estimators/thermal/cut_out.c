/* Which motors are cut out: another is driven, and these turn without current. Such a motor is heated
 * by its iron and its bearings alone. Its model does not explain that, and beside it the driven
 * motors would be hot.
 *
 * Nothing here can fail: sums and products of doubles, and comparisons with NaN are false. */
#include "estimators/thermal/cut_out.h"

#include <math.h>

#include "estimators/numbers.h"

/* A sample counts for at most so many times the least current of a driven motor: one wrong reading
 * cuts out no other motor that is driven. */
static const double MOST = 100.0;

void find_cut_out(const struct cut_out_config *config, const struct thermal_input *input,
                  int motors, struct motor_current *current)
{
    double largest = 0.0;
    for (int m = 0; m < motors; m++) {
        if (!isfinite(input[m].current_square))
            continue;
        const double sample = smaller(input[m].current_square, MOST * MOST * config->driven_square);
        current[m].square += config->weight * (sample - current[m].square);
        largest = larger(current[m].square, largest);
    }
    if (!(largest > config->driven_square))
        return;
    for (int m = 0; m < motors; m++)
        current[m].cut_out = current[m].square < config->share * largest;
}
