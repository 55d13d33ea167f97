/* Validity of the inputs of a drive in a tick, and the reason if they are not valid.
 *
 * Nothing here can fail: nothing divides, the channels of a drive are those of the configuration,
 * and stamps lie between -1 and now, so that their differences fit. */
#include "gateway/core/inputs.h"

#include <math.h>

#include "gateway/core/flags.h"

int is_channel_fresh(const struct channel *channel, int64_t now_ns)
{
    const int known = channel->good_ns >= 0 && channel->reason == REASON_NONE;
    return known && now_ns - channel->good_ns <= channel->limit_ns;
}

/* The same for a channel that a drive may not have. */
static int is_fresh(const struct receiver *receiver, int32_t c, int64_t now_ns)
{
    return c >= 0 && is_channel_fresh(&receiver->channels[c], now_ns);
}

/* Reason why the currents and voltages of a drive are not valid: the worst that applies. */
static uint8_t electrical_reason(const struct receiver *receiver, const struct drive_channels *own,
                                 const struct input_status *status)
{
    if (own->electrical[0] < 0)
        return REASON_CONFIG;
    uint8_t reason = status->current_sum_fault ? REASON_RANGE : REASON_NONE;
    for (int i = 0; i < 2; i++)
        if (own->electrical[i] >= 0)
            reason = worse_reason(reason, receiver->channels[own->electrical[i]].reason);
    return status->heartbeat_lost ? worse_reason(reason, REASON_STALE) : reason;
}

/* 1 if a message that was once valid no longer is. Values that are out of range, or not available,
 * are no fault of communication. */
static int has_failed(const struct channel *channel)
{
    switch (channel->reason) {
    case REASON_STALE:
    case REASON_CORRUPTED:
    case REASON_SEQUENCE:
        return channel->was_valid;
    default:
        return 0;
    }
}

/* 1 if a message must still become valid before communication is good: a message with currents or
 * voltages, or one that was received. Of a drive that sends no currents, every message must. (A
 * slow message may still come; the flag waits for the duration of its cycle.) */
static int is_awaited(const struct receiver *receiver, const struct drive_channels *own, int32_t c)
{
    const struct channel *channel = &receiver->channels[c];
    const int electrical = c == own->electrical[0] || c == own->electrical[1];
    const int needed = electrical || channel->received_ns >= 0 || own->electrical[0] < 0;
    return !channel->was_valid && needed;
}

/* Evidence of the messages of a drive: bad if one of them has failed. */
static uint8_t comm_evidence(const struct receiver *receiver, const struct drive_channels *own)
{
    uint8_t evidence = FLAG_GOOD;
    for (int32_t c = own->first; c < own->end; c++) {
        if (has_failed(&receiver->channels[c]))
            return FLAG_BAD;
        if (is_awaited(receiver, own, c))
            evidence = FLAG_UNKNOWN;
    }
    return evidence;
}

/* One drive. */
static void assess_drive(const struct receiver *receiver, const struct drive_channels *own,
                         const struct drive_input *in, int intruder, int64_t now_ns,
                         struct input_status *out)
{
    out->current_sum_fault = in->current_sum > own->max_current_sum_a;
    out->reason = electrical_reason(receiver, own, out);
    /* Of the two frames of a sample the older is stale first, by up to the time between them. */
    const int known = in->sample_ns >= 0 && now_ns - in->sample_ns <= own->max_age_ns;
    out->sample_fresh = known && out->reason != REASON_STALE;
    out->command_valid = !isnan(in->command) && is_fresh(receiver, own->status, now_ns);
    out->speed_rad_s = is_fresh(receiver, own->motion, now_ns) ? in->speed : NAN;
    const int failed = out->heartbeat_lost || intruder;
    out->comm = failed ? FLAG_BAD : comm_evidence(receiver, own);
}

void assess_inputs(const struct receiver *receiver, const struct drive_channels *drives,
                   int intruder, int64_t now_ns, struct input_status *status)
{
    for (int64_t k = 0; k < receiver->drive_count; k++)
        assess_drive(receiver, &drives[k], &receiver->drives[k], intruder, now_ns, &status[k]);
}
