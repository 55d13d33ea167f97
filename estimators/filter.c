/* Selection of the filters' build: the widest registers that the processor has and drives fill. */
#include "estimators/filter.h"

#include "estimators/filter_simd.h"

enum { FEW = 4 }; /* drives that 256 bits hold: for so few, wider registers are slower */

int filter_registers_are_readable(uint32_t ecx)
{
    return (ecx >> 27) & 1; /* OSXSAVE */
}

int filter_widest(uint32_t ebx, uint32_t saved)
{
    const uint32_t avx2 = 0x20, avx512 = 0x80030000; /* AVX-512 F, DQ and VL */
    const int has_avx2 = ((ebx & avx2) == avx2) * ((saved & 0x06u) == 0x06u);
    const int has_avx512 = ((ebx & avx512) == avx512) * ((saved & 0xE6u) == 0xE6u);
    return has_avx2 + has_avx2 * has_avx512;
}

#if defined(__x86_64__)
#include <cpuid.h>

static filter_run_function *const BUILDS[] = {filter_run_128, filter_run_256, filter_run_512};

/* Registers of a thread that the operating system saves: register XCR0. */
static uint32_t saved_registers(void)
{
    uint32_t low, high;
    /* NOLINTNEXTLINE(portability-no-assembler) */
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    return low;
}

/* Index of the widest build that can run. (ziglang's __builtin_cpu_supports knows no processor.) */
static int find_widest(void)
{
    uint32_t a, b, c, d;
    __cpuid(1, a, b, c, d);
    if (!filter_registers_are_readable(c)) /* another processor */
        return 0;
    __cpuid_count(7, 0, a, b, c, d);
    return filter_widest(b, saved_registers());
}

static int widest;

__attribute__((constructor)) static void choose(void)
{
    widest = find_widest();
}
#else
static filter_run_function *const BUILDS[] = {filter_run_128};
static const int widest = 0;
#endif

void filter_run(struct filter_sample *samples, int m, const struct pmsm *motors,
                const struct filter_noise *noise, struct filter *filters, int n,
                const struct filter_settings *settings)
{
    const int too_wide = widest / 2 * (n <= FEW); /* 1 with 512 bits for few drives */
    BUILDS[widest - too_wide](samples, m, motors, noise, filters, n, settings);
}

int filter_run_with(int bits, struct filter_sample *samples, int m, const struct pmsm *motors,
                    const struct filter_noise *noise, struct filter *filters, int n,
                    const struct filter_settings *settings)
{
    for (int index = 0; index <= widest; index++) {
        if (bits == 128 << index) {
            BUILDS[index](samples, m, motors, noise, filters, n, settings);
            return 0;
        }
    }
    return -1;
}

void filter_reset(struct filter *filter)
{
    filter->active = 0;
    filter->steps = 0;
    for (int i = 0; i < 5; i++) {
        filter->x[i] = 0.0;
        for (int j = 0; j < 5; j++)
            filter->P[i][j] = i == j ? 1.0 : 0.0;
    }
}
