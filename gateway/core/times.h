/* Differences of stamps. */
#ifndef TRACTION_TIMES_H
#define TRACTION_TIMES_H

#include <stdint.h>

/* Time from `then` to `now`, ns; wraps instead of overflowing if a record holds nonsense. */
static inline int64_t elapsed(int64_t then, int64_t now)
{
    return (int64_t)((uint64_t)now - (uint64_t)then);
}

#endif
