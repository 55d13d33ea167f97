/* Condition under which the load of an observer is known. Not for cffi. */
#ifndef TRACTION_OBSERVER_H
#define TRACTION_OBSERVER_H

#include "gateway/core/records.h"

static const int64_t SETTLED_READINGS = 5;

/* 1 if the observer of a drive has settled, so that its load is known. */
static inline int is_observer_settled(const struct motion *motion)
{
    return motion->started && motion->readings >= SETTLED_READINGS;
}

#endif
