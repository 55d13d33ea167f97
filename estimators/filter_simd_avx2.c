/* filter_simd.c for registers of 256 bits. */
#if defined(__x86_64__)

#include <complex.h>
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "estimators/filter_simd.h"

#define SIMD_WIDTH 4
#define SIMD_NAME  filter_run_256
#ifdef __clang__
#pragma clang attribute push(__attribute__((target("avx2"))), apply_to = function)
#else
#pragma GCC target("avx2")
#endif
#include "estimators/filter_simd.c" /* NOLINT(bugprone-suspicious-include) */
#ifdef __clang__
#pragma clang attribute pop
#endif

#endif
