/* Records of the core: one line per field, with unit and meaning.
 *
 * The compiler, cffi and NumPy (dbc/records.py) all read this file, so a layout stands here once.
 * Only `#define` of a number, `enum` and `struct` are allowed: cffi reads nothing else. */
#ifndef TRACTION_RECORDS_H
#define TRACTION_RECORDS_H

#include <stdint.h>

#define E2E_WINDOW    5 /* receiver cycles that the state machine looks back */
#define E2E_MAX_DELTA 3 /* counter steps between two accepted frames: two may be lost in a row */

/* Protection of a message; the numbers are those of the DBC attribute `E2EProfile`. */
enum e2e_profile {
    E2E_PROFILE_NONE = 0,
    E2E_PROFILE_02 = 1, /* CRC-8 0x2F, counter of 4 bits; classic frames */
    E2E_PROFILE_05 = 2, /* CRC-16 CCITT, counter of 8 bits; CAN FD frames */
};

/* Result of one receiver cycle (AUTOSAR: E2E_PCheckStatusType). */
enum e2e_check_status {
    E2E_P_OK = 0,
    E2E_P_OK_SOME_LOST = 1,   /* accepted; the counter proves up to E2E_MAX_DELTA - 1 frames lost */
    E2E_P_ERROR = 2,          /* wrong checksum, or shorter than the header */
    E2E_P_REPEATED = 3,       /* the counter of the frame before */
    E2E_P_WRONG_SEQUENCE = 4, /* the counter jumped */
    E2E_P_NO_NEW_DATA = 5,    /* nothing received in this cycle */
};

/* State of the receiver (AUTOSAR: E2E_SMStateType). */
enum e2e_sm_state {
    E2E_SM_NO_DATA = 0,
    E2E_SM_INIT = 1,
    E2E_SM_VALID = 2,
    E2E_SM_INVALID = 3,
};

/* How one message is protected; constant. */
struct e2e_config {
    uint16_t length;     /* bytes of a frame */
    uint8_t profile;     /* enum e2e_profile */
    uint8_t fd;          /* FD flag that its frames carry (dbc.frame.FD), or 0 */
    uint8_t data_id[16]; /* profile 02: by counter; profile 05: low byte, high byte */
};

/* What the receiver of one message remembers; `e2e_reset` makes one that has received nothing. */
struct e2e_state {
    int16_t counter; /* of the last frame with a good checksum; -1: none yet */
    uint16_t step;   /* counter steps to that frame from the one before: 1 to a whole turn */
    uint8_t missed;  /* frames that the last accepted frame proves lost */
    uint8_t state;   /* enum e2e_sm_state */
    uint8_t window[E2E_WINDOW]; /* status of the last cycles, a ring (enum e2e_check_status) */
    uint8_t next;               /* index in `window` of the oldest */
};

/* ---- signals: where their bits are and what they mean (dbc/decode.c, dbc/encode.c) ---- */

#define MAX_LISTED_BITS 8  /* of a selector by which the signals in a frame are listed */
#define PAYLOAD_BYTES   64 /* a row of payload, whatever the frame's length; zeros behind it */

/* What a raw value says of itself, before any scaling. */
enum signal_validity {
    SIGNAL_VALID = 0,
    SIGNAL_NOT_AVAILABLE = 1, /* the DBC's code for "not available" */
    SIGNAL_OUT_OF_RANGE = 2,  /* outside of the DBC's range; a float: also NaN and infinity */
    SIGNAL_SATURATED = 3,     /* at an end of a signed range: the true value may lie beyond */
    SIGNAL_ABSENT = 4,        /* not in this frame: multiplexed away, or an unused column */
};

enum signal_type {
    SIGNAL_INTEGER = 0, /* signed, or unsigned of at most 63 bits */
    SIGNAL_UINT64 = 1,  /* unsigned of 64 bits */
    SIGNAL_FLOAT32 = 2,
    SIGNAL_FLOAT64 = 3,
};

/* One signal of a message; constant. A key is a raw value with its sign bit turned over: keys of
 * signed and of unsigned signals are ordered alike. */
struct signal {
    uint64_t mask;        /* as many ones as it has bits */
    uint64_t sign;        /* its sign bit; 0: unsigned, or a float */
    uint64_t key_min;     /* lowest and */
    uint64_t key_max;     /* highest key in range */
    uint64_t key_none;    /* key of the not-available code, if `has_none` */
    uint64_t valid_first; /* first key of a run that is valid at one look and */
    uint64_t valid_count; /* length of that run; others can be valid, too */
    uint64_t start;       /* bits of its start value */
    double scale;         /* physical unit per raw step; not 0 */
    double offset;        /* physical value of raw 0 */
    double float_min;     /* lowest and */
    double float_max;     /* highest physical value in range; floats only */
    uint32_t first_range; /* index of the first `struct mux_range` that selects it */
    uint16_t range_count; /* number of these */
    uint16_t multiplexer; /* index in its message of the signal that selects it */
    uint16_t mux_depth;   /* selectors above it; 0: in every frame */
    uint8_t first_byte;   /* index of the first of the eight bytes that hold it, 0 to 56 */
    uint8_t shift;        /* bits below it in these eight bytes, 0 to 63 */
    uint8_t ninth_bits;   /* bits of it in the byte behind these, 0 to 7 */
    uint8_t big_endian;   /* byte order: 1 Motorola, 0 Intel */
    uint8_t type;         /* enum signal_type */
    uint8_t has_none;     /* 1: it has a not-available code */
    uint8_t saturates;    /* 1: the ends of its range mean "or beyond" */
};

