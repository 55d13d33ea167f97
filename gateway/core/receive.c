/* Frames of a tick converted to samples, readings and the state of every channel.
 *
 * Bad input is counted, and its cause is kept, so that a flag can report why it is unknown.
 * No function here can fail: an index of a channel, a node or a column comes from a constant table,
 * there is room for all rows, and no received value is a divisor. */
#include "gateway/core/receive.h"

#include <math.h>

#include "dbc/bytes.h"
#include "dbc/decode.h"
#include "dbc/e2e.h"
#include "gateway/core/pairing.h"
#include "gateway/core/sequence.h"
#include "gateway/core/supervision.h"
#include "gateway/core/times.h"

enum { EXTENDED_SHIFT = 31, EMERGENCY_BASE = 0x080, HEARTBEAT_BASE = 0x700 };
enum { EMERGENCY_BYTES = 8 };
/* Of emergencies within this time the first one counts: a drive that sends them all the time would
 * never be flagged. */
#define EMERGENCIES_NS 1000000000

/* ---- Owner of a frame */

int64_t lookup_id(const struct receiver *receiver, uint32_t can_id, uint8_t flags)
{
    const int extended = flags & FRAME_EXTENDED;
    if (!extended && can_id < STANDARD_IDS)
        return receiver->standard_ids[can_id];
    const int64_t key = (int64_t)can_id | (int64_t)extended << EXTENDED_SHIFT;
    int64_t first = 0, last = receiver->id_count;
    while (first < last) { /* halves the interval in each pass */
        const int64_t middle = (first + last) / 2;
        if (receiver->ids[middle].key < key)
            first = middle + 1;
        else
            last = middle;
    }
    const int found = first < receiver->id_count && receiver->ids[first].key == key;
    return found ? receiver->ids[first].channel : ID_UNKNOWN;
}

/* ---- protection */

/* 1 if a frame equals the last one of its channel, byte for byte; the next is compared with it. */
static int replace_last_frame(struct channel *channel, const uint8_t *data)
{
    /* In whole words: the bytes after the length are zeros. */
    const int length = (channel->e2e_config.length + 7) / 8 * 8;
    uint64_t differences = 0;
    for (int b = 0; b < length; b += 8)
        differences |= load_little(data + b) ^ load_little(channel->last_frame + b);
    copy_words(channel->last_frame, data, length);
    return differences == 0;
}

static void note_rejected(struct channel *channel, uint8_t reason)
{
    channel->reject_reason = reason;
    channel->protection_reason = reason;
}

/* A frame with good checksum and counter: 1 if it may be used. No frame is used while the receiver
 * is invalid; at the start, good frames are used while their channel is still unknown. */
static int accept(struct receiver *receiver, struct channel *channel, int64_t t_ns)
{
    const struct e2e_state *state = &channel->e2e_state;
    channel->accepted_ns = t_ns;
    receiver->counters[RX_LOST] += state->missed;
    channel->was_valid |= state->state == E2E_SM_VALID;
    if (state->state != E2E_SM_INVALID && t_ns >= channel->guard.rejected_until_ns)
        return 1;
    receiver->counters[RX_NOT_YET_VALID]++;
    return 0;
}

/* 1 if a frame of a channel may be used. A rejected frame updates counters and reasons only. */
static int verify(struct receiver *receiver, struct channel *channel, const uint8_t *data,
                  int64_t t_ns)
{
    struct e2e_state *state = &channel->e2e_state;
    const int status = e2e_check(&channel->e2e_config, state, data);
    if (channel->e2e_config.profile == E2E_PROFILE_NONE) {
        channel->accepted_ns = t_ns;
        channel->was_valid = 1;
        return 1;
    }
    for (int k = 0; k < state->missed; k++)
        e2e_sm_check(state, E2E_P_NO_NEW_DATA);
    e2e_sm_check(state, status);
    if (status != E2E_P_ERROR) {
        const int same = replace_last_frame(channel, data);
        guard_sequence(&channel->guard, t_ns, state->step, status == E2E_P_REPEATED && same);
    }
    if (status <= E2E_P_OK_SOME_LOST)
        return accept(receiver, channel, t_ns);
    note_rejected(channel, status == E2E_P_ERROR ? REASON_CORRUPTED : REASON_SEQUENCE);
    receiver->counters[RX_ERROR + status - E2E_P_ERROR]++;
    return 0;
}

/* ---- values */

