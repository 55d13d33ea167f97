/* Load of each drive compared with its command: the first half of adhesion.c. */
#ifndef TRACTION_LOADS_H
#define TRACTION_LOADS_H

#include "gateway/core/records.h"
#include "gateway/core/times.h"

/* The torque of a drive is back a second after its flag cleared; this is twice that. */
#define DERATING_NS 2000000000
#define SECOND_NS   1000000000

/* 1 until DERATING_NS after `flagged_ns`; 0 for NO_TIME. */
static inline int is_soon_after(int64_t flagged_ns, int64_t now_ns)
{
    return flagged_ns != NO_TIME && elapsed(flagged_ns, now_ns) < DERATING_NS;
}

/* Fills `known`, and load, command_ratio and derating_active of `loads`, in the direction of the
 * train; and `responses`, in the direction of each motor. status: flags of the last tick. */
void relate_loads(struct adhesion *a, const struct drive_estimate *estimates,
                  const struct drive_input *drives, const struct drive_status *status,
                  int64_t now_ns);

#endif