/* One message; constant. It is listed if it has one selector, of at most MAX_LISTED_BITS bits, and
 * at most 64 signals: what is in a frame is then looked up by the selector's bits. */
struct message {
    uint32_t first_signal;  /* index of its first `struct signal`; the others follow */
    uint32_t first_present; /* index in `present` of what the selector's value 0 selects */
    uint16_t signal_count;  /* number of its signals */
    uint16_t mux_depth;     /* largest of its signals'; 0: not multiplexed */
    uint16_t selector;      /* index in the message of the one selector, if `is_listed` */
    uint16_t is_listed;     /* 1: it is */
};

/* Values of a selector, both ends included; constant. */
struct mux_range {
    int64_t low;  /* lowest and */
    int64_t high; /* highest raw value */
};

/* A message set; constant. Made by dbc/codec_tables.py. */
struct codec {
    const struct message *messages;
    const struct signal *signals;
    const struct mux_range *mux_ranges;
    const uint64_t *present; /* signals in a frame of a listed message, a bit for each */
    int32_t message_count;
    int32_t width; /* columns of a decoded row: signals of the message that has most */
};

/* ---- received messages (gateway/core/receive.c, pairing.c, supervision.c); times in ns, -1: none */

#define MAX_USED_COLUMNS 33 /* signals of one message that the gateway uses */
#define PAIR_COUNTERS    16 /* values of the counter by which currents and voltages are paired */
#define STANDARD_IDS     2048
#define HEARTBEAT_NODES  128
#define HEARTBEAT_GAPS   5 /* the period is the median of so many */
#define TIMEOUT_PERIODS  3 /* consumer time-out in heartbeat periods */

/* Why something is unknown; the numbers are the message set's. */
enum unknown_reason {
    REASON_NONE = 0,
    REASON_STARTING = 1,
    REASON_STALE = 2,
    REASON_CORRUPTED = 3,
    REASON_SEQUENCE = 4,
    REASON_RANGE = 5,
    REASON_NOT_AVAILABLE = 6,
};

/* What a message carries; the first three become samples. */
enum channel_kind {
    KIND_CURRENTS = 0,
    KIND_VOLTAGES = 1,
    KIND_BLOCK = 2, /* eight samples of both */
    KIND_MOTION = 3,
    KIND_TEMPERATURES = 4,
    KIND_STATUS = 5,
};

/* What an identifier is, where it is no channel's number. */
enum id_owner {
    ID_UNKNOWN = -1,
    ID_OWN = -2,        /* the gateway's own */
    ID_SUPERVISED = -3, /* heartbeat or emergency of a drive's node */
};

/* Every received frame ends in one of these counters; RX_LOST counts frames that did not come. */
enum rx_counter {
    RX_DECODED = 0,
    RX_ERROR_FRAME = 1,
    RX_REMOTE = 2,
    RX_OWN = 3,
    RX_TIME_BACK = 4, /* stamp before the last one of its message, below 0, or after now */
    RX_WRONG_LENGTH = 5,
    RX_ERROR = 6, /* wrong checksum */
    RX_REPEATED = 7,
    RX_WRONG_SEQUENCE = 8,
    RX_LOST = 9,
    RX_NOT_YET_VALID = 10,
    RX_NOT_AVAILABLE = 11,
    RX_RANGE = 12,
    RX_UNKNOWN_ID = 13,
    RX_CANOPEN = 14,
    RX_COUNTERS = 15,
};

/* Signs of a second sender of one message. */
struct sequence_guard {
    double shortest_step_ns;   /* constant: a counter step in less time is a sign */
    int64_t counter_ns;        /* frame that the next counter is compared with */
    int64_t error_ns;          /* last sign */
    int64_t rejected_until_ns; /* enough signs: until then no frame is used */
    int32_t errors;            /* signs */
    int32_t repeats;           /* see MAX_REPEATS in sequence.c */
};

/* One received message of one drive. */
struct channel {
    /* constants */
    int64_t period_ns;
    int64_t limit_ns;     /* older, it is stale: three periods and a tick */
    int32_t message;      /* its number in the codec */
    int32_t drive;        /* position in the configuration */
    int32_t signal_count; /* columns of a decoded row */
    int32_t quality;      /* column of `Quality`; -1: it has none */
    int32_t steps;        /* sub-steps of 125 us between two samples */
    int32_t column_count; /* number of used columns */
    int32_t columns
        [MAX_USED_COLUMNS]; /* signals that the gateway uses, in gateway/channel.py's order */
    uint8_t kind;           /* enum channel_kind */
    struct e2e_config e2e_config;
    /* state */
    struct e2e_state e2e_state;
    int64_t received_ns; /* last frame, good or bad */
    int64_t accepted_ns; /* last frame with good protection */
    int64_t good_ns;     /* last frame whose values could be used */
    struct sequence_guard guard;
    uint8_t last_frame[PAYLOAD_BYTES]; /* bytes of the last frame with a good checksum */
    uint8_t reject_reason;     /* why the last values could not be used (enum unknown_reason) */
    uint8_t protection_reason; /* what last went wrong in the protection */
    uint8_t reason;            /* why the channel is unknown now; REASON_NONE: it is not */
    uint8_t was_valid;         /* 1: its receiver was once in E2E_SM_VALID */
};