/* 1 if the sender's quality permits the use of its message. */
static int has_quality(const struct channel *channel, const double *value)
{
    const int32_t quality = channel->quality;
    return quality < 0 || value[quality] == 1.0 || value[quality] == 2.0; /* Valid, Degraded */
}

/* Whether the used signals of a decoded row are valid: RX_DECODED, else the reason. An invalid
 * signal that the gateway does not use does not affect the others. */
static enum rx_counter judge(const struct channel *channel, const double *value,
                             const uint8_t *validity)
{
    enum rx_counter found = RX_DECODED;
    for (int k = 0; k < channel->column_count; k++) {
        const uint8_t own = validity[channel->columns[k]];
        if (own == SIGNAL_NOT_AVAILABLE)
            return RX_NOT_AVAILABLE;
        if (own != SIGNAL_VALID && own != SIGNAL_ABSENT)
            found = RX_RANGE;
    }
    return has_quality(channel, value) ? found : RX_NOT_AVAILABLE;
}

/* Temperatures: each sensor separately, as one dead sensor must not invalidate the other three. */
static void note_temperatures(struct channel *channel, const double *value, const uint8_t *validity,
                              int64_t t_ns)
{
    const int usable = has_quality(channel, value);
    channel->reject_reason = usable ? REASON_NONE : REASON_NOT_AVAILABLE;
    for (int k = 0; k < channel->column_count; k++) {
        if (usable && validity[channel->columns[k]] == SIGNAL_VALID)
            channel->good_ns = t_ns;
    }
}

#define RADIANS      0.017453292519943295 /* rad in a degree */
#define RPM          0.10471975511965977  /* rad/s in one revolution per minute */
#define STEADY_NM    0.5  /* a command that changed by less is steady: the noise of the wire */
#define STEADY_SHARE 0.05 /* plus this share of the command */
#define OPERATION    2.0  /* `State` of an inverter in operation */

/* Value of a used column; NaN if there is no such column or its value is not valid. */
static double used_value(const struct channel *channel, int k, const double *value,
                         const uint8_t *validity)
{
    if (k >= channel->column_count || validity[channel->columns[k]] != SIGNAL_VALID)
        return NAN;
    return value[channel->columns[k]];
}

/* Motion: speed, torque, and the angle if it is sent. The speed is used without the torque; the
 * torque is not used without the speed. Returns 1 if the speed is valid. */
static int note_motion(struct receiver *receiver, const struct channel *channel,
                       const double *value, const uint8_t *validity, int64_t t_ns)
{
    const double speed = used_value(channel, 0, value, validity) * RPM;
    const double torque = used_value(channel, 1, value, validity);
    if (isnan(speed))
        return 0;
    receiver->drives[channel->drive].speed = speed;
    if (isnan(torque))
        return 1;
    const int64_t n = receiver->tick.motions++;
    receiver->motion_drive[n] = channel->drive;
    receiver->motion_t_ns[n] = t_ns;
    receiver->motion_speed[n] = speed;
    receiver->motion_torque[n] = torque;
    receiver->motion_angle[n] = used_value(channel, 2, value, validity) * RADIANS;
    return 1;
}

/* Status: torque command, current, and the state if it is sent, each separately. Returns 1 if
 * command or current is valid. */
static int note_status(struct receiver *receiver, const struct channel *channel,
                       const double *value, const uint8_t *validity, int64_t t_ns)
{
    struct drive_input *drive = &receiver->drives[channel->drive];
    const double command = used_value(channel, 0, value, validity);
    const double irms = used_value(channel, 1, value, validity);
    const double state = used_value(channel, 2, value, validity);
    if (isnan(command) && isnan(irms))
        return 0;
    const double before = isnan(drive->command) ? command : drive->command;
    drive->command_steady = fabs(command - before) <= STEADY_NM + STEADY_SHARE * fabs(command);
    drive->command = command;
    drive->previous_command = before;
    drive->irms = irms;
    drive->operating = isnan(state) || state == OPERATION;
    drive->command_ns = t_ns;
    return 1;
}

/* Motion and Status: each signal separately. Returns the reason why the first signal, which
 * adhesion needs, may not be used, or RX_DECODED. */
