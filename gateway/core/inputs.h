/* Validity of the inputs of the drives in a tick, and the reason if they are not valid. */
#ifndef TRACTION_INPUTS_H
#define TRACTION_INPUTS_H

#include "gateway/core/records.h"

/* 1 if the last usable values of a channel are within its age limit and it has no reason. */
int is_channel_fresh(const struct channel *channel, int64_t now_ns);

/* Fill `status` of every drive of `receiver`, except `heartbeat_lost`, after the frames of the
 * tick. drives: one per drive; intruder: 1 if another node sends the gateway's identifiers. */
void assess_inputs(const struct receiver *receiver, const struct drive_channels *drives,
                   int intruder, int64_t now_ns, struct input_status *status);

#endif