/* Currents or voltages that wait for the other half of a sample. */
struct half_sample {
    double value[2]; /* alpha, beta; A or V */
    int64_t t_ns;    /* -1: none waits */
};

/* What one drive has sent; NaN: not yet. */
struct drive_input {
    struct half_sample pending[2][PAIR_COUNTERS]; /* by enum channel_kind, by counter */
    int64_t sample_ns;                            /* stamp of the last sample */
    int64_t sample_counter;                       /* and its counter */
    double current_sum;                           /* smoothed |Ia + Ib + Ic|, A */
    double speed;                                 /* rotor speed, rad/s */
    double command;                               /* torque command, Nm */
    double previous_command;                      /* the one before, Nm */
    double irms;                                  /* A, sent with the command */
    int64_t command_ns;                           /* stamp of the command */
    uint8_t command_steady;                       /* 1: it hardly differs from the one before */
    uint8_t operating; /* 1: `State` is Operation, or the drive sends none */
    uint8_t restart;   /* 1: its filter starts anew in this tick */
};

/* Heartbeat of one node (CiA 301); INT64_MIN is no stamp here. */
struct heartbeat {
    int64_t last_ns;                /* newest frame; INT64_MIN: none */
    int64_t since_ns;               /* heartbeat from which the next gap counts; INT64_MIN: none */
    int64_t gap_ns[HEARTBEAT_GAPS]; /* last gaps between two heartbeats, a ring */
    int64_t gaps;                   /* how many there were; -1: after an answer to node guarding */
    int64_t limit_ns;               /* consumer time-out; 0: not supervised */
    int64_t boots;                  /* boot-up messages */
    int64_t state;                  /* NMT state; -1: none yet */
    int64_t asked;                  /* 1: a node-guard request since the last frame */
};

/* Heartbeats of all nodes. */
struct supervision {
    struct heartbeat *nodes;
    int64_t malformed;  /* frames of a wrong format */
    int64_t timeout_ns; /* shortest time-out */
    int64_t period_ns;  /* configured period; 0: as it is received */
    int32_t node_count;
    int32_t row[HEARTBEAT_NODES]; /* index in `nodes` of a node number; -1: none of ours */
};

/* 29-bit and 11-bit identifiers in ascending order. */
struct id_entry {
    int64_t key;     /* identifier; bit 31 set for a 29-bit one */
    int64_t channel; /* index of its channel, or enum id_owner */
};

/* What the frames of a tick left behind. */
struct received {
    int64_t accepted;     /* frames that may be used */
    int64_t samples;      /* rows of samples */
    int64_t motions;      /* readings of Motion */
    int64_t temperatures; /* rows of temperatures */
    int64_t emergencies;  /* emergencies of the drives' nodes */
    int64_t unpaired;     /* halves of samples that found no other */
    int64_t late;         /* samples that came too late */
    int64_t restarts;     /* drives whose filter starts anew */
    int64_t only_decoded; /* 1: every frame counted as decoded, and the counters are 0 again */
};

/* Everything that receives. Room in all arrays for as many frames as a tick may have. */
struct receiver {
    const struct codec *codec;
    struct channel *channels;
    struct drive_input *drives;
    struct supervision *supervision;
    const struct id_entry *ids;
    int64_t channel_count;
    int64_t drive_count;
    int64_t id_count;
    int64_t max_gap_ns;                 /* longer without a sample, a drive's filter starts anew */
    int64_t standard_ids[STANDARD_IDS]; /* as `id_entry.channel`, of every 11-bit identifier */
    /* accepted frames of the tick, decoded */
    int64_t *channel;
    int32_t *message;
    int64_t *t_ns;
    uint8_t *payload;
    double *value;
    uint8_t *validity;
    /* samples of the tick, in the order of the filters' rows (gateway/pairing.py) */
    int32_t *sample_drive;
    double *sample_u; /* V, alpha and beta */
    double *sample_y; /* A, alpha and beta */
    int64_t *sample_steps;
    int64_t *sample_gap;
    /* readings of Motion in the tick (gateway/slow.py) */
    int64_t *motion_drive;
    int64_t *motion_t_ns;
    double *motion_speed;  /* rad/s */
    double *motion_torque; /* Nm */
    double *motion_angle;  /* rad */
    /* rows that Python looks at */
    int64_t *temperature_rows;     /* accepted frames with temperatures */
    int64_t *emergency_rows;       /* received frames that are emergencies */
    int64_t counters[RX_COUNTERS]; /* since Python last took them over */
    struct received tick;
};

#endif
