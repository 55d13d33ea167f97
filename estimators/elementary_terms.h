/* The series of exp, log and log Gamma, shared by numbers and lanes. Not for cffi. */
#ifndef TRACTION_ELEMENTARY_TERMS_H
#define TRACTION_ELEMENTARY_TERMS_H

/* ln 2 in two parts: the first has so few bits that its product with an exponent is exact. */
static const double LN2_HIGH = 0x1.62e42feep-1;
static const double LN2_LOW = 0x1.a39ef35793c76p-33;
static const double LOG2_E = 0x1.71547652b82fep+0;
static const double LOWEST = -708.0, HIGHEST = 709.0; /* whose exp is neither 0 nor infinite */

/* 1/n!, of Taylor's series; the first term left out, r^14 / 14!, is below 5e-18 for |r| <= 0.35. */
static const double FACTORIAL[] = {
    1.0,
    1.0,
    1.0 / 2,
    1.0 / 6,
    1.0 / 24,
    1.0 / 120,
    1.0 / 720,
    1.0 / 5040,
    1.0 / 40320,
    1.0 / 362880,
    1.0 / 3628800,
    1.0 / 39916800,
    1.0 / 479001600,
    1.0 / 6227020800.0,
};

/* 1/n for odd n, of the series of artanh; the first term left out, s^25 / 25, is below 4e-21 for
 * |s| < 0.172. */
static const double ODD[] = {1.0 / 3,  1.0 / 5,  1.0 / 7,  1.0 / 9,  1.0 / 11, 1.0 / 13,
                             1.0 / 15, 1.0 / 17, 1.0 / 19, 1.0 / 21, 1.0 / 23};

/* B_2k / (2k (2k - 1)) of Stirling's series; the first term left out is below 3e-17 at x = 10. */
static const double STIRLING[] = {
    1.0 / 12, -1.0 / 360, 1.0 / 1260, -1.0 / 1680, 1.0 / 1188, -691.0 / 360360, 1.0 / 156,
};
static const double HALF_LOG_2PI = 0x1.d67f1c864beb5p-1;

#endif
