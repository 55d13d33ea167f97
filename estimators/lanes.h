/* Vectors of SIMD_WIDTH lanes, which do the same arithmetic at once. Not for cffi.
 *
 * Every lane has the same bits as if it were alone: no product is fused with a sum, no sum crosses
 * lanes. The including file defines SIMD_WIDTH, that of one register. */
#ifndef TRACTION_LANES_H
#define TRACTION_LANES_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#include "estimators/trigonometry_terms.h"

enum { LANES = SIMD_WIDTH };

typedef double vec __attribute__((vector_size(8 * SIMD_WIDTH)));
typedef int64_t mask __attribute__((vector_size(8 * SIMD_WIDTH))); /* in a lane all bits, or none */
typedef uint64_t bits __attribute__((vector_size(8 * SIMD_WIDTH)));

typedef double stored __attribute__((vector_size(8 * SIMD_WIDTH), aligned(8), may_alias));

static const double TO_INTEGER = 0x1.8p52; /* added and subtracted: rounds to the next integer */

/* The same number in all lanes. */
static inline vec broadcast(double value)
{
    return (vec){0} + value;
}

static inline vec select(mask condition, vec yes, vec no)
{
    return (vec)(((mask)yes & condition) | ((mask)no & ~condition));
}

static inline vec at_least(vec v, double least)
{
    return select(v > least, v, broadcast(least));
}

static inline vec absolute(vec v)
{
    return (vec)((mask)v & INT64_MAX);
}

static inline vec square_root(vec v)
{
    vec root = {0};
    for (int k = 0; k < LANES; k++)
        root[k] = sqrt(v[k]);
    return root;
}

static inline int any(mask condition)
{
    int64_t found = 0;
    for (int k = 0; k < LANES; k++)
        found |= condition[k];
    return found != 0;
}

/* A row of LANES numbers; rows are contiguous. */
static inline vec load_row(const double *rows, ptrdiff_t row)
{
    return *(const stored *)(rows + LANES * row);
}

static inline void store_row(double *rows, ptrdiff_t row, vec v)
{
    *(stored *)(rows + LANES * row) = v;
}

/* For |t| below 1e6 rad, error below 3e-16; for larger ones the numbers have no meaning. */
static inline void sine_cosine(vec t, vec *sine, vec *cosine)
{
    const vec shifted = t * TWO_OVER_PI + TO_INTEGER;
    const vec q = shifted - TO_INTEGER;
    const bits quadrant = (bits)shifted; /* its last two bits */
    const vec r = (t - q * PI_2_HIGH) - q * PI_2_LOW;
    const vec z = r * r;
    const vec s = SINE_KERNEL(r, z), c = COSINE_KERNEL(z);
    const mask odd = -(mask)(quadrant & 1);
    const bits sine_sign = (quadrant & 2) << 62, cosine_sign = ((quadrant + 1) & 2) << 62;
    *sine = (vec)((bits)select(odd, c, s) ^ sine_sign);
    *cosine = (vec)((bits)select(odd, s, c) ^ cosine_sign);
}

#endif
