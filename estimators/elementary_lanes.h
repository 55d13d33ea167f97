/* exp, log and log Gamma of lanes: the series of elementary.c, in another order. Not for cffi.
 *
 * Nothing here can fail: bits are shifted, never used as indices; a divisor of 0 gives infinity. */
#ifndef TRACTION_ELEMENTARY_LANES_H
#define TRACTION_ELEMENTARY_LANES_H

#include "estimators/elementary_terms.h"
#include "estimators/lanes.h"

enum { EXPONENT_BIAS = 1023, MANTISSA_BITS = 52 };

/* e^x, x at most HIGHEST; 0 below -708; NaN for NaN. */
static inline vec exp_lanes(vec x)
{
    const mask too_low = x < LOWEST;
    const vec kept = select(too_low, broadcast(LOWEST), x);
    /* x = k ln 2 + r, |r| <= 0.35; the last bits of `shifted` are k. */
    const vec shifted = kept * LOG2_E + TO_INTEGER;
    const vec k = shifted - TO_INTEGER;
    const vec r = (kept - k * LN2_HIGH) - k * LN2_LOW;
    const vec r2 = r * r;
    vec even = broadcast(FACTORIAL[12]), odd = broadcast(FACTORIAL[13]);
    for (int n = 10; n >= 0; n -= 2) {
        even = even * r2 + FACTORIAL[n];
        odd = odd * r2 + FACTORIAL[n + 1];
    }
    const vec power = (vec)(((bits)shifted + EXPONENT_BIAS) << MANTISSA_BITS); /* 2^k */
    return select(too_low, broadcast(0.0), (even + r * odd) * power);
}

/* Natural logarithm; -infinite below 2^-1022, also for 0 and less; NaN for infinity and NaN. */
static inline vec log_lanes(vec x)
{
    const bits root_half = (bits)broadcast(0x1.6a09e667f3bcdp-1);
    const bits bias = (bits){0} + ((uint64_t)EXPONENT_BIAS << MANTISSA_BITS);
    const bits magic = (bits)broadcast(0x1p52);
    /* x = 2^k m, m from sqrt(1/2) to sqrt(2). */
    const bits exponent = ((bits)x - root_half + bias) >> MANTISSA_BITS; /* k + EXPONENT_BIAS */
    const vec k = (vec)(exponent | magic) - (0x1p52 + 1023.0);
    const vec m = (vec)((bits)x - (exponent << MANTISSA_BITS) + bias);
    /* log m = 2 artanh s; |s| < 0.172. */
    const vec s = (m - 1.0) / (m + 1.0);
    const vec s2 = s * s, s4 = s2 * s2;
    vec even = broadcast(ODD[10]), odd = broadcast(ODD[9]);
    for (int n = 8; n >= 2; n -= 2) {
        even = even * s4 + ODD[n];
        odd = odd * s4 + ODD[n - 1];
    }
    const vec sum = s2 * (even * s4 + ODD[0] + s2 * odd);
    const vec log_x = k * LN2_HIGH + (2.0 * s + (2.0 * s * sum + k * LN2_LOW));
    const vec none = x * 0.0; /* NaN for infinity and NaN */
    return select(x < 0x1p-1022, broadcast(-HUGE_VAL), log_x) + none;
}

/* How often 1 must be added to a number from `least` on to reach 10 or more: at most 10 times. */
static inline int steps_to_ten(double least)
{
    return least >= 0.0 && least < 10.0 ? 10 - (int)least : 0;
}

/* x after `steps` additions of 1. */
struct shifted {
    vec x;
    vec product; /* x (x + 1) .. (x + steps - 1) */
    vec slope;   /* its derivative */
};

static inline struct shifted shift_up(vec x, int steps)
{
    struct shifted out = {x, broadcast(1.0), broadcast(0.0)};
    for (int n = 0; n < steps; n++) {
        out.slope = out.slope * out.x + out.product;
        out.product = out.product * out.x;
        out.x += 1.0;
    }
    return out;
}

/* ln Gamma(x), x above 0 and x + steps at least 10. */
static inline vec log_gamma_lanes(vec x, int steps)
{
    const struct shifted up = shift_up(x, steps);
    const vec inverse = 1.0 / up.x;
    const vec y = inverse * inverse;
    vec series = broadcast(STIRLING[6]);
    for (int k = 5; k >= 0; k--)
        series = STIRLING[k] + y * series;
    const vec whole = (up.x - 0.5) * (log_lanes(up.x) - 1.0) - 0.5 + HALF_LOG_2PI;
    return whole + series * inverse - log_lanes(up.product);
}

/* psi(x), the derivative of ln Gamma, as ln(whole) + part: sums need one logarithm. */
struct psi {
    vec whole, part;
};

/* x above 0 and x + steps at least 10. */
static inline struct psi psi_lanes(vec x, int steps)
{
    const struct shifted up = shift_up(x, steps);
    const vec inverse = 1.0 / up.x;
    const vec y = inverse * inverse;
    vec series = 1.0 / 240.0 - y * (1.0 / 132.0);
    series = 1.0 / 252.0 - y * series;
    series = 1.0 / 120.0 - y * series;
    series = y * (1.0 / 12.0 - y * series);
    return (struct psi){up.x, -up.slope / up.product - 0.5 * inverse - series};
}

#endif
