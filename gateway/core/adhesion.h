/* Detection of lost adhesion: one tick, and its parts for a detector that is not in the core. */
#ifndef TRACTION_ADHESION_H
#define TRACTION_ADHESION_H

#include "gateway/core/records.h"

/* Reset to nothing remembered and nothing learnt; ratings of the rotors and constants stay.
 * spread: standard deviation of a healthy load, per unit of rated torque. */
void adhesion_reset(struct adhesion *a, double spread);

/* Inputs of the detector: fills `normalised`, `sigma` and `known`.
 *
 * estimates: the numbers of drives that are not judged become NaN. inputs: measured speeds, and
 * which commands are known; drives: commands; status: adhesion flags of the last tick. */
void adhesion_prepare(struct adhesion *a, struct drive_estimate *estimates,
                      const struct input_status *inputs, const struct drive_input *drives,
                      const struct drive_status *status, int64_t now_ns);

/* Run the core's detector, switching or VB: fills `loss_probability`, `loss_known` and `common`. */
void adhesion_detect(struct adhesion *a);

/* Fuse the detector's results in place with the response of every drive to its own command; find
 * severe losses and a loss of all drives at once (`common_mode`); learn from drives that adhere. */
void adhesion_fuse(struct adhesion *a, const struct drive_input *drives,
                   const struct drive_status *status, int64_t now_ns);

/* One tick with a detector of the core: all three. */
void detect_loss(struct adhesion *a, struct drive_estimate *estimates,
                 const struct input_status *inputs, const struct drive_input *drives,
                 const struct drive_status *status, int64_t now_ns);

#endif
