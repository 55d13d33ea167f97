/* Loss of all drives at once, by their loads and commands. */
#ifndef TRACTION_COMMON_LOSS_H
#define TRACTION_COMMON_LOSS_H

#include "gateway/core/records.h"

/* Follow one tick of the detector `switching`, after the command responses. Returns the probability
 * that all drives together carry less than they are asked for; 0 if it is not known, or below 0.5. */
double follow_common_loss(struct adhesion *a);

#endif
