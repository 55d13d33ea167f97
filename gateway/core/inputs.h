/* Which inputs of the drives are valid in a tick, and if not why. */
#ifndef TRACTION_INPUTS_H
#define TRACTION_INPUTS_H

#include "gateway/core/records.h"

/* 1 if the last usable values of a channel are within its age limit and nothing speaks against it. */
int is_channel_fresh(const struct channel *channel, int64_t now_ns);

/* Fill `status` of every drive of `receiver`, all but `heartbeat_lost`, once the frames of the tick
 * are in. drives: as many; intruder: 1 if somebody else sends as the gateway. */
void assess_inputs(const struct receiver *receiver, const struct drive_channels *drives,
                   int intruder, int64_t now_ns, struct input_status *status);

#endif
