/* Losses of adhesion by the switching model: docs/switching.md. */
#ifndef TRACTION_SWITCHING_H
#define TRACTION_SWITCHING_H

#include "gateway/core/records.h"

/* Reset to nothing remembered and nothing learnt; `n` and `every` stay. */
void switching_reset(struct switching *s);

/* One step of 10 ms with `loads`: fills `adhering`, `lost` and `demand`. */
void switching_step(struct switching *s);

/* One tick: makes a step if one is due. */
void switching_tick(struct switching *s);

#endif
