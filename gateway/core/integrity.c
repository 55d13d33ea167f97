/* Causes that make the flags of all drives unknown: missed ticks, lost frames, an intruder.
 *
 * An intruder is latched until a restart: receivers cannot distinguish the two senders, so an
 * operator must check. The configuration sets how long flags are unknown (docs/threats.md).
 *
 * Nothing here can fail: nothing divides, and differences of stamps wrap if a record holds
 * nonsense. */
#include "gateway/core/integrity.h"

enum { LATE_IN_A_ROW = 3 }; /* late ticks in a row after which no adhesion flag is valid */

/* Time from `then` to the tick, ns; INT64_MAX if `then` is NO_TIME. */
static int64_t since(const struct integrity *integrity, int64_t then)
{
    if (then == NO_TIME)
        return INT64_MAX;
    return (int64_t)((uint64_t)integrity->now_ns - (uint64_t)then);
}

void check_integrity(struct integrity *integrity, int64_t own_frames, int64_t now_ns)
{
    integrity->now_ns = now_ns;
    integrity->deadline_misses += integrity->missed_ticks;
    integrity->late_in_a_row = integrity->missed_ticks ? integrity->late_in_a_row + 1 : 0;
    if (integrity->missed_ticks)
        integrity->overrun_ns = now_ns;
    if (integrity->lost_frames)
        integrity->lost_ns = now_ns;
    integrity->missed_ticks = integrity->lost_frames = 0;
    if (integrity->watching && own_frames > 0) {
        integrity->intruder = 1;
        integrity->intruder_ns = now_ns;
    }
    /* The tick that finds an intruder still sends its frames. */
    integrity->mute = integrity->silent;
    integrity->silent = integrity->stop_on_intruder && integrity->intruder;
}

int integrity_reason(const struct integrity *integrity)
{
    const int held = since(integrity, integrity->intruder_ns) <= integrity->intruder_hold_ns;
    if (integrity->intruder && held && !integrity->authenticated)
        return REASON_INTRUDER;
    if (integrity->late_in_a_row > LATE_IN_A_ROW)
        return REASON_OVERRUN;
    if (since(integrity, integrity->lost_ns) < integrity->lost_hold_ns)
        return REASON_SEQUENCE;
    return REASON_NONE;
}

int is_overrun(const struct integrity *integrity)
{
    return since(integrity, integrity->overrun_ns) <= integrity->overrun_hold_ns;
}

void fill_train_inputs(const struct integrity *integrity, uint8_t common_mode,
                       struct train_inputs *out)
{
    out->integrity_reason = (uint8_t)integrity_reason(integrity);
    out->common_mode = common_mode;
    out->silent = integrity->silent;
    out->overrun = (uint8_t)is_overrun(integrity);
}
