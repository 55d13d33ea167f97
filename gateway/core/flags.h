/* Flags: evidence of a tick, debounce and latch, and what is published. */
#ifndef TRACTION_FLAGS_H
#define TRACTION_FLAGS_H

#include "gateway/core/records.h"

/* Priority of a reason: 0 is the worst, 11 is REASON_NONE. An invalid number counts as that one. */
int reason_rank(int reason);

/* The reason with the higher priority; the first of two with the same priority. */
uint8_t worse_reason(uint8_t one, uint8_t other);

/* Evidence of a probability of lost adhesion: an enum flag_state. NaN gives FLAG_UNKNOWN. */
int loss_evidence(const struct flag_rules *rules, double probability);

/* Feed one tick of evidence (enum flag_state) to one flag: 1 if its state has changed. */
int debounce(struct flag *flag, int evidence, const struct flag_timing *timing, int64_t tick_ns,
             int64_t now_ns);

/* Evidence of every flag of n drives, and why their adhesion flags are unknown. */
void collect_evidence(const struct flag_rules *rules, const struct train_inputs *train,
                      const struct flag_inputs *inputs, int n, struct drive_evidence *evidence);

/* Feed the evidence of one tick to every flag of n drives: 1 if a state has changed. */
int debounce_flags(const struct flag_rules *rules, const struct drive_evidence *evidence, int n,
                   int64_t now_ns, struct drive_status *status);

/* Fill everything else in `status` and `whole` except `whole->detector`, after `debounce_flags`. */
void publish(const struct train_inputs *train, const struct flag_inputs *inputs,
             const struct drive_evidence *evidence, int n, int64_t now_ns,
             struct drive_status *status, struct train_status *whole);

#endif
