/* What the load of one drive says beside its own torque command, without any other drive. */
#ifndef TRACTION_COMMAND_RESPONSE_H
#define TRACTION_COMMAND_RESPONSE_H

#include "gateway/core/records.h"

/* Probability while it is not known whether the command has changed: no flag changes at it. */
extern const double UNDECIDED;

/* Probability that the wheel of a drive does not carry its command, `dt` s after the last call.
 * valid: 1 where it means something; not while the drive coasts, or while its command is on its way
 * through zero. There it is UNDECIDED. */
double respond(struct command_response *drive, const struct load_spread *all,
               const struct load_ratio *ratio, double dt, uint8_t *valid);

/* 1 if a drive is asked for nothing that could be missing, now and between messages. */
int is_coasting(const struct command_response *drive);

/* 1 if a drive is known, and asked for something that could be missing. */
int is_asked(const struct command_response *drive);

/* Learn spread, and load over command of `healthy` drives (n,); every tick of `dt` s. */
void learn_responses(const struct command_response *drives, struct load_spread *all,
                     struct load_ratio *ratios, const uint8_t *healthy, int n, double dt,
                     struct load_observation *workspace);

/* One probability from the comparison between drives (compared; compared_known) and the response
 * of the drive itself (p_response; response_valid). runs_away: its rotor does. */
double fuse_loss(const struct command_response *drive, double compared, int compared_known,
                 double p_response, int response_valid, int runs_away);

/* 1 if a drive misses more than `part`, and more than `spreads` of its sigma, of what the others
 * carry. With nobody to compare with (common 0): of its own command. */
int is_severe_loss(const struct command_response *drive, double common, double normalised,
                   double sigma, double part, double spreads);

#endif
