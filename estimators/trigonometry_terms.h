/* The polynomials of sine and cosine (fdlibm: k_sin.c, k_cos.c), shared by numbers and lanes. Not
 * for cffi. */
#ifndef TRACTION_TRIGONOMETRY_TERMS_H
#define TRACTION_TRIGONOMETRY_TERMS_H

static const double TWO_OVER_PI = 0x1.45f306dc9c883p-1;
/* pi / 2 in two parts: the first has 33 bits, so that its products with 20 bits are exact. */
static const double PI_2_HIGH = 0x1.921fb544p+0;
static const double PI_2_LOW = 0x1.0b4611a626331p-34;

/* Coefficients of z^1, z^2, ... in sin r / r and cos r, z = r^2. */
static const double S1 = -1.66666666666666324348e-01, S2 = 8.33333333332248946124e-03,
                    S3 = -1.98412698298579493134e-04, S4 = 2.75573137070700676789e-06,
                    S5 = -2.50507602534068634195e-08, S6 = 1.58969099521155010221e-10;
static const double C2 = 4.16666666666666019037e-02, C3 = -1.38888888888741095749e-03,
                    C4 = 2.48015872894767294178e-05, C5 = -2.75573143513906633035e-07,
                    C6 = 2.08757232129817482790e-09, C7 = -1.13596475577881948265e-11;

/* sin r, |r| <= pi / 4; z = r^2. */
#define SINE_KERNEL(r, z)                                                                          \
    ((r) + (r) * (z) * (S1 + (z) * (S2 + (z) * (S3 + (z) * (S4 + (z) * (S5 + (z) * S6))))))

/* cos r, |r| <= pi / 4; z = r^2. */
#define COSINE_KERNEL(z)                                                                           \
    (1.0 - 0.5 * (z) +                                                                             \
     (z) * (z) * (C2 + (z) * (C3 + (z) * (C4 + (z) * (C5 + (z) * (C6 + (z) * C7))))))

#endif
