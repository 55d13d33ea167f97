/* Which drives have lost adhesion: one tick, and its parts for a detector that is not in the core. */
#ifndef TRACTION_ADHESION_H
#define TRACTION_ADHESION_H

#include "gateway/core/records.h"

/* Nothing remembered and nothing learnt; ratings of the rotors and constants stay.
 * spread: standard deviation of a healthy load, per unit of rated torque. */
void adhesion_reset(struct adhesion *a, double spread);

/* What the detector is given: fills `normalised`, `sigma` and `known`.
 *
 * estimates: those of drives that are not judged lose their numbers. inputs: measured speeds, and
 * which commands are known; drives: commands; status: adhesion flags so far. */
void adhesion_prepare(struct adhesion *a, struct drive_estimate *estimates,
                      const struct input_status *inputs, const struct drive_input *drives,
                      const struct drive_status *status, int64_t now_ns);

/* The detector in the core, the model with a memory or variational Bayes: fills `loss_probability`, `loss_known` and `common`. */
void adhesion_detect(struct adhesion *a);

/* What the detector has found, fused in place with the response of every drive to its own command;
 * severe losses; loss of all drives at once (`common_mode`). Learns from drives that adhere. */
void adhesion_fuse(struct adhesion *a, const struct drive_input *drives,
                   const struct drive_status *status, int64_t now_ns);

/* One tick with a detector in the core: all three. */
void detect_loss(struct adhesion *a, struct drive_estimate *estimates,
                 const struct input_status *inputs, const struct drive_input *drives,
                 const struct drive_status *status, int64_t now_ns);

#endif
