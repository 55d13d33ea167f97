/* Response of a drive's load to its own torque command, without any other drive. */
#ifndef TRACTION_COMMAND_RESPONSE_H
#define TRACTION_COMMAND_RESPONSE_H

#include "gateway/core/records.h"

/* Probability while it is not known whether the command has changed: it changes no flag. */
extern const double UNDECIDED;

/* Probability that the wheel of a drive does not carry its command, `dt` s after the last call.
 * valid: 1 if it has a meaning; 0 while the drive coasts, or while its command passes
 * through zero. Then it is UNDECIDED. */
double respond(struct command_response *drive, const struct load_spread *all,
               const struct load_ratio *ratio, double dt, uint8_t *valid);

/* 1 if a drive is asked for nothing that could be missing, now and between messages. */
int is_coasting(const struct command_response *drive);

/* 1 if a drive is usable, and asked for something that could be missing. */
int is_asked(const struct command_response *drive);

/* Learn the spread, and load over command of `healthy` drives (n,); in every tick of `dt` s. */
void learn_responses(const struct command_response *drives, struct load_spread *all,
                     struct load_ratio *ratios, const uint8_t *healthy, int n, double dt,
                     struct load_observation *workspace);

/* One probability from the comparison of drives (compared; compared_known) and the response of the
 * drive itself (p_response; response_valid). runs_away: 1 if its rotor runs away. */
double fuse_loss(const struct command_response *drive, double compared, int compared_known,
                 double p_response, int response_valid, int runs_away);

/* 1 if more than `part` of the load that the others carry is missing, and more than `spreads` times
 * its sigma. Without others (common 0), its own command takes their place. */
int is_severe_loss(const struct command_response *drive, double common, double normalised,
                   double sigma, double part, double spreads);

#endif
