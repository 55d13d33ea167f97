/* E2E protection of CAN frames: AUTOSAR profiles 02 and 05, and the receiver's state machine. */
#ifndef TRACTION_E2E_H
#define TRACTION_E2E_H

#include "gateway/core/records.h"

/* 1 if the checksum of `data` (config->length bytes) fits, else 0. */
int e2e_crc_fits(const struct e2e_config *config, const uint8_t *data);

/* Reset to nothing received. */
void e2e_reset(struct e2e_state *state);

/* Check one frame (config->length bytes): an enum e2e_check_status. Stores its counter. */
int e2e_check(const struct e2e_config *config, struct e2e_state *state, const uint8_t *data);

/* Feed the result of one receiver cycle to the state machine: the new enum e2e_sm_state. */
int e2e_sm_check(struct e2e_state *state, int status);

/* Write counter (modulo its width) and checksum into the header of `data`, if it has room for one. */
void e2e_protect(const struct e2e_config *config, uint8_t *data, int counter);

#endif
