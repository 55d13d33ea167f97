/* exp, log, erfc and log Gamma by polynomials: the same bits on every machine. */
#ifndef TRACTION_ELEMENTARY_H
#define TRACTION_ELEMENTARY_H

/* e^x, relative error below 4e-16; 0 below -708, infinite above 709; NaN for NaN. */
double elementary_exp(double x);

/* Natural logarithm, error below 4e-16 of the larger of the result and 1; x must be above 0, or the
 * result is -infinite. NaN for NaN. */
double elementary_log(double x);

/* Complementary error function, relative error below 2e-14 if the result is above 1e-30; NaN for
 * NaN. */
double elementary_erfc(double x);

/* Logarithm of Gamma(x), error below 1e-14 of the larger of the result and 1; NaN unless x is above
 * 0, infinite above 2.5e305. */
double elementary_log_gamma(double x);

#endif