static enum rx_counter note_separate(struct receiver *receiver, struct channel *channel,
                                     int64_t row, const double *value, const uint8_t *validity)
{
    const int64_t t_ns = receiver->t_ns[row];
    const int noted = channel->kind == KIND_MOTION
                          ? note_motion(receiver, channel, value, validity, t_ns)
                          : note_status(receiver, channel, value, validity, t_ns);
    if (noted)
        channel->good_ns = t_ns;
    const uint8_t first = validity[channel->columns[0]];
    if (first == SIGNAL_VALID)
        return RX_DECODED;
    return first == SIGNAL_NOT_AVAILABLE ? RX_NOT_AVAILABLE : RX_RANGE;
}

/* Use a good row of currents, voltages or samples. */
static enum rx_counter note_good(struct receiver *receiver, struct channel *channel, int64_t row)
{
    if (!pair_samples(receiver, row))
        return RX_RANGE;
    channel->good_ns = receiver->t_ns[row];
    return RX_DECODED;
}

/* Use the values of an accepted, decoded row. */
static void note_row(struct receiver *receiver, int64_t row)
{
    struct channel *channel = &receiver->channels[receiver->channel[row]];
    const double *value = receiver->value + row * receiver->codec->width;
    const uint8_t *validity = receiver->validity + row * receiver->codec->width;
    enum rx_counter found = judge(channel, value, validity);
    if (channel->kind == KIND_TEMPERATURES) {
        note_temperatures(channel, value, validity, receiver->t_ns[row]);
        receiver->temperature_rows[receiver->tick.temperatures++] = row;
    } else {
        enum rx_counter why = found;
        const int separate = channel->kind == KIND_MOTION || channel->kind == KIND_STATUS;
        if (separate && has_quality(channel, value))
            why = note_separate(receiver, channel, row, value, validity);
        else if (!separate && found == RX_DECODED)
            why = found = note_good(receiver, channel, row);
        static const uint8_t reasons[] = {[RX_DECODED] = REASON_NONE,
                                          [RX_NOT_AVAILABLE] = REASON_NOT_AVAILABLE,
                                          [RX_RANGE] = REASON_RANGE};
        channel->reject_reason = reasons[why];
    }
    receiver->counters[found]++;
}

/* ---- One tick */

/* Note an emergency that reports an error; code 0 reports that none is left. */
static void note_emergency(struct receiver *receiver, const struct frame *frame)
{
    const int32_t k =
        receiver->supervision->row[(frame->can_id - EMERGENCY_BASE) % HEARTBEAT_NODES];
    const int plain = frame->length == EMERGENCY_BYTES && !(frame->flags & FRAME_FD);
    if (!plain || (frame->data[0] | frame->data[1]) == 0)
        return;
    int64_t *last_ns = &receiver->drives[k].emergency_ns;
    if (*last_ns < 0 || elapsed(*last_ns, frame->t_ns) >= EMERGENCIES_NS)
        *last_ns = frame->t_ns;
}

/* A frame of no channel, with a stamp: heartbeat, emergency or an unknown identifier. */
static void receive_other(struct receiver *receiver, int64_t owner, const struct frame *frame)
{
    if (owner != ID_SUPERVISED) {
        receiver->counters[RX_UNKNOWN_ID]++;
    } else if (frame->can_id >= HEARTBEAT_BASE) {
        struct supervision *all = receiver->supervision;
        const int32_t node = all->row[(frame->can_id - HEARTBEAT_BASE) % HEARTBEAT_NODES];
        on_heartbeat(all, node, frame->t_ns, frame->length, !(frame->flags & FRAME_FD),
                     frame->data[0]);
        receiver->counters[RX_CANOPEN]++;
    } else {
        note_emergency(receiver, frame);
        receiver->emergency_rows[receiver->tick.emergencies++] = frame->row;
    }
}

/* A frame of a channel: stored for decoding if it may be used. */
static void receive_channel(struct receiver *receiver, int64_t c, const struct frame *frame)
{
    struct channel *channel = &receiver->channels[c];
    const struct e2e_config *config = &channel->e2e_config;
    channel->received_ns = frame->t_ns;
    if (frame->length != config->length || (frame->flags & FRAME_FD) != config->fd) {
        /* With this identifier, another length counts like a wrong checksum. */
        receiver->counters[RX_WRONG_LENGTH]++;
        e2e_sm_check(&channel->e2e_state, E2E_P_ERROR);
        note_rejected(channel, REASON_CORRUPTED);
        return;
    }
    if (!verify(receiver, channel, frame->data, frame->t_ns))
        return;
    const int64_t row = receiver->tick.accepted++;
    receiver->channel[row] = c;
    receiver->message[row] = channel->message;
    receiver->t_ns[row] = frame->t_ns;
    copy_words(receiver->payload + row * PAYLOAD_BYTES, frame->data, PAYLOAD_BYTES);
}

