/* Variational message passing, one tick: paper `adhesion`, section 4.4. */
#ifndef TRACTION_MESSAGE_PASSING_H
#define TRACTION_MESSAGE_PASSING_H

#include "gateway/core/records.h"

/* Message passing over the loads x (n,), starting from the prior and E[I] = 0.5; returns the number
 * of iterations. An iteration updates the nodes order (4,), of enum message_passing_node, in turn.
 *
 * Fills q with the factors and r1 (n,) with E[I], the probability of lost adhesion. It stops when
 * an iteration raises the lower bound by less than `tolerance` times its magnitude. With a
 * tolerance below 0 it makes exactly `iterations`, and no bound is computed. */
int message_passing_infer(const struct message_passing_factors *prior, const uint8_t *order,
                          int iterations, double tolerance, const double *x, int n,
                          struct message_passing_factors *q, double *r1);

#endif
