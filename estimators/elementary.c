/* exp, log, erfc and log Gamma by polynomials: the same bits on every machine.
 *
 * The last bit of libm's results differs between machines, and a flag must not depend on that.
 * `tests/unit/test_elementary.py` checks the error bounds in the header against exact values. */
#include "estimators/elementary.h"

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#include "estimators/elementary_terms.h"

/* 2^k, k from -1022 to 1023. */
static double power_of_two(int k)
{
    const union {
        uint64_t bits;
        double value;
    } out = {.bits = (uint64_t)(k + 1023) << 52};
    return out.value;
}

double elementary_exp(double x)
{
    if (isnan(x))
        return x;
    if (x < LOWEST)
        return 0.0;
    if (x > HIGHEST)
        return HUGE_VAL;
    /* x = k ln 2 + r, |r| <= 0.35; k is between -1022 and 1023, so the conversion cannot fail. */
    const int k = (int)(x * LOG2_E + (x < 0.0 ? -0.5 : 0.5));
    const double r = (x - k * LN2_HIGH) - k * LN2_LOW;
    const double r2 = r * r;
    double even = FACTORIAL[12], odd = FACTORIAL[13];
    for (int n = 10; n >= 0; n -= 2) {
        even = even * r2 + FACTORIAL[n];
        odd = odd * r2 + FACTORIAL[n + 1];
    }
    return (even + r * odd) * power_of_two(k);
}

double elementary_log(double x)
{
    if (isnan(x))
        return x;
    if (x <= 0.0)
        return -HUGE_VAL;
    if (isinf(x))
        return x;
    /* x = 2^k m, m from sqrt(1/2) to sqrt(2). */
    int k;
    double m = frexp(x, &k);
    if (m < 0x1.6a09e667f3bcdp-1) {
        m *= 2.0;
        k -= 1;
    }
    /* log m = 2 artanh s; |s| < 0.172. */
    const double s = (m - 1.0) / (m + 1.0); /* the divisor is above 1.7 */
    const double s2 = s * s;
    double sum = 0.0;
    for (int n = 10; n >= 0; n--)
        sum = s2 * (ODD[n] + sum);
    return k * LN2_HIGH + (2.0 * s + (2.0 * s * sum + k * LN2_LOW));
}

/* Chebyshev coefficients of ln(erfc(z) / t) + z^2 over t = 2 / (2 + z), which is from 0 to 1. */
static const double ERFC[] = {
    -1.3026537197817094,     0.64196979235649026,     0.019476473204185836,
    -0.0095615147868086316,  -0.00094659534448203687, 0.00036683949785276145,
    4.2523324806907772e-05,  -2.0278578112534243e-05, -1.6242900046470255e-06,
    1.3036558355805232e-06,  1.5626441722066143e-08,  -8.5238095914926543e-08,
    6.5290544390988515e-09,  5.0593434955514689e-09,  -9.9136415649303309e-10,
    -2.2736512229318359e-10, 9.6467911020155268e-11,  2.3940380830391147e-12,
    -6.8860275264975534e-12, 8.9448792730907257e-13,  3.1309213993429581e-13,
    -1.1270822361367252e-13, 3.8109052551892321e-16,  7.1060976136092369e-15,
    -1.5230282014571041e-15, -9.4574945712912545e-17, 1.2102371892242730e-16,
    -2.8166630877467740e-17,
};
enum { ERFC_TERMS = sizeof ERFC / sizeof ERFC[0] };

/* erfc(z) = t exp(P(t) - z^2), z at least 0; P by Clenshaw's recurrence. */
static double erfc_of_positive(double z)
{
    const double t = 2.0 / (2.0 + z); /* the divisor is at least 2 */
    const double twice = 4.0 * t - 2.0;
    double next = 0.0, after = 0.0;
    for (size_t n = ERFC_TERMS - 1; n > 0; n--) {
        const double here = twice * next - after + ERFC[n];
        after = next;
        next = here;
    }
    const double p = 0.5 * (ERFC[0] + twice * next) - after;
    return t * elementary_exp(p - z * z);
}

double elementary_erfc(double x)
{
    return x < 0.0 ? 2.0 - erfc_of_positive(-x) : erfc_of_positive(x);
}

double elementary_log_gamma(double x)
{
    if (!(x > 0.0))
        return NAN;
    /* Gamma(x) = Gamma(x + 1) / x, ten times at most; the product is above 0 and below 1e12. */
    double product = 1.0;
    while (x < 10.0) {
        product *= x;
        x += 1.0;
    }
    const double y = 1.0 / (x * x);
    double series = STIRLING[6];
    for (int k = 5; k >= 0; k--)
        series = STIRLING[k] + y * series;
    const double whole = (x - 0.5) * (elementary_log(x) - 1.0) - 0.5 + HALF_LOG_2PI;
    return whole + series / x - elementary_log(product);
}
