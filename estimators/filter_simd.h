/* Builds of filter_simd.c, named after the bits of their registers. All give the same results. */
#ifndef TRACTION_FILTER_SIMD_H
#define TRACTION_FILTER_SIMD_H

#include "gateway/core/records.h"

/* As `filter_run`. */
typedef void filter_run_function(struct filter_sample *samples, int m, const struct pmsm *motors,
                                 const struct filter_noise *noise, struct filter *filters, int n,
                                 const struct filter_settings *settings);

filter_run_function filter_run_128;
filter_run_function filter_run_256; /* AVX2 */
filter_run_function filter_run_512; /* AVX-512 F, DQ and VL */

#endif
