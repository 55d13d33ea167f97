/* Extended and unscented Kalman filters of several drives. */
#ifndef TRACTION_FILTER_H
#define TRACTION_FILTER_H

#include "gateway/core/records.h"

/* Run the filters of n drives over m samples, in order of time; motors, noise and filters by drive.
 * Changes x and P of the filters, and `nis` of the samples. A filter whose result is not finite, or
 * has a negative variance, gets is_finite 0 and keeps its last good state; the rest of its samples is
 * skipped, with nis NaN: it must be started anew. */
void filter_run(struct filter_sample *samples, int m, const struct pmsm *motors,
                const struct filter_noise *noise, struct filter *filters, int n,
                const struct filter_settings *settings);

/* The same with registers of 128, 256 or 512 bits; -1, with nothing done, if there are none. */
int filter_run_with(int bits, struct filter_sample *samples, int m, const struct pmsm *motors,
                    const struct filter_noise *noise, struct filter *filters, int n,
                    const struct filter_settings *settings);

/* Of an x86-64 processor: 1 if XCR0, the registers that the system saves, can be read; ecx: of CPUID
 * leaf 1. And which registers its filters use, 0: 128, 1: 256, 2: 512 bits; ebx: of CPUID leaf 7. */
int filter_registers_are_readable(uint32_t ecx);
int filter_widest(uint32_t ebx, uint32_t saved);

/* Remove the filter of this drive; it has to be acquired anew. `v_q_bias` stays. */
void filter_reset(struct filter *filter);

#endif
