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
/* Samples in a row without current, while another motor is driven, after which a motor is cut out.
 * The mean alone would show it after minutes. Until then its cooling looks like a fault. */
enum { IDLE_SAMPLES = 20 };

/* Square of a motor's current in a sample, limited; NaN: not known. */
static double square_of(const struct cut_out_config *config, const struct thermal_input *input)
{
    const double most = MOST * MOST * config->driven_square;
    return input->current_square > most ? most : input->current_square;
}

/* Count the samples in a row in which a motor has no current; those in which none is driven do not
 * count. */
static void count_idle(const struct cut_out_config *config, const struct thermal_input *input,
                       int motors, struct motor_current *current)
{
    double largest = 0.0;
    for (int m = 0; m < motors; m++)
        if (square_of(config, &input[m]) > largest)
            largest = square_of(config, &input[m]);
    if (!(largest > config->driven_square))
        return;
    for (int m = 0; m < motors; m++) {
        const double sample = square_of(config, &input[m]);
        if (sample < config->share * largest)
            current[m].idle += current[m].idle < IDLE_SAMPLES;
        else if (isfinite(sample))
            current[m].idle = 0;
    }
}

void find_cut_out(const struct cut_out_config *config, const struct thermal_input *input,
                  int motors, struct motor_current *current)
{
    double largest = 0.0;
    count_idle(config, input, motors, current);
    for (int m = 0; m < motors; m++) {
        if (!isfinite(input[m].current_square))
            continue;
        current[m].square += config->weight * (square_of(config, &input[m]) - current[m].square);
        largest = larger(current[m].square, largest);
    }
    if (!(largest > config->driven_square))
        return;
    for (int m = 0; m < motors; m++)
        current[m].cut_out =
            current[m].idle >= IDLE_SAMPLES || current[m].square < config->share * largest;
}
