/* Consequences of input that does not fit. Not for cffi. */
#ifndef TRACTION_MISFITS_H
#define TRACTION_MISFITS_H

#include "gateway/core/records.h"

#define MS_NS 1000000LL

/* How long an input stays implausible after the last sign of a fault. */
static const int64_t HELD_NS = 200 * MS_NS;

/* Number of consecutive misfits before the input is implausible; and time after a single one in
 * which the currents are no evidence of a loss: no loss is raised before the next reading. */
struct misfit_rule {
    int64_t limit;
    int64_t unreliable_ns;
};

static inline void set_implausible(struct plausibility *p, int64_t until_ns)
{
    if (until_ns > p->implausible_until_ns)
        p->implausible_until_ns = until_ns;
    p->restart = 1;
}

static inline void mark_unreliable(struct rotor *rotor, int64_t until_ns)
{
    if (until_ns > rotor->unreliable_until_ns)
        rotor->unreliable_until_ns = until_ns;
}

/* Count consecutive misfits of drive k in `misfits`; off: 1 if this reading does not fit. */
static inline void count_misfit(struct motion_monitor *m, int64_t k, int64_t *misfits, int off,
                                const struct misfit_rule *rule, int64_t now_ns)
{
    *misfits = off ? *misfits + 1 : 0;
    if (*misfits >= rule->limit)
        set_implausible(&m->checks[k], now_ns + HELD_NS);
    else if (off)
        mark_unreliable(&m->rotors[k], now_ns + rule->unreliable_ns);
}

#endif
