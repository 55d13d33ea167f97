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

#endif
