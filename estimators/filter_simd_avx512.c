/* filter_simd.c for registers of 512 bits. */
#if defined(__x86_64__)

#include <complex.h>
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "estimators/filter_simd.h"

#define SIMD_WIDTH 8
#define SIMD_NAME  filter_run_512
#ifdef __clang__
#pragma clang attribute push(__attribute__((target("avx512f,avx512dq,avx512vl"))),                 \
                             apply_to = function)
#else
#pragma GCC target("avx512f,avx512dq,avx512vl")
#endif
#include "estimators/filter_simd.c" /* NOLINT(bugprone-suspicious-include) */
#ifdef __clang__
#pragma clang attribute pop
#endif

#endif
