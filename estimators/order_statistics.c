/* Sorting and medians without own memory. */
#include "estimators/order_statistics.h"

#include <math.h>

/* Shell sort: few steps for 1,000 numbers, and no additional memory. */
void sort_ascending(double *values, int n)
{
    int gap = 1;
    while (gap < n / 3)
        gap = 3 * gap + 1;
    for (; gap > 0; gap /= 3) {
        for (int k = gap; k < n; k++) {
            const double value = values[k];
            int place = k;
            for (; place >= gap && values[place - gap] > value; place -= gap)
                values[place] = values[place - gap];
            values[place] = value;
        }
    }
}

double median_in_place(double *values, int n)
{
    sort_ascending(values, n);
    const double above = values[n / 2];
    return n % 2 ? above : (values[n / 2 - 1] + above) / 2.0;
}

struct middle_pair middle_of_others(const double *sorted, int others, double own)
{
    const int low = (others - 1) / 2, high = others / 2;
    /* From the index of the number that is left out, the others are one place further. */
    return (struct middle_pair){
        .below = sorted[low + (sorted[low] >= own)],
        .above = sorted[high + (sorted[high] >= own)],
    };
}

void ranking_add(struct ranking *ranking, double x)
{
    if (!isnan(x))
        ranking->numbers[ranking->count++] = x;
}

double median_of_others(const struct ranking *ranking, double own, int upper)
{
    const int others = ranking->count - !isnan(own);
    if (others < 1)
        return NAN;
    const struct middle_pair middle = middle_of_others(ranking->numbers, others, own);
    return upper ? middle.above : middle.below;
}
