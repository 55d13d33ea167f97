/* Rounding to whole numbers, the same on every machine. */
#ifndef TRACTION_ROUNDING_H
#define TRACTION_ROUNDING_H

#include <math.h>
#include <stdint.h>

#define TWO_52 4503599627370496.0    /* 2^52 */
#define TWO_63 9223372036854775808.0 /* 2^63 */

/* Nearest whole number; halves are rounded to even. |x| < 2^63, so the conversion is exact. */
static inline int64_t round_half_even(double x)
{
    const double shift = copysign(TWO_52, x); /* added to x, it leaves a double no bits below 1 */
    return (int64_t)(fabs(x) < TWO_52 ? x + shift - shift : x);
}

#endif