/* Receive any frame. */
static void receive_frame(struct receiver *receiver, const struct frame *frame, int64_t now_ns)
{
    const uint8_t flags = frame->flags;
    if (flags & (FRAME_ERROR | FRAME_REMOTE)) {
        receiver->counters[flags & FRAME_ERROR ? RX_ERROR_FRAME : RX_REMOTE]++;
        if (!(flags & (FRAME_ERROR | FRAME_EXTENDED)))
            on_node_guard(receiver->supervision, frame->can_id);
        return;
    }
    const int64_t owner = lookup_id(receiver, frame->can_id, flags);
    if (owner == ID_OWN) {
        receiver->counters[RX_OWN]++;
        receiver->tick.own++;
        return;
    }
    /* A heartbeat from the future would keep its node alive until then; no time is below 0. */
    const int64_t oldest = owner < 0 ? 0 : receiver->channels[owner].accepted_ns;
    if (frame->t_ns < 0 || frame->t_ns > now_ns || frame->t_ns < oldest)
        receiver->counters[RX_TIME_BACK]++;
    else if (owner < 0)
        receive_other(receiver, owner, frame);
    else
        receive_channel(receiver, owner, frame);
}

static int in_order(int64_t frames, const int64_t *t_ns, const uint32_t *can_id)
{
    for (int64_t k = 1; k < frames; k++) {
        if (t_ns[k] < t_ns[k - 1] || (t_ns[k] == t_ns[k - 1] && can_id[k] < can_id[k - 1]))
            return 0;
    }
    return 1;
}

static void start_tick(struct receiver *receiver)
{
    receiver->tick = (struct received){0};
    for (int64_t k = 0; k < receiver->drive_count; k++) {
        receiver->drives[k].restart = 0;
        receiver->drives[k].newest_sample = -1;
    }
}

/* Why a channel is unknown at `now_ns`; REASON_NONE if it is not. */
static uint8_t unknown_reason(const struct channel *channel, int64_t now_ns)
{
    const uint8_t rejected = channel->reject_reason, state = channel->e2e_state.state;
    if (channel->received_ns < 0)
        return REASON_STARTING;
    if (now_ns - channel->received_ns > channel->limit_ns)
        return REASON_STALE;
    if (now_ns < channel->guard.rejected_until_ns)
        return REASON_SEQUENCE;
    if (channel->e2e_config.profile != E2E_PROFILE_NONE && state != E2E_SM_VALID) {
        /* Single good frames do not end this; the reason is the last error of the protection. */
        if (channel->protection_reason != REASON_NONE)
            return channel->protection_reason;
        return state == E2E_SM_INVALID ? REASON_STALE : REASON_STARTING;
    }
    if (channel->accepted_ns < 0 || now_ns - channel->accepted_ns > channel->limit_ns)
        return rejected != REASON_NONE ? rejected : REASON_STALE;
    return rejected == REASON_RANGE || rejected == REASON_NOT_AVAILABLE ? rejected : REASON_NONE;
}

void check_timeouts(struct receiver *receiver, int64_t now_ns)
{
    for (int64_t c = 0; c < receiver->channel_count; c++) {
        struct channel *channel = &receiver->channels[c];
        if (channel->accepted_ns >= 0 && now_ns - channel->accepted_ns > channel->limit_ns)
            e2e_sm_check(&channel->e2e_state, E2E_P_NO_NEW_DATA);
        channel->reason = unknown_reason(channel, now_ns);
    }
}

int receive_frames(struct receiver *receiver, const struct frame_columns *block, int64_t first,
                   int64_t count, int64_t now_ns)
{
    if (!in_order(count, block->t_ns + first, block->can_id + first))
        return 0;
    start_tick(receiver);
    receiver->received += count;
    for (int64_t k = 0; k < count; k++) {
        const int64_t i = first + k;
        const struct frame frame = {k,
                                    block->t_ns[i],
                                    block->can_id[i],
                                    block->flags[i],
                                    block->length[i],
                                    block->data + i * PAYLOAD_BYTES};
        receive_frame(receiver, &frame, now_ns);
    }
    decode_frames(receiver->codec, receiver->tick.accepted, receiver->message, receiver->payload,
                  receiver->value, receiver->validity);
    for (int64_t row = 0; row < receiver->tick.accepted; row++)
        note_row(receiver, row);
    return 1;
}
