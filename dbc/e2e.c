/* E2E protection of CAN frames: AUTOSAR profiles 02 and 05 (PRS_E2EProtocol), and the receiver's
 * state machine (SWS_E2ELibrary).
 *
 * No function here can fail, whatever a record holds, as long as `length` is that of the frame:
 * no frame shorter than its header is read, every other index is masked or bounded by a
 * constant, and the only divisor is the constant number of counter values. */
#include "dbc/e2e.h"

#include "dbc/crc.h"

enum { HEADER_02 = 2, HEADER_05 = 3 }; /* bytes: checksum, counter */

/* Profile 02: over all bytes after the checksum, then the data id that the counter selects. */
static uint8_t crc_profile_02(const struct e2e_config *config, const uint8_t *data)
{
    uint8_t crc = crc8_h2f(CRC8_H2F_START, data + 1, config->length - 1u);
    crc = crc8_h2f(crc, &config->data_id[data[1] & 0x0F], 1);
    return (uint8_t)(crc ^ CRC8_H2F_START);
}

/* Profile 05: over all bytes after the checksum, then the data id, low byte first. */
static uint16_t crc_profile_05(const struct e2e_config *config, const uint8_t *data)
{
    uint16_t crc = crc16_ccitt(CRC16_START, data + 2, config->length - 2u);
    return crc16_ccitt(crc, config->data_id, 2);
}

/* 1 if a frame has room for its header. */
static int has_header(const struct e2e_config *config)
{
    switch (config->profile) {
    case E2E_PROFILE_02:
        return config->length >= HEADER_02;
    case E2E_PROFILE_05:
        return config->length >= HEADER_05;
    default:
        return 1;
    }
}

int e2e_crc_fits(const struct e2e_config *config, const uint8_t *data)
{
    if (!has_header(config))
        return 0;
    switch (config->profile) {
    case E2E_PROFILE_02:
        return crc_profile_02(config, data) == data[0];
    case E2E_PROFILE_05:
        return crc_profile_05(config, data) == (data[0] | data[1] << 8);
    default:
        return 1;
    }
}

/* Number of counter values before it wraps to 0; 1: there is no counter. */
static int counter_values(const struct e2e_config *config)
{
    switch (config->profile) {
    case E2E_PROFILE_02:
        return 16;
    case E2E_PROFILE_05:
        return 256;
    default:
        return 1;
    }
}

/* Counter steps from `last` to `counter`, from 1 to a full turn; 1 if there is no last counter. */
static int steps_between(int last, int counter, int turn)
{
    if (last < 0)
        return 1;
    int delta = (counter - last + turn) % turn; /* turn is 16 or 256 */
    return delta > 0 ? delta : turn;
}

void e2e_reset(struct e2e_state *state)
{
    *state = (struct e2e_state){.counter = -1, .state = E2E_SM_NO_DATA};
    for (unsigned k = 0; k < E2E_WINDOW; k++)
        state->window[k] = E2E_P_NO_NEW_DATA;
}

int e2e_check(const struct e2e_config *config, struct e2e_state *state, const uint8_t *data)
{
    const int turn = counter_values(config);
    state->missed = 0;
    if (turn == 1)
        return E2E_P_OK;
    if (!e2e_crc_fits(config, data))
        return E2E_P_ERROR;
    const int counter = turn == 16 ? data[1] & 0x0F : data[2];
    const int step = steps_between(state->counter, counter, turn);
    state->step = (uint16_t)step;
    state->counter = (int16_t)counter;
    if (step == turn)
        return E2E_P_REPEATED;
    if (step > E2E_MAX_DELTA)
        return E2E_P_WRONG_SEQUENCE;
    state->missed = (uint8_t)(step - 1);
    return step > 1 ? E2E_P_OK_SOME_LOST : E2E_P_OK;
}

/* SWS_E2E_00345: next state, by the numbers of OK and ERROR in the window. Repeats, jumps
 * and silence count as neither: with them the window runs out of OK. */
static const struct transition {
    int min_ok, max_error; /* inclusive */
    uint8_t enough;        /* at least min_ok, at most max_error */
    uint8_t too_many;      /* more than max_error */
    uint8_t otherwise;
} TRANSITIONS[] = {
    [E2E_SM_INIT] = {2, 0, E2E_SM_VALID, E2E_SM_INVALID, E2E_SM_INIT},
    [E2E_SM_VALID] = {2, 1, E2E_SM_VALID, E2E_SM_INVALID, E2E_SM_INVALID},
    [E2E_SM_INVALID] = {3, 0, E2E_SM_VALID, E2E_SM_INVALID, E2E_SM_INVALID},
};

static uint8_t next_state(const struct e2e_state *state, int status)
{
    if (state->state < E2E_SM_INIT || state->state > E2E_SM_INVALID) {
        int has_data = status != E2E_P_ERROR && status != E2E_P_NO_NEW_DATA;
        return has_data ? E2E_SM_INIT : E2E_SM_NO_DATA;
    }
    const struct transition *row = &TRANSITIONS[state->state]; /* in range: checked above */
    int ok = 0, errors = 0;
    for (unsigned k = 0; k < E2E_WINDOW; k++) {
        ok += state->window[k] <= E2E_P_OK_SOME_LOST;
        errors += state->window[k] == E2E_P_ERROR;
    }
    if (errors > row->max_error)
        return row->too_many;
    return ok >= row->min_ok ? row->enough : row->otherwise;
}

int e2e_sm_check(struct e2e_state *state, int status)
{
    const unsigned oldest = state->next % E2E_WINDOW;
    state->window[oldest] = (uint8_t)status;
    state->next = (uint8_t)((oldest + 1) % E2E_WINDOW);
    state->state = next_state(state, status);
    return state->state;
}

void e2e_protect(const struct e2e_config *config, uint8_t *data, int counter)
{
    if (!has_header(config))
        return;
    switch (config->profile) {
    case E2E_PROFILE_02:
        data[1] = (uint8_t)((data[1] & 0xF0) | (counter & 0x0F));
        data[0] = crc_profile_02(config, data);
        break;
    case E2E_PROFILE_05: {
        data[2] = (uint8_t)(counter & 0xFF);
        uint16_t crc = crc_profile_05(config, data);
        data[0] = (uint8_t)(crc & 0xFF);
        data[1] = (uint8_t)(crc >> 8);
        break;
    }
    default:
        break;
    }
}
