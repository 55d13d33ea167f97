/* Small functions of numbers. */
#ifndef TRACTION_NUMBERS_H
#define TRACTION_NUMBERS_H

static inline double square(double x)
{
    return x * x;
}

/* The larger of two; y if x is NaN. */
static inline double larger(double x, double y)
{
    return x > y ? x : y;
}

/* The smaller of two; y if x is NaN. */
static inline double smaller(double x, double y)
{
    return x < y ? x : y;
}

/* x limited to `low` to `high`; NaN for NaN. */
static inline double clamp(double x, double low, double high)
{
    if (x < low)
        return low;
    return x > high ? high : x;
}

#endif
