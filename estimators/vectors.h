/* Complex numbers as vectors of the stationary frame. Not for cffi. */
#ifndef TRACTION_VECTORS_H
#define TRACTION_VECTORS_H

#include <complex.h>
#include <math.h>

#include "estimators/trigonometry.h"

/* A current or voltage, A or V, that no motor reaches: such a sample is discarded. One of 1e80
 * would dominate the running sums for seconds, and its square would overflow. */
static const double IMPLAUSIBLE = 1e5;

/* alpha + j beta, also of infinity and NaN: a product with I would turn infinity into NaN. */
static inline double _Complex vector_of(double alpha, double beta)
{
    const union {
        double parts[2];
        double _Complex z;
    } both = {{alpha, beta}};
    return both.z;
}

/* |z|^2 */
static inline double square_of(double _Complex z)
{
    return creal(z) * creal(z) + cimag(z) * cimag(z);
}

/* |z|; unlike cabs, with the same bits on every machine. A sum of squares has a root. */
static inline double length_of(double _Complex z)
{
    return sqrt(square_of(z));
}

/* arg z, rad. */
static inline double angle_of(double _Complex z)
{
    return arc_tangent(cimag(z), creal(z));
}

/* e^(j angle) */
static inline double _Complex unit_vector(double angle)
{
    double sin, cos;
    sine_and_cosine(angle, &sin, &cos);
    return vector_of(cos, sin);
}

/* |alpha| + |beta|; NaN if one is. */
static inline double size_of(double _Complex z)
{
    return fabs(creal(z)) + fabs(cimag(z));
}

#endif
