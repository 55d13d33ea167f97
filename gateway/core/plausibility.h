/* Detection of currents and Motion that are well protected and wrong. */
#ifndef TRACTION_PLAUSIBILITY_H
#define TRACTION_PLAUSIBILITY_H

#include "gateway/core/records.h"

/* Check the samples and readings of a tick, after `follow_readings` and before `select_sources`: sets
 * `implausible_until_ns` of `checks`, and `unreliable_until_ns` of `rotors`, until which the currents
 * are no evidence of a loss. The speed of a held Motion becomes NaN in `inputs`. A filter
 * whose input was implausible starts anew. */
void check_plausibility(struct motion_monitor *m, int64_t now_ns);

#endif
