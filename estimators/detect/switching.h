/* Losses of adhesion by a model with a memory: docs/switching.md. */
#ifndef TRACTION_SWITCHING_H
#define TRACTION_SWITCHING_H

#include "gateway/core/records.h"

/* Nothing remembered and nothing learnt; `n` and `every` stay. */
void switching_reset(struct switching *s);

/* One step of 10 ms with `loads`: fills `adhering`, `lost` and `demand`. */
void switching_step(struct switching *s);

/* One tick: a step if one is due, else nothing. */
void switching_tick(struct switching *s);

#endif
